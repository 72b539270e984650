"""Runs with the preset wheeled: rows, summary, and floors that are refused."""

import json
import re
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from jaxdet.config import Config
from jaxdet.engine import GroundRecord
from jaxdet.presets import preset
from jaxdet.results.summary import LogSummary
from jaxdet.sim import SimConfig, write_log
from tests.runs import only_log, run_logs

FRAMES = 6
TABLES = ("frames.parquet", "obstacles.parquet")


def simulated(folder: Path, **settings: Any) -> Path:
    path = folder / "sim.mcap"
    write_log(path, SimConfig(frames=FRAMES, width=320, height=240, rate_hz=5, **settings))
    return path


@pytest.fixture(scope="module")
def tf_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulated(tmp_path_factory.mktemp("tf"))


@pytest.fixture(scope="module", params=["tf", "no tf"])
def sim_log(
    request: pytest.FixtureRequest, tf_log: Path, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    if request.param == "tf":
        return tf_log
    return simulated(tmp_path_factory.mktemp("no_tf"), mount_tf=False)


@pytest.fixture(scope="module")
def results(sim_log: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, LogSummary]:
    """Return the results of one process with a batch of one frame, with one picture."""
    folder = tmp_path_factory.mktemp("results")
    return folder, run(sim_log, folder, batch_size=1, workers=1, pictures=1)


def run(log: Path, output: Path, config: Config | None = None, **options: Any) -> LogSummary:
    config = config or Config()
    how = {"pictures": 0, **options}
    return run_logs(log, output, config, **how).logs[0]


def tables(folder: Path) -> tuple[list[dict], list[dict]]:
    frames, obstacles = (pq.read_table(only_log(folder) / f).to_pylist() for f in TABLES)
    return frames, obstacles


def test_rows_and_summary_are_complete(results: tuple[Path, LogSummary]) -> None:
    folder, about = results
    frames, obstacles = tables(folder)
    assert [row["floor_source"] for row in frames] == ["frame"] * FRAMES
    assert all(row["floor_refused"] is None for row in frames)
    for row in frames:
        assert row["camera_height_m"] == pytest.approx(0.30, abs=0.01)
        start, stop = np.array(row["free_from_m"]), np.array(row["free_to_m"])
        assert len(start) > 80 and (start <= stop + 0.03).all() and stop.max() < 6
        assert set(row["free_end"]) <= {0, 1, 2, 3}
    assert {len(row["contour"]) % 2 for row in obstacles} == {0}
    assert all(0 < row["distance_m"] < 6 for row in obstacles)
    assert all(row["bottom_m"] < row["top_m"] for row in obstacles)
    assert dict(about.floor_sources) == {"frame": FRAMES} and about.floor_warning is None
    read = json.loads((only_log(folder) / "summary.json").read_text(encoding="utf-8"))["logs"][0]
    assert read["floor_sources"] == {"frame": FRAMES} and read["floor_refused"] == {}
    assert read["ground"][0]["source"] == "estimate"


@pytest.mark.parametrize("sim_log", ["tf"], indirect=True)
def test_the_map_shows_free_floor(results: tuple[Path, LogSummary]) -> None:
    grid = np.load(only_log(results[0]) / "map.npz")
    assert grid["free"].shape == grid["counts"].shape and 0 < grid["free"].max() <= FRAMES
    assert (grid["free"] > 0).sum() > 500


def test_a_wrong_mount_is_corrected(tmp_path: Path) -> None:
    log = simulated(tmp_path, mount_pitch_error_rad=0.03, scene="row")
    about = run(log, tmp_path / "out")
    assert about.ground[0].pitch_rad == pytest.approx(0.1745 + 0.03, abs=0.01)
    # The mount is that of the colour camera; the depth camera is rotated by 1.2°.
    assert "tf: 0.299 m up, 9.8° down" in about.ground[0].message


def test_floors_far_from_the_mount_are_refused_with_a_warning(tf_log: Path, tmp_path: Path) -> None:
    config = Config()
    flags = replace(config.ground, camera_height_m=0.7, camera_pitch_rad=0.5)
    about = run(tf_log, tmp_path, replace(config, ground=flags))
    frames, _ = tables(tmp_path)
    assert {row["floor_source"] for row in frames} == {"flags"}
    assert {row["camera_height_m"] for row in frames} == {np.float32(0.7)}
    assert about.floor_sources == {"flags": FRAMES}
    assert about.floor_refused.total() == FRAMES
    assert about.floor_refused == {row["floor_refused"]: FRAMES for row in frames}
    (warning,) = [text for text in about.warnings if "don't show their floor" in text]
    assert f"{FRAMES} have that of flags: pass" in warning and "--ground.camera-height-m" in warning


@pytest.mark.parametrize("far, names_unit", [(10, True), (8, False)])
def test_the_floor_warning_names_the_depth_unit_if_most_floors_are_far_off(
    far: int, names_unit: bool
) -> None:
    log = LogSummary("a", (), status=Counter(ok=10), floor_sources=Counter(tf=10))
    log.floor_refused = Counter(far=far, too_little=10 - far)
    warning = log.floor_warning
    assert warning and "pass the camera's true" in warning
    assert ("check the depth unit (--log.depth-unit-m), the intrinsics" in warning) is names_unit


@pytest.mark.parametrize(
    "pitch, roll, given, cause",
    [
        (0.2, 0.1, "", "z = 0 is the floor with --log.base-frame"),
        (1.5, 0.0, "", "looks 86° down, rolled by 0°: .* --log.camera-frame"),
        (0.2, -1.57, "", "rolled by -90°: .* --log.camera-frame"),
        (0.2, 0.1, "pass --ground.camera-roll 90deg: turned", "warning with --ground.camera-roll"),
    ],
)
def test_the_floor_warning_names_the_cause(pitch, roll, given, cause) -> None:
    log = LogSummary("a", (), status=Counter(ok=10), floor_sources=Counter(tf=10))
    log.ground = (GroundRecord("tf", None, 0.3, pitch, roll),)
    log.floor_refused, log.warnings = Counter(too_little=10), [given]
    warning = log.floor_warning
    assert warning and re.search(cause, warning) and "; else pass the camera's true" in warning


def test_the_floor_warning_names_no_other_mount_if_that_mount_is_used() -> None:
    log = LogSummary("a", (), status=Counter(ok=10), floor_sources=Counter(frame=8, log=2))
    log.floor_refused, log.warnings = Counter(far=2), ["is used; pass --ground.camera-roll 180deg"]
    warning = log.floor_warning
    assert warning and "2 have that of log: pass the camera's true" in warning


def test_source_none_removes_no_floor(tf_log: Path, tmp_path: Path) -> None:
    config = Config()
    nothing = replace(config, ground=replace(config.ground, source="none"))
    about = run(tf_log, tmp_path, nothing)
    frames, obstacles = tables(tmp_path)
    assert {row["floor_source"] for row in frames} == {"none"}
    for name in ("camera_height_m", "floor_refused", "free_to_m", "drop_m"):
        assert [row[name] for row in frames] == [None] * FRAMES
    assert obstacles and all(row["corners_world"] is None for row in obstacles)
    assert not list(only_log(tmp_path).glob("map*"))
    assert obstacles and all(row["bottom_m"] is None for row in obstacles)
    assert about.floor_warning is None


def test_a_log_on_a_table_is_run_with_tabletop(tf_log: Path, tmp_path: Path) -> None:
    run(tf_log, tmp_path, preset("tabletop"), batch_size=2)
    frames, obstacles = tables(tmp_path)
    assert len(frames) == FRAMES and obstacles
    assert {row["status"] for row in frames} == {"ok"}
