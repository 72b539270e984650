"""ground: Eq. 5 in exact arithmetic, tilted cameras by geometry, and kernel and reference."""

from dataclasses import replace
from fractions import Fraction
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from jaxdet import reference, stages
from jaxdet.config import Config, GroundConfig
from jaxdet.errors import ConfigError
from jaxdet.floor.plane import (
    depth_range,
    down_vector,
    floor_limits,
    forward_vector,
    ground_axes,
    plane_from_down,
    plane_from_transform,
    unknown_plane,
)
from jaxdet.reference.paper._ground import above_floor
from jaxdet.types import Calibration, GroundPlane, Intrinsics
from tests.scenes import assert_equal, at_every_pixel, level, noise_depth, resized, rotation, small

BACKENDS = pytest.mark.parametrize("backend", [reference, stages], ids=["reference", "stages"])
CAMERA = Intrinsics(64, 48, 60.0, 60.0, 31.5, 20.0)
CALIBRATION = Calibration(CAMERA)


def kept(backend: ModuleType, z: np.ndarray, plane: GroundPlane, *given: Any) -> np.ndarray:
    """Return the mask of kept features, for a feature at every pixel of z images ``(B, H, W)``."""
    found = backend.paper.ground(at_every_pixel(z), plane, *given)
    return np.asarray(found.kept).reshape(z.shape)


WIDE = replace(
    Config(), ground=GroundConfig(min_depth_m=0.001, max_depth_m=60.0, step_height_per_m=0.0)
)


# by hand


@BACKENDS
def test_range_bounds_are_inclusive(backend):
    config = replace(Config(), ground=GroundConfig(min_depth_m=0.5, max_depth_m=2.0))
    z = np.zeros((1, 48, 64), np.uint16)
    z[0, 0, :6] = 0, 499, 500, 2000, 2001, 65535
    found = kept(backend, z, unknown_plane(1), CALIBRATION, config)
    assert found[0, 0, :6].tolist() == [False, False, True, True, False, False]


@BACKENDS
def test_in_fine_depth_units_all_depths_may_be_too_near(backend):
    z = np.full((1, 48, 64), 65535, np.uint16)
    for nearest, some in ((0.65, True), (0.8, False)):
        config = replace(Config(), ground=GroundConfig(min_depth_m=nearest))
        fine = Calibration(CAMERA, depth_unit=1e-5)
        found = kept(backend, z, unknown_plane(1), fine, config)
        assert found.all() == found.any() == some


@BACKENDS
def test_level_camera_equals_equation_5_on_every_pixel(backend):
    """Eq. 5, ``v - c_y >= f (h - 0.05) / z``, is computed in rational numbers for many depths."""
    height, step, unit = Fraction("0.62"), Fraction("0.05"), Fraction("0.001")
    depths = np.unique(np.concatenate([np.arange(1, 4000, 7), [342, 570, 1026, 1710, 2850]]))
    z = np.broadcast_to(depths[:, None, None], (len(depths), 48, 64)).astype(np.uint16)
    found = kept(backend, z, level(len(depths), 0.62), CALIBRATION, WIDE)
    bound = [Fraction(60) * (height - step) / (int(d) * unit) for d in depths]
    floor = np.array([[v - 20 >= b for v in range(48)] for b in bound])
    assert 0.05 < floor.mean() < 0.6
    assert np.array_equal(~found, np.broadcast_to(floor[:, :, None], z.shape))


@BACKENDS
def test_a_point_exactly_at_the_step_height_is_floor(backend):
    # Row 39 is 19 px below the axis: 60 * 0.57 / 19 = 1.8 m, and 1.799 m is still above.
    z = np.zeros((2, 48, 64), np.uint16)
    z[0, 39], z[1, 39] = 1800, 1799
    found = kept(backend, z, level(2, 0.62), CALIBRATION, WIDE)
    assert not found[0, 39].any()
    assert found[1, 39].all()


@BACKENDS
def test_the_step_height_grows_with_depth(backend):
    # A level camera is 0.62 m up. At 2 m, the step height is 0.05 + 2 * 0.01 m, 16.5 px below the
    # axis; at 4 m, it is 0.09 m, 7.95 px below the axis.
    config = replace(WIDE, ground=replace(WIDE.ground, step_height_per_m=0.01))
    z = np.zeros((2, 48, 64), np.uint16)
    z[0], z[1] = 2000, 4000
    mask = kept(backend, z, level(2, 0.62), CALIBRATION, config)
    assert mask[0, :37].all() and not mask[0, 37:].any()
    assert mask[1, :28].all() and not mask[1, 28:].any()


@pytest.mark.parametrize(("pitch", "roll"), [(0.3, 0.0), (0.0, 0.2), (0.33, -0.18), (-0.1, 0.05)])
def test_tilted_floor_is_dropped_and_higher_points_are_kept(pitch, roll):
    down = down_vector(np.array([pitch]), np.array([roll]))[0]
    v, u = np.mgrid[:48, :64]
    slope = ((u - 31.5) * down[0] + (v - 20.0) * down[1]) / 60.0 + down[2]

    def depth_at(height: float) -> np.ndarray:
        z = np.where(slope > 0.02, (0.6 - height) / np.maximum(slope, 0.02), 0)
        return np.clip(np.rint(1000 * z), 0, 65535).astype(np.uint16)

    plane = level(3, 0.6, pitch, roll)
    z = np.stack([depth_at(0.0), depth_at(0.045), depth_at(0.056)])
    mask = above_floor(z, plane, CALIBRATION, WIDE)
    seen = (z[0] > 0) & (z[0] < 20_000)
    assert seen.sum() > 200
    assert not mask[0][seen].any()
    assert not mask[1][seen].any()
    assert mask[2][seen].all()
    assert np.array_equal(kept(reference, z, plane, CALIBRATION, WIDE), mask)


