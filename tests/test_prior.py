"""Prior of each frame's floor: how sampled frames decide it, and how it is reported."""

import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest

from jaxdet.config import Config, GroundConfig, SurfaceConfig
from jaxdet.engine import Planes, decide_planes
from jaxdet.floor.plane import flat_plane, unknown_plane
from jaxdet.floor.sampled import sampled_floor
from jaxdet.floor.units import FloorFit
from jaxdet.io import LogOptions, open_log
from jaxdet.sim import SimConfig, write_log
from tests.rewritten import Message, changed, moved_camera, read_messages, write_messages

MOUNT = np.array([[0, 0, 1, 0.1], [-1, 0, 0, 0], [0, -1, 0, 0.4], [0, 0, 0, 1.0]])


class Sampled:
    """Log of frames 100 ms apart with given floors."""

    name, base_frame = "log", "base_link"

    def __init__(self, heights: list[float], own: list[bool], tf: bool) -> None:
        self.heights, self.own = np.array(heights), np.array(own)
        self.T_base_camera = MOUNT if tf else None
        self.stamps_ns = np.arange(len(heights)) * 100_000_000
        self.num_frames, self.frames = len(heights), range(len(heights))
        self.priors: list[Any] = []

    def read(self, indices: list[int]) -> SimpleNamespace:
        n = len(indices)
        frames = _Frames(np.array(indices), np.ones(n, bool), None)
        return SimpleNamespace(frames=frames)

    def find_floors(self, frames: Any, config: Config, *, backend: str) -> FloorFit:
        self.priors.append(frames.plane)
        own = self.own[frames.number]
        height = np.where(own, self.heights[frames.number], frames.plane.height)
        plane = flat_plane(height, 0 * height + 0.1, 0 * height, own | frames.plane.valid)
        return FloorFit(plane, own, 0.5 * own, np.where(own, 0, 1), np.zeros((own.size, 8)))


class _Frames(SimpleNamespace):
    def __init__(self, number: np.ndarray, valid: np.ndarray, plane: Any) -> None:
        super().__init__(number=number, valid=valid, plane=plane)

    def _replace(self, plane: Any) -> "_Frames":
        return _Frames(self.number, self.valid, plane)


def test_a_camera_is_fixed_if_heights_and_angles_agree():
    own, level = np.ones(4, bool), np.zeros(4)
    for heights, pitches, agrees in (
        ([0.3, 0.31, 0.3, 0.29], level, True),
        ([0.3, 0.4, 0.3, 0.2], level, False),
        ([0.3] * 4, np.radians([10.0, 20.0, 10.0, 0.0]), False),
    ):
        assert sampled_floor(flat_plane(heights, pitches, level), own).agrees == agrees
        assert sampled_floor(flat_plane(heights, level, pitches), own).agrees == agrees


def decide(
    heights: list[float], own: list[bool] | None = None, tf: bool = False, **ground: Any
) -> Planes:
    log: Any = Sampled(heights, [True] * len(heights) if own is None else own, tf)
    config = Config(ground=GroundConfig(**ground), surface=SurfaceConfig(cell_rad=0.01))
    with patch("jaxdet.engine.floors.find_floors", log.find_floors):
        return decide_planes(log, config, "reference")


def words(planes: Planes, frames: int = 4) -> list[str]:
    return planes.sources(np.arange(frames) * 100_000_000)


def test_sampled_floors_override_tf() -> None:
    planes = decide([0.30, 0.31, 0.36, 0.9], [True, True, True, False], tf=True)
    assert words(planes) == ["log"] * 4
    assert planes.of(np.zeros(2, np.int64)).height.tolist() == [0.31, 0.31]
    assert "3 of 4 sampled frames" in planes.records[0].message
    assert "tf: 0.400 m up" in planes.records[0].message
    flags = decide([0.3] * 4, camera_height_m=0.5, camera_pitch_rad=0.0)
    assert words(flags) == ["log"] * 4 and flags.records[0].height_m == 0.3


def test_few_sampled_floors_do_not_override_tf() -> None:
    planes = decide([0.3] * 4, [True, True, False, False], tf=True)
    assert words(planes) == ["tf"] * 4
    assert planes.of(np.zeros(1, np.int64)).height[0] == pytest.approx(0.4)
    assert words(decide([0.3, 0.3], tf=True)) == ["log"] * 4  # all frames of a shorter log
    assert (
        words(decide([0.3, 0.3], [True, False], camera_height_m=0.5, camera_pitch_rad=0.0))
        == ["flags"] * 4
    )
    assert words(decide([], tf=True)) == ["tf"] * 4


def test_without_tf_the_floor_is_sampled_only_if_the_camera_is_fixed() -> None:
    assert words(decide([0.3, 0.31, 0.32, 0.3])) == ["log"] * 4
    moved = decide([0.3, 0.3, 0.6, 0.6])
    assert words(moved) == ["none"] * 4
    assert not moved.of(np.zeros(1, np.int64)).valid[0]
    assert "searched alone" in moved.records[0].message
    assert words(decide([0.3] * 4, [True, True, False, False])) == ["none"] * 4
    assert words(decide([0.3] * 4, source="none")) == ["none"] * 4
    assert words(decide([0.3] * 4, source="estimate", tf=True)) == ["log"] * 4


