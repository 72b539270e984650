"""features: the twin on images made to break it, and on what hypothesis finds."""

from dataclasses import replace
from itertools import product

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxdet import reference, stages
from jaxdet.config import FeaturesConfig
from jaxdet.reference._canny import canny
from jaxdet.reference._corners import STEP, _window_maximum, corner_strength
from jaxdet.types import Calibration, Keep
from tests.scenes import D435_COLOR, assert_equal, blocks, recorded_colors, resized

CORNERS = FeaturesConfig(max_corners=200)


def spiral(height: int, width: int) -> np.ndarray:
    """A white line of one piece from the border to the middle, four pixels from itself."""
    image = np.zeros((height, width), np.uint8)
    left, top, right, bottom = 0, 0, width - 1, height - 1
    while right - left > 12 and bottom - top > 12:
        corners = [(left, top), (right, top), (right, bottom), (left, bottom), (left, top + 4)]
        for a, b in zip(corners, [*corners[1:], (left + 4, top + 4)], strict=True):
            cv2.line(image, a, b, 255, 1)
        left, top, right, bottom = left + 4, top + 4, right - 4, bottom - 4
    return image


def hostile(height: int, width: int) -> dict[str, np.ndarray]:
    """Grey images ``(H, W)``."""
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
    "paper's order": replace(CORNERS, use_mask=False, min_distance=7.0),
    "negative bounds": replace(CORNERS, canny_low=-3.0, canny_high=-1.0),
    "bounds no pixel reaches": replace(CORNERS, canny_low=2000.0, canny_high=1e5),
    "far apart": replace(CORNERS, min_distance=1000.0),
}


def compare(grey: np.ndarray, mask: np.ndarray, config: FeaturesConfig) -> None:
    """Both implementations on grey images and masks ``(B, H, W)``; two runs give equal bytes."""
    batch, height, width = grey.shape
    color = np.repeat(grey[..., None], 3, axis=-1)
    z = np.random.default_rng(0).integers(0, 65536, grey.shape).astype(np.uint16)
    keep, calibration = (
        Keep(mask, z, np.ones(batch, bool)),
        Calibration(resized(D435_COLOR, width, height)),
    )
    want = reference.features(color, keep, calibration, config)
    for _ in range(2):
        assert_equal(stages.features(color, keep, calibration, config), want)


def test_sums_of_products_are_exact():
    """Products of gradients of all windows are multiples of 2^-31, and nine of them at most 1."""
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
    [*product(SIZES, SETTINGS), *product(LONGEST, OF_THE_LONGEST)],
)
def test_hostile_images(device, size, name):
    grey = np.stack(list(hostile(*size).values()))
    rng = np.random.default_rng(1)
    for mask in (
        np.ones(grey.shape, bool),
        rng.random(grey.shape) < 0.1,
        np.zeros(grey.shape, bool),
    ):
        compare(grey, mask, SETTINGS[name])


def test_a_mask_that_leaves_only_weak_corners(device):
    """The threshold follows the strongest allowed pixel, which no allowed maximum need be."""
    grey = blocks(2, 120, 160)[..., 1]
    dot = np.zeros(grey.shape, np.uint8)
    dot[:, ::7, ::9] = grey[:, ::7, ::9]
    for images in (grey, dot):
        strength = [corner_strength(canny(image, 50, 100)) for image in images]
        for quantile in (0.5, 0.9, 0.99):
            mask = np.stack([s < np.quantile(s[s > 0], quantile) for s in strength])
            for quality in (0.01, 0.3, 0.9):
                compare(images, mask, replace(CORNERS, quality_level=quality))


def test_allowed_corners_far_weaker_than_the_strongest(device):
    """And none between, so that a list of the stronger half says nothing about them."""
    rng, found = np.random.default_rng(5), 0
    for _ in range(400):
        image = np.zeros((1, 60, 64), np.uint8)
        for _ in range(2):
            v, u, tall, wide = rng.integers((4, 4, 1, 1), (40, 40, 14, 20))
            image[0, v : v + tall, u : u + wide] = rng.choice([255, 120, 60])
        strength = corner_strength(canny(image[0], 50, 100))
        share = strength / strength.max()
        maxima = share[strength == _window_maximum(strength)]
        if not ((maxima > 0.48) & (maxima < 0.995)).any() and ((maxima > 0.1) & (maxima < 1)).any():
            compare(image, (share < 0.48)[None], replace(CORNERS, quality_level=0.99))
            found += 1
    assert found >= 3


def test_recordings(device, shared_data):
    """Recorded images with a mask of blobs."""
    rng = np.random.default_rng(2)
    for image in recorded_colors(shared_data)[::4]:
        color = image[None]
        size = color.shape[1:3]
        blobs = cv2.GaussianBlur(rng.random(size), (0, 0), 20)
        keep = Keep(
            (blobs > 0.5)[None],
            rng.integers(0, 5000, (1, *size)).astype(np.uint16),
            np.ones(1, bool),
        )
        calibration = Calibration(resized(D435_COLOR, size[1], size[0]))
        for config in (FeaturesConfig(), replace(CORNERS, quality_level=0.2)):
            want = reference.features(color, keep, calibration, config)
            assert_equal(stages.features(color, keep, calibration, config), want)


@given(
    seed=st.integers(0, 2**32 - 1),
    levels=st.sampled_from([2, 3, 5, 256]),
    width=st.sampled_from([3, 31, 33, 64, 70]),
    share=st.floats(0, 1),
    quality=st.sampled_from([1e-12, 0.01, 0.2, 1.0]),
    distance=st.sampled_from([0.0, 1.0, 2.0**0.5, 3.0, 4.7]),
    coarse=st.integers(1, 6),
)
@settings(max_examples=150)
def test_random_images(seed, levels, width, share, quality, distance, coarse):
    rng = np.random.default_rng(seed)
    size = 2, 24 + seed % 2 * 13, width
    grey = rng.integers(0, levels, size) * (255 // (levels - 1))
    grey = grey.repeat(coarse, 1).repeat(coarse, 2)[:, : size[1], : size[2]].astype(np.uint8)
    config = replace(CORNERS, quality_level=quality, min_distance=distance, max_corners=64)
    compare(grey, rng.random(size) < share, config)
