"""features: examples by hand, and comparisons with OpenCV and of kernel and reference."""

from dataclasses import replace
from typing import Any, cast

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxdet import reference, stages
from jaxdet.config import FeaturesConfig
from jaxdet.reference._rounding import lateral
from jaxdet.reference.paper._canny import canny, grey
from jaxdet.reference.paper._corners import corner_strength, strongest_corners
from jaxdet.stages.paper._features import lateral as lateral_twin
from jaxdet.stages.paper._features import on_device
from jaxdet.types import Calibration, Distortion
from tests.scenes import (
    D435,
    D435_COLOR,
    assert_equal,
    blocks,
    noise_depth,
    recorded_colors,
    resized,
)

SIZES = [(480, 640), (61, 96), (240, 320), (33, 64)]


def grey_images() -> list[np.ndarray]:
    """Return rendered, random, empty and chequered grey images; widths are multiples of 32."""
    rng = np.random.default_rng(3)
    images = [grey(blocks(1, *size)[0]) for size in SIZES]
    images.append(rng.integers(0, 256, (120, 160)).astype(np.uint8))
    images.append(np.zeros((40, 64), np.uint8))
    images.append((np.indices((64, 96)).sum(0) % 2 * 255).astype(np.uint8))
    return images


def corners_only(**changes) -> FeaturesConfig:
    """Return a configuration with the paper's thresholds."""
    plain = FeaturesConfig(canny_low=100, canny_high=200, min_distance=5.0)
    return replace(plain, **changes)


# OpenCV


def test_grey_equals_opencv_on_every_colour():
    g, b = np.meshgrid(np.arange(256), np.arange(256))
    for r in range(256):
        colors = np.stack([np.full_like(g, r), g, b], axis=-1).astype(np.uint8)
        assert np.array_equal(grey(colors), cv2.cvtColor(colors, cv2.COLOR_RGB2GRAY))


@pytest.mark.parametrize("bounds", [(100, 200), (50, 120.7), (300, 150), (0, 0), (1000, 2000)])
def test_canny_equals_opencv(bounds):
    for image in grey_images():
        assert np.array_equal(canny(image, *bounds), cv2.Canny(image, *bounds))


def test_corner_strengths_equal_those_of_opencv_except_for_rounding():
    for image in grey_images():
        edges = canny(image, 100, 200)
        opencv = cv2.cornerMinEigenVal(edges, 3, ksize=3)
        np.testing.assert_allclose(corner_strength(edges), opencv, rtol=0, atol=2.0**-24)


SELECTIONS = [(1024, 0.01, 5.0), (0, 0.05, 0.0), (300, 0.001, 10.5), (77, 0.01, 1.0)]


@pytest.mark.parametrize("selection", SELECTIONS)
def test_corners_of_rendered_edges_equal_opencv_in_order(selection):
    for image in grey_images()[:4]:
        edges = canny(image, 100, 200)
        got = strongest_corners(corner_strength(edges), *selection)
        assert np.array_equal(got, opencv_corners(edges, selection))


def opencv_corners(edges: np.ndarray, selection: tuple[int, float, float]) -> np.ndarray:
    """Return columns and rows ``(n, 2)`` of ``cv2.goodFeaturesToTrack``."""
    corners = cv2.goodFeaturesToTrack(edges, *selection)
    return np.zeros((0, 2), int) if corners is None else corners[:, 0].astype(int)


@pytest.mark.parametrize("bounds", [(50, 100), (100, 200)])
def test_corners_of_recordings_equal_opencv_except_for_the_order_of_ties(shared_data, bounds):
    for image in recorded_colors(shared_data):
        edges = canny(grey(image), *bounds)
        opencv_edges = cv2.Canny(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), *bounds)
        assert np.array_equal(edges, opencv_edges)
        for selection in (*SELECTIONS, (1024, 0.01, 10.5)):
            got = strongest_corners(corner_strength(edges), *selection)
            want = opencv_corners(edges, selection)
            assert set(map(tuple, got.tolist())) == set(map(tuple, want.tolist()))