def test_the_prior_of_each_time_window_is_decided_separately() -> None:
    heights, own = [0.3] * 4 + [0.5] * 4, [True] * 7 + [False]
    planes = decide(heights, own, window_s=0.2)
    assert words(planes, 9) == ["window"] * 6 + ["none"] * 3
    assert planes.of(np.array([0, 500_000_000])).height.tolist() == [0.3, 0.5]
    planes = decide(heights, own, tf=True, window_s=0.2)
    assert words(planes, 9) == ["window"] * 6 + ["tf"] * 3


def test_sampled_frames_are_reproducible() -> None:
    planes = decide([0.3] * 50, sample_frames=5)
    assert planes.records[0].frames_used == 5


def test_one_outlier_in_ten_does_not_prevent_a_fixed_floor() -> None:
    height = np.array([0.3] * 9 + [0.8])
    plane = flat_plane(height, 0 * height, 0 * height)
    every = np.ones(10, bool)
    found = sampled_floor(plane, every)
    assert found.agrees and found.plane.height[0] == 0.3
    turned = plane._replace(roll=np.array([0.0] * 7 + [0.1, 0.1, 0.0]))
    assert not sampled_floor(turned, every).agrees
    assert not sampled_floor(unknown_plane(4), np.zeros(4, bool)).plane.valid[0]
    assert not sampled_floor(unknown_plane(0), np.zeros(0, bool)).plane.valid[0]


@pytest.fixture(scope="module")
def level_log(tmp_path_factory: pytest.TempPathFactory) -> list[Message]:
    """Return messages of a simulated log whose ``base_link`` is 0.1 m above the floor."""
    path = tmp_path_factory.mktemp("sim") / "sim.mcap"
    write_log(path, SimConfig(frames=4, width=160, height=120))
    return read_messages(path)


def planes_of(path: Path, window_s: float = 0.0, **options: Any) -> Planes:
    with open_log(str(path), LogOptions(**options)) as log:
        return decide_planes(log, Config(ground=GroundConfig(window_s=window_s)), "jax")


@pytest.mark.parametrize(
    "lower_m, tilt, used, warning",
    [
        (0.0, 0.0, True, r"is 0\.10 m lower than z = 0.*--log\.base-frame"),
        (0.1, 0.0, True, r"is 0\.20 m lower than z = 0.*--log\.base-frame"),
        (0.1, 0.1, False, r"if the camera is mounted so, pass .*-height-m 0\.30 .*-pitch 10deg"),
        (-0.6, 0.0, False, r"if the camera is mounted so, pass .*-height-m 0\.30 .*-pitch 10deg"),
    ],
)
def test_a_floor_below_the_base_frame_and_parallel_to_it_is_used(
    tmp_path: Path,
    level_log: list[Message],
    lower_m: float,
    tilt: float,
    used: bool,
    warning: str,
) -> None:
    """A plane above the floor of TF, or tilted, may be a table or a wall, and is not used."""
    path = write_messages(tmp_path / "a.mcap", changed(level_log, moved_camera(lower_m, tilt)))
    planes = planes_of(path, base_frame="base_link")
    (record,) = planes.records
    assert record.source == ("estimate" if used else "tf")
    assert not used or record.height_m == pytest.approx(0.3, abs=0.005)
    (text,) = planes.warnings
    assert re.search(warning, text)


@pytest.mark.parametrize(
    "pitch_deg, roll_deg, stated",
    [
        (15.0, 0.0, "24.8° down, rolled by 1.3°"),
        (25.0, 0.0, "34.8° down, rolled by 1.4°"),
        (-18.0, 0.0, "-8.2° down, rolled by 1.2°"),
        (0.0, 20.0, "9.8° down, rolled by 21.2°"),
        (-20.0, -30.0, "-10.2° down, rolled by -28.8°"),
    ],
)
def test_a_mount_with_a_wrong_tilt_is_replaced_with_a_warning_that_names_both(
    tmp_path: Path, level_log: list[Message], pitch_deg: float, roll_deg: float, stated: str
) -> None:
    turn = moved_camera(0.0, *np.radians([pitch_deg, roll_deg]).tolist())
    path = write_messages(tmp_path / "a.mcap", changed(level_log, turn))
    planes = planes_of(path)
    (record,), (text,) = planes.records, planes.warnings
    assert record.source == "estimate" and record.pitch_rad == pytest.approx(0.17, abs=0.01)
    assert f"by its transforms the camera looks {stated}; its images show" in text
    assert "9.8° down, rolled by 1.2°, which is used" in text
    assert "--ground.camera-pitch 10deg --ground.camera-roll 1deg" in text
    assert "base-frame" not in text


def test_a_wrong_mount_is_reported_once_for_all_time_windows(tmp_path: Path) -> None:
    log = tmp_path / "sim.mcap"
    write_log(log, SimConfig(frames=10, width=160, height=120, rate_hz=5))
    turn = moved_camera(0.0, np.radians(15.0))
    path = write_messages(tmp_path / "a.mcap", changed(read_messages(log), turn))
    planes = planes_of(path, window_s=1.0)
    (text,) = planes.warnings
    assert "its images show the floor" in text and text.endswith("; in 2 of 2 time windows")
