"""align_points: equal to the dense reference at every pixel, on hostile depth and calibrations."""

from unittest import mock

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxdet import reference, stages
from jaxdet.camera import corner_rays
from jaxdet.stages import _align_points
from jaxdet.types import Calibration, Extrinsics, Intrinsics
from tests.scenes import (
    D435,
    D435_MOTION,
    IDENTITY,
    noise_depth,
    resized,
    rotation,
    small,
    smooth_depth,
    with_lens,
)


def every_pixel(camera: Intrinsics, batch: int) -> tuple[np.ndarray, np.ndarray]:
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.int32)
    return np.repeat(u.reshape(1, -1), batch, 0), np.repeat(v.reshape(1, -1), batch, 0)


def assert_dense(depth: np.ndarray, calibration: Calibration) -> None:
    """The points at every pixel are the dense reference."""
    u, v = every_pixel(calibration.color, len(depth))
    got = stages.align_points(depth, calibration, u, v)
    want = reference.align(depth, calibration)
    for name, a, b in zip(want._fields, got, want, strict=True):
        assert np.array_equal(np.asarray(a), b.reshape(len(depth), -1)), name


def moved(turn: tuple[float, float, float], shift: tuple[float, float, float]) -> Extrinsics:
    return Extrinsics(rotation(*turn), shift)


MOTIONS = {
    "d435": D435_MOTION,
    "turned": moved((3, -5, 8), (-0.03, 0.01, 0.02)),
    "same_place": moved((0, 0, 0), (0.0, 0.0, 0.0)),
    "rolled": moved((2, 3, 35), (0.02, 0.05, -0.03)),
    "far_apart": moved((0, 0, 0), (0.0, 0.3, -0.2)),
    "wide_angle": moved((10, 20, -10), (0.05, 0.1, 0.05)),
}


def hostile(camera: Intrinsics) -> np.ndarray:
    """Noise, ties, single units, the deepest, specks in front of a wall, nothing; a frame each."""
    rng = np.random.default_rng(7)
    shape = camera.height, camera.width
    specks = np.full(shape, 2000)
    specks[::7, ::5] = 3
    images = [
        rng.integers(0, 65536, shape),
        rng.integers(0, 6, shape),
        np.exp(rng.uniform(0, np.log(65536), shape)),
        np.full(shape, 700),
        np.full(shape, 1),
        np.full(shape, 65535),
        specks,
        np.zeros(shape),
    ]
    made = np.stack(images).astype(np.uint16)
    return np.concatenate([made, noise_depth(1, camera), smooth_depth(1, camera)])


@pytest.mark.parametrize("scale", [0.4, 1.0, 1.6])
@pytest.mark.parametrize("motion", MOTIONS)
def test_equals_the_dense_alignment(device, motion, scale):
    calibration = small(75, 51, scale)._replace(color_from_depth=MOTIONS[motion])
    assert _align_points.covers(calibration)
    assert_dense(hostile(calibration.depth), calibration)


@pytest.mark.parametrize("unit", [0.0001, 0.01])
def test_any_depth_unit(device, unit):
    calibration = small()._replace(depth_unit=unit)
    assert_dense(hostile(calibration.depth), calibration)


@pytest.mark.parametrize("size", [(640, 480), (1280, 720)])
def test_full_size(device, size):
    calibration = Calibration(resized(D435.color, *size), D435.depth, D435_MOTION)
    depth = np.concatenate([smooth_depth(1, D435.depth), noise_depth(1, D435.depth)])
    assert_dense(depth, calibration)


angles = st.floats(-12, 12)
shifts = st.floats(-0.1, 0.1)


@given(
    st.integers(0, 2**32 - 1),
    st.tuples(angles, angles, angles),
    st.tuples(shifts, shifts, shifts),
    st.floats(0.5, 3.0),
    st.sampled_from([2, 7, 500, 8000, 65535]),
    st.floats(0, 1),
)
@settings(max_examples=40)
def test_any_motion_and_depth(seed, turn, shift, zoom, deepest, holes):
    base = small(33, 26)
    color = base.color._replace(fx=base.color.fx * zoom, fy=base.color.fy * zoom)
    calibration = Calibration(color, base.depth, moved(turn, shift))
    rng = np.random.default_rng(seed)
    depth = rng.integers(1, deepest + 1, (2, 26, 33)).astype(np.uint16)
    depth[rng.random(depth.shape) < holes] = 0
    assert_dense(depth, calibration)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=25)