@given(st.integers(0, 2**32 - 1), st.sampled_from([2, 3, 9, 256]), st.integers(3, 40))
@settings(max_examples=60)
def test_canny_equals_opencv_on_random_images(seed, levels, size):
    rng = np.random.default_rng(seed)
    image = (rng.integers(0, levels, (size, 2 * size)) * (255 // (levels - 1))).astype(np.uint8)
    low, high = sorted(rng.integers(0, 1200, 2).tolist())
    assert np.array_equal(canny(image, low, high), cv2.Canny(image, low, high))


# by hand


def test_corners_of_a_square_have_depth_and_metric_coordinates():
    color = np.zeros((1, 48, 64, 3), np.uint8)
    color[0, 16:32, 20:44] = 255
    camera = resized(D435_COLOR, 64, 48)._replace(fx=50.0, fy=50.0, cx=32.0, cy=24.0)
    z = np.full((1, 48, 64), 1000, np.uint16)
    config = corners_only(max_corners=8)
    found = reference.paper.features(color, z, Calibration(camera), config)
    assert found.valid[0].tolist() == [True] * 4 + [False] * 4
    at = sorted(zip(found.u[0, :4].tolist(), found.v[0, :4].tolist(), strict=True))
    # The edge is the outermost white pixels of the square; the strongest corners are just inside.
    assert at == [(21, 17), (21, 29), (41, 17), (41, 29)]
    assert np.array_equal(found.x[0, :4], (found.u[0, :4] - 32) * 20)
    assert np.array_equal(found.y[0, :4], (found.v[0, :4] - 24) * 20)


def test_more_corners_than_slots_are_flagged_as_overflow(device):
    color, z = blocks(2, 96, 128), np.full((2, 96, 128), 1000, np.uint16)
    color[1] = 7
    calibration = Calibration(resized(D435_COLOR, 128, 96))
    for backend in (reference, stages):
        found = backend.paper.features(color, z, calibration, corners_only(max_corners=5))
        assert np.asarray(found.overflow).tolist() == [True, False]
        assert np.asarray(found.valid).sum(1).tolist() == [5, 0]


def test_coordinates_are_undistorted():
    camera = D435_COLOR._replace(
        distortion=Distortion.PLUMB_BOB, coefficients=(-0.3, 0.1, 0.001, -0.002, 0.0)
    )
    color, z = blocks(1, 480, 640), np.full((1, 480, 640), 2000, np.uint16)
    found = reference.paper.features(color, z, Calibration(camera), corners_only())
    n = found.valid[0].sum()
    rays = np.stack([found.x[0, :n], found.y[0, :n], found.z[0, :n]], axis=1) / 2000
    pixels = cv2.projectPoints(
        rays.astype(float), np.zeros(3), np.zeros(3), camera.K, np.array(camera.coefficients)
    )[0][:, 0]
    assert n > 100
    assert np.abs(pixels - np.stack([found.u[0, :n], found.v[0, :n]], axis=1)).max() < 0.2


# twin


CONFIGS = {
    "default": FeaturesConfig(),
    "high bounds": corners_only(),
    "root": corners_only(max_corners=3000, min_distance=2**0.5),
    "few": corners_only(max_corners=20, min_distance=12.5),
    "dense": corners_only(max_corners=4000, min_distance=0, quality_level=0.0001),
}


@pytest.mark.twin
def test_features_equal_the_reference_with_two_cameras(device):
    depth, color = noise_depth(3, D435.depth), blocks(3, 480, 640)
    given_ = color, depth, D435, FeaturesConfig()
    want = reference.paper.features(*given_)
    assert (want.z > 0).sum() > 1000
    assert_equal(stages.paper.features(*given_), want)


@pytest.mark.twin
@pytest.mark.parametrize("width", [640, 424, 97, 31])
@pytest.mark.parametrize("name", CONFIGS)
def test_features_equal_the_reference_with_any_settings_and_width(device, name, width):
    height = 3 * width // 4
    color = blocks(3, height, width, width)
    color[2] = 0
    camera = resized(D435_COLOR, width, height)
    rng = np.random.default_rng(width)
    z = rng.integers(0, 5000, (3, height, width)).astype(np.uint16)
    given_ = color, z, Calibration(camera), CONFIGS[name]
    want = reference.paper.features(*given_)
    assert want.valid[:2].any()
    assert_equal(stages.paper.features(*given_), want)


def test_new_settings_need_no_compilation():
    color, z = blocks(1, 60, 80), np.full((1, 60, 80), 900, np.uint16)
    calibration = Calibration(resized(D435_COLOR, 80, 60))
    compiled = cast(Any, on_device)._cache_size
    before, found = compiled(), []
    for changes in (
        {},
        {"canny_low": 20.0, "canny_high": 400.0},
        {"quality_level": 0.3},
        {"min_distance": 9.5},
    ):
        given_ = color, z, calibration, corners_only(max_corners=300, **changes)
        found.append(stages.paper.features(*given_))
        assert_equal(found[-1], reference.paper.features(*given_))
    assert len({np.asarray(each.valid).sum() for each in found}) == len(found)
    assert compiled() == before + 1


@pytest.mark.twin
@given(
    st.lists(st.integers(-(4 << 20), 4 << 20), min_size=1, max_size=50),
    st.integers(0, 65535),
)
def test_lateral_positions_are_exact_in_32_bits(rays, z):
    ray = np.array(rays, np.int32)
    depth = np.full(len(rays), z, np.int32)
    exact = [(int(r) * z + (1 << 19)) >> 20 for r in rays]
    assert lateral(ray, depth).tolist() == exact
    assert np.asarray(lateral_twin(ray, depth)).tolist() == exact
