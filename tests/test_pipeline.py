"""detect: both backends return equal arrays, on synthetic and recorded frames, in any batch."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import cv2
import jax
import numpy as np
import pytest

from jaxdet import detect
from jaxdet.config import Config, FootprintConfig, GroundConfig
from jaxdet.errors import ConfigError
from jaxdet.pipeline import detect_on_cpu, find_floors
from jaxdet.presets import PRESETS, preset
from jaxdet.stages import _check, _detect
from jaxdet.stages.paper import _detect as _paper
from jaxdet.types import Calibration, Extrinsics, Frames, Intrinsics
from tests.scenes import D435, IDENTITY, assert_equal, blocks, frames, level, small, smooth_depth

pytestmark = pytest.mark.twin


def made_frames(batch: int) -> Frames:
    calibration = small(160, 120)
    color = blocks(batch, 120, 160)
    return frames(calibration, color, smooth_depth(batch, calibration.depth), plane=level(batch))


def recorded_frames(shared_data: Path) -> Frames:
    depth_camera = Intrinsics(640, 480, 384.5, 384.5, 321.7, 236.8)
    motion = Extrinsics(IDENTITY, (0.0148, 0.0, 0.0))
    calibration = Calibration(depth_camera, Intrinsics(640, 480, 610, 610, 320, 240), motion)
    folder = shared_data / "aims_slam/data"
    numbers = (8, 40, 60, 130, 144, 176)
    color = [cv2.imread(str(folder / f"rgb/{n}.png"))[..., ::-1] for n in numbers]
    depth = [cv2.imread(str(folder / f"depth/{n}.png"), cv2.IMREAD_UNCHANGED) for n in numbers]
    plane = level(len(numbers), 0.6225, np.radians(19.2), np.radians(10.5))
    return frames(calibration, np.stack(color), np.stack(depth), plane=plane)


METHODS = ["wheeled", "paper", "d455"]


@pytest.mark.parametrize("name", METHODS)
def test_backends_are_equal(device, name):
    given = made_frames(3), PRESETS[name]
    want = detect(*given, backend="reference")
    assert want.num_obstacles.max() > 0
    assert_equal(detect(*given), want)


@pytest.mark.parametrize("name", METHODS)
def test_backends_are_equal_on_a_recording(device, shared_data, name):
    given = recorded_frames(shared_data), PRESETS[name]
    want = detect(*given, backend="reference")
    assert want.num_obstacles.sum() >= 5
    assert_equal(detect(*given), want)


@pytest.mark.parametrize("name", ["wheeled", "paper"])
def test_two_runs_of_a_large_batch_equal_the_reference(device, name):
    """Synthetic frames are repeated; two runs give equal bytes."""
    given, config = made_frames(16), PRESETS[name]
    rows = np.arange(128) % 16
    many = frames(given.calibration, given.color[rows], given.depth[rows], plane=level(128))
    want = detect(given, config, backend="reference")
    want = jax.tree.map(lambda values: np.asarray(values)[rows], want)
    for _ in range(2):
        assert_equal(detect(many, config), want)


def test_the_plane_comes_from_the_configuration_if_frames_have_none():
    ground = GroundConfig(camera_height_m=0.4, camera_pitch_rad=0.0)
    given = made_frames(2)._replace(plane=None)
    assert_equal(detect(given, replace(Config(), ground=ground)), detect_numpy(made_frames(2)))
    unknown = detect(given, replace(Config(), ground=GroundConfig(source="none")))
    assert unknown.scene and not np.asarray(unknown.scene.prior.valid).any()


def detect_numpy(given: Frames):
    return detect(given, backend="reference")


def test_frames_without_depth_differ_from_frames_without_obstacles():
    given = made_frames(2)
    given.depth[1] = 0
    found = detect(given)
    assert np.asarray(found.has_depth).tolist() == [True, False]
    assert np.asarray(found.num_obstacles)[1] == 0


def test_find_floors_without_a_configuration_uses_the_defaults():
    frames = made_frames(1)
    found, expected = (find_floors(frames, c, backend="reference") for c in (None, Config()))
    np.testing.assert_array_equal(found.plane.height, expected.plane.height)


def test_floors_and_detections_without_jax_equal_those_of_the_reference():
    given = _check.check_frames()
    expected = find_floors(given, backend="reference")
    assert expected.own.all()
    assert_equal(find_floors(given), expected)
    found = detect_on_cpu(given, Config(), backend="jax")
    assert found.cells is not None and found.num_obstacles.any()
    assert_equal(found, detect(given, backend="reference", with_cells=True))


def test_detections_of_the_preset_paper_without_jax_have_points():
    given = made_frames(3), preset("paper")
    found = detect_on_cpu(*given, backend="jax")
    assert found.points is not None
    assert_equal(found, detect(*given))


WITHOUT_JAX = """
import sys
import numpy as np
from jaxdet.config import Config
from jaxdet.pipeline import detect_on_cpu, find_floors
from jaxdet.types import Calibration, Frames, Intrinsics
numbers = np.arange(2)
camera = Calibration(Intrinsics(96, 72, 80.0, 80.0, 47.5, 35.5))
depth = np.full((2, 72, 96), 1500, np.uint16)
frames = Frames(depth, camera, numbers, numbers, numbers >= 0)
find_floors(frames)
detect_on_cpu(frames, Config(), backend="jax")
print("jax" in sys.modules, "jaxdet.reference" in sys.modules)
"""


def test_frames_are_processed_by_the_kernels_without_loading_jax():
    command = [sys.executable, "-P", "-c", WITHOUT_JAX]
    assert subprocess.check_output(command, text=True) == "False False\n"


def test_unknown_backends_and_presets_are_errors():
    with pytest.raises(ConfigError, match="use one of reference, jax"):
        detect(made_frames(1), backend="torch")
    with pytest.raises(ConfigError, match="wheeled"):
        preset("unicycle")


def other_settings(config: Config) -> Config:
    """Return the configuration with other lengths in all sections."""
    return replace(
        config,
        ground=replace(config.ground, min_depth_m=0.3, max_depth_m=2.5, step_height_m=0.08),
        surface=replace(config.surface, step_m=0.04),
        obstacle=replace(config.obstacle, lateral_gap_m=1.0, min_size_m=0.08),
        cluster=replace(config.cluster, depth_gap_m=0.2, lateral_gap_m=0.3),
        footprint=FootprintConfig(0.05, trim=4, near_band_per_m2=0.02, margin_m=0.01),
    )


@pytest.mark.parametrize(
    ("name", "program"), [("wheeled", _detect._detect), ("paper", _paper._detect)]
)
def test_settings_and_calibration_are_not_compile_time_constants(device, name, program):
    """A calibration of the same image size and other settings do not compile the program again."""
    given, config = made_frames(3), PRESETS[name]
    detect(given, config)
    compiled = cast(Any, program)._cache_size
    before = compiled()
    assert before
    moved = D435.color_from_depth._replace(translation=(0.02, 0.0, 0.0))
    given = given._replace(calibration=given.calibration._replace(color_from_depth=moved))
    changed = given, other_settings(config)
    assert_equal(detect(*changed), detect(*changed, backend="reference"))
    assert compiled() == before