@pytest.mark.parametrize("slope", [0.1, 0.4, -0.1, -0.4])
@pytest.mark.parametrize(("pitch", "roll"), [(0.1, 0.0), (0.3, -0.1), (0.7, 0.05)])
def test_depth_limits_follow_the_plane_and_the_ramp(pitch, roll, slope):
    """The limit is the depth from which a ray is at most a step above the plane or the ramp."""
    start, step = 0.9, 0.05
    ramp = {"ramp_start": np.array([start]), "ramp_slope": np.array([slope])}
    (limits,), _ = floor_limits(
        CAMERA, level(1, 0.6, pitch, roll)._replace(**ramp), WIDE.ground, 0.001
    )
    v, u = np.mgrid[:48:3, :64:5]
    rays = np.stack([(u - 31.5) / 60.0, (v - 20.0) / 60.0, np.ones(u.shape)], axis=-1)
    down = down_vector(np.array([pitch]), np.array([roll]))
    falls, ahead = rays @ down[0], rays @ forward_vector(down)[0]
    z = np.arange(1, 9000) * 0.001
    rise = slope * np.maximum(z * ahead[..., None] - start, 0.0)
    is_floor = 0.6 - z * falls[..., None] - rise <= step
    found, none = limits[::3, ::5].astype(int), ~is_floor.any(axis=-1)
    crest = np.abs(0.6 * ahead - start * falls) < 0.15  # the step matters at falling ramps
    clear = ~crest if slope < 0 else np.ones_like(crest)
    assert clear.mean() > 0.6 and (~none & clear).any()
    assert (found[none & clear] >= 8999).all()
    assert np.array_equal(found[~none & clear], is_floor.argmax(axis=-1)[~none & clear])


def test_forward_of_a_camera_looking_straight_down_is_the_top_of_its_image():
    down = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    assert forward_vector(down).tolist() == [[0, -1, 0], [0, -1, 0], [0, 0, 1]]


def test_depth_0_is_outside_of_any_range():
    assert depth_range(0.0, 65.535, 0.001) == (1, 65535)
    assert depth_range(0.0004, 70.0, 0.001) == (1, 65535)
    assert depth_range(0.15, 4.0, 0.00025) == (600, 16000)


def test_pitch_is_positive_downward_and_roll_clockwise():
    """In a camera pitched down, gravity has a component forward; rolled clockwise, to the right."""
    assert down_vector(np.array([0.5]), np.array([0.0]))[0][2] > 0
    assert down_vector(np.array([0.0]), np.array([0.5]))[0][0] > 0
    plane = plane_from_down(down_vector(np.array([0.3]), np.array([-0.2])), np.array([0.7]))
    assert np.allclose([plane.pitch[0], plane.roll[0], plane.height[0]], [0.3, -0.2, 0.7])


def test_the_plane_of_a_mount_has_its_height_pitch_and_roll():
    # Base: x forward, y left, z up. Level camera: z forward, x right, y down.
    T = np.eye(4)
    T[:3, :3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]
    T[2, 3] = 0.41
    turn = np.eye(4)
    turn[:3, :3] = np.reshape(rotation(-15.0, 0, 0), (3, 3))  # about the camera's x: looks down
    plane = plane_from_transform(T @ turn)
    assert np.allclose([plane.height[0], plane.pitch[0], plane.roll[0]], [0.41, np.radians(15), 0])


def test_ground_axes_are_right_and_forward():
    axes = ground_axes(level(1, 0.5, np.radians(20.0))) / 8192
    assert np.allclose(axes[0, 0], [1, 0, 0], atol=1e-3)
    assert np.allclose(axes[0, 1], [0, -np.sin(np.radians(20)), np.cos(np.radians(20))], atol=1e-3)
    assert np.allclose(ground_axes(unknown_plane(1))[0] / 8192, [[1, 0, 0], [0, 0, 1]])


def test_equal_planes_share_their_table_of_limits():
    plane = GroundPlane(
        *(np.concatenate([a, a, b]) for a, b in zip(level(1), level(1, 0.7), strict=True))
    )
    limits, which = floor_limits(CAMERA, plane, GroundConfig(), 0.001)
    assert limits.shape == (2, 48, 64)
    assert which.tolist() == [0, 0, 1]


def test_values_out_of_range_are_errors_that_name_the_flag():
    with pytest.raises(ConfigError, match=r"ground\.min-depth-m"):
        GroundConfig(min_depth_m=3, max_depth_m=2)
    with pytest.raises(ConfigError, match=r"ground\.camera-height-m"):
        GroundConfig(source="flags")


# twin


@pytest.mark.twin
@pytest.mark.parametrize("batch", [1, 4])
def test_ground_points_equal_the_reference(device, batch):
    camera = resized(small().color, 97, 61)
    z = noise_depth(batch, camera)
    plane = level(batch, 0.5, 0.2, -0.1)
    plane.height[-1], plane.valid[0] = 0.3, False
    given = at_every_pixel(z), plane, Calibration(camera), Config()
    given[0].valid[:, ::3] = False
    assert_equal(stages.paper.ground(*given), reference.paper.ground(*given))
    assert reference.paper.ground(*given).kept.any()


# laws


def test_a_lower_step_height_keeps_more_features(device):
    z = noise_depth(2, CAMERA)
    low = replace(Config(), ground=GroundConfig(step_height_m=0.02))
    more = kept(stages, z, level(2), CALIBRATION, low)
    fewer = kept(stages, z, level(2), CALIBRATION, Config())
    assert np.all(more | ~fewer)
    assert more.sum() > fewer.sum()