def test_edges_on_the_pixel_grid(seed):
    """Whole and half pixels, where the covered rectangles end exactly between two pixels."""
    rng = np.random.default_rng(seed)
    focal = float(rng.choice([16, 32, 64]))
    depth_camera = Intrinsics(32, 24, focal, focal, 15.5, 11.5)
    double = int(rng.integers(1, 3))
    color = Intrinsics(32, 24, double * focal, double * focal, *rng.integers(10, 20, 2) / 2 + 6)
    shift = tuple((rng.integers(-8, 9, 3) / 64).tolist())
    calibration = Calibration(color, depth_camera, Extrinsics(IDENTITY, shift), 2.0**-10)
    depth = (1 << rng.integers(0, 16, (2, 24, 32))).astype(np.uint16)
    assert_dense(depth, calibration)


def test_lenses_and_opposite_cameras_are_aligned_densely(device):
    base = small(40, 30)
    bent = base._replace(color=with_lens(base.color, "plumb_bob"))
    turned = base._replace(color_from_depth=moved((0, 0, 90), (0.0, 0.0, 0.0)))
    for calibration in (bent, turned):
        assert not _align_points.covers(calibration)
        assert_dense(noise_depth(2, base.depth), calibration)
    aligned = Calibration(base.color)
    assert not _align_points.covers(aligned)
    assert_dense(noise_depth(2, base.color), aligned)


def test_single_points(device):
    depth = smooth_depth(2, D435.depth)
    dense = reference.align(depth, D435)
    u, v = np.array([[5, 320], [639, 0]], np.int32), np.array([[7, 240], [479, 0]], np.int32)
    got = stages.align_points(depth, D435, u, v)
    frame = np.arange(2)[:, None]
    assert np.array_equal(np.asarray(got.z), dense.z[frame, v, u])
    assert np.asarray(got.depth)[0].tolist() == dense.depth[0][v[0], u[0]].tolist()
    assert (np.asarray(got.z) > 0).sum() >= 3


def test_depth_ranges(device):
    depth = np.zeros((2, 20, 33), np.uint16)
    depth[0, 0, 0], depth[0, 15, 15], depth[0, 19, 32] = 9, 4, 65535
    tiles, ranges = (np.asarray(a) for a in _align_points.depth_ranges(depth))
    none = 65535 << 16
    assert tiles[0].tolist() == [[4 << 16 | 9, none, none], [none, none, 65535 << 16 | 65535]]
    assert tiles[1].tolist() == [[none] * 3] * 2
    assert ranges.tolist() == [4 << 16 | 65535, none]


def test_without_its_margins_the_search_is_wrong():
    """The comparison above would notice a box that is too small."""
    calibration = small(75, 51, 1.6)._replace(color_from_depth=MOTIONS["turned"])
    assert_dense(noise_depth(1, calibration.depth), calibration)
    table = _align_points.search_table(calibration).copy()
    table[[14, 15, 18, 19]] -= 0.5
    x, y, parameters, _, fills = _align_points.tables(calibration)
    small_box = x, y, parameters, jnp.asarray(table), fills
    with (
        mock.patch.object(_align_points, "tables", return_value=small_box),
        pytest.raises(AssertionError, match="depth"),
    ):
        assert_dense(noise_depth(1, calibration.depth), calibration)


def test_rays_are_linear_in_the_pixels():
    """What the margin is reckoned from: the table of rays is within 2 roundings of a line."""
    for camera in (D435.depth, resized(D435.depth, 848, 480)):
        table = corner_rays(camera)[0][0].astype(float)
        line = (np.arange(camera.width + 1) - 0.5 - np.float32(camera.cx)) / np.float32(camera.fx)
        assert np.abs(table - line).max() <= 2.1 * 2.0**-24 * np.abs(table).max()
