"""features equals the reference on adversarial images, and on images that hypothesis finds."""

from dataclasses import replace
from itertools import product

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxdet import reference, stages
from jaxdet.config import FeaturesConfig
from jaxdet.reference.paper._corners import STEP
from jaxdet.types import Calibration
from tests.scenes import D435_COLOR, assert_equal, recorded_colors, resized

CORNERS = FeaturesConfig(max_corners=200)


def spiral(height: int, width: int) -> np.ndarray:
    """Return a connected white spiral from border to centre, with a pitch of four pixels."""
    image = np.zeros((height, width), np.uint8)
    left, top, right, bottom = 0, 0, width - 1, height - 1
    while right - left > 12 and bottom - top > 12:
        corners = [(left, top), (right, top), (right, bottom), (left, bottom), (left, top + 4)]
        for a, b in zip(corners, [*corners[1:], (left + 4, top + 4)], strict=True):
            cv2.line(image, a, b, 255, 1)
        left, top, right, bottom = left + 4, top + 4, right - 4, bottom - 4
    return image


def hostile(height: int, width: int) -> dict[str, np.ndarray]:
    """Return adversarial grey images ``(H, W)`` by name."""
    rng = np.random.default_rng(height * width)
    v, u = np.mgrid[:height, :width]
    images = {
        "black": np.zeros((height, width)),
        "noise": rng.integers(0, 256, (height, width)),
        "noise above black": rng.integers(0, 2, (height, width)) * 255 * (v < height // 2),
        "two levels": rng.integers(0, 2, (height, width)) * 255,
        "checkerboard": (u + v) % 2 * 255,
        "squares": (u // 4 + v // 4) % 2 * 255,
        "columns": u // 2 % 2 * 255,
        "rows": v // 3 % 2 * 255,
        "diagonals": (u + v) // 3 % 2 * 255,
        "spiral": spiral(height, width),
        "ramp": (37 * u + 11 * v) % 256,
        "border": np.where((u == 0) | (v == 0) | (u == width - 1) | (v == height - 1), 255, 0),
        "one dot": np.where((u == width // 2) & (v == height // 2), 255, 0),
    }
    return {name: image.astype(np.uint8) for name, image in images.items()}


SETTINGS = {
    "default": CORNERS,
    "full": replace(CORNERS, max_corners=5),
    "all edges": replace(CORNERS, canny_low=0.0, canny_high=0.0, min_distance=1.0),
    "weak corners": replace(CORNERS, quality_level=1e-30, min_distance=0.0, max_corners=8192),
    "strong corners": replace(CORNERS, quality_level=1.0, min_distance=2.5),
    "a few pixels apart": replace(CORNERS, min_distance=7.0),
    "negative bounds": replace(CORNERS, canny_low=-3.0, canny_high=-1.0),
    "bounds no pixel reaches": replace(CORNERS, canny_low=2000.0, canny_high=1e5),
    "far apart": replace(CORNERS, min_distance=1000.0),
}


def compare(grey: np.ndarray, config: FeaturesConfig) -> None:
    """Assert that two runs equal the reference on grey images ``(B, H, W)``."""
    height, width = grey.shape[1:]
    color = np.repeat(grey[..., None], 3, axis=-1)
    z = np.random.default_rng(0).integers(0, 65536, grey.shape).astype(np.uint16)
    calibration = Calibration(resized(D435_COLOR, width, height))
    want = reference.paper.features(color, z, calibration, config)
    for _ in range(2):
        assert_equal(stages.paper.features(color, z, calibration, config), want)


def test_sums_of_products_are_exact():
    """Products of gradients are multiples of 2^-31, and nine of them sum up to at most 1."""
    windows = (np.arange(512)[:, None] >> np.arange(9) & 1).reshape(512, 3, 3)
    dx = ((windows[:, :, 2] - windows[:, :, 0]) @ [1, 2, 1]).astype(np.float32) * STEP
    smooth = (windows @ [1, 2, 1]).astype(np.float32) * STEP
    dy = smooth[:, 2] - smooth[:, 0]
    for products in (dx * dx, dx * dy, dy * dy):
        assert np.all(products.astype(np.float64) * 2.0**31 % 1 == 0)
        assert 9 * abs(products).max() < 1.0001


SIZES = [(48, 64), (33, 97), (20, 1100), (3, 3)]
LONGEST = [(7, 4096), (4096, 5)]
OF_THE_LONGEST = ("default", "full", "weak corners", "far apart")


@pytest.mark.parametrize(
    ("size", "name"),
    [*product(SIZES[:1], SETTINGS), *product(SIZES[1:] + LONGEST, OF_THE_LONGEST)],
)
def test_features_equal_the_reference_on_adversarial_images(device, size, name):
    compare(np.stack(list(hostile(*size).values())), SETTINGS[name])


def test_features_equal_the_reference_on_recordings(device, shared_data):
    rng = np.random.default_rng(2)
    for image in recorded_colors(shared_data)[::4]:
        color = image[None]
        z = rng.integers(0, 5000, color.shape[:3]).astype(np.uint16)
        calibration = Calibration(resized(D435_COLOR, image.shape[1], image.shape[0]))
        for config in (FeaturesConfig(), replace(CORNERS, quality_level=0.2)):
            want = reference.paper.features(color, z, calibration, config)
            assert_equal(stages.paper.features(color, z, calibration, config), want)


@given(
    seed=st.integers(0, 2**32 - 1),
    levels=st.sampled_from([2, 3, 5, 256]),
    width=st.sampled_from([3, 31, 33, 64, 70]),
    quality=st.sampled_from([1e-12, 0.01, 0.2, 1.0]),
    distance=st.sampled_from([0.0, 1.0, 2.0**0.5, 3.0, 4.7]),
    coarse=st.integers(1, 6),
)
@settings(max_examples=60)
def test_features_equal_the_reference_on_random_images(
    seed, levels, width, quality, distance, coarse
):
    rng = np.random.default_rng(seed)
    size = 2, 24 + seed % 2 * 13, width
    grey = rng.integers(0, levels, size) * (255 // (levels - 1))
    grey = grey.repeat(coarse, 1).repeat(coarse, 2)[:, : size[1], : size[2]].astype(np.uint8)
    config = replace(CORNERS, quality_level=quality, min_distance=distance, max_corners=64)
    compare(grey, config)
