"""The complete program: depth that is already aligned, image borders, repeated calls."""

from dataclasses import replace
from itertools import product

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxdet import detect
from jaxdet.config import Config, GroundConfig
from jaxdet.presets import PRESETS
from jaxdet.types import Calibration, Frames
from tests.scenes import (
    assert_equal,
    blocks,
    frames,
    level,
    noise_depth,
    small,
    smooth_depth,
    with_lens,
)

pytestmark = pytest.mark.twin

CONFIGS = {
    "default": Config(),
    "paper": PRESETS["paper"],
    "near": replace(Config(), ground=GroundConfig(min_depth_m=0.0, max_depth_m=0.3)),
}


def aligned_frames(batch: int, width: int, height: int, lens: str = "pinhole") -> Frames:
    camera = with_lens(small(width, height).image, lens)
    depth = noise_depth(batch, camera, width)
    depth[0] = 0
    return frames(Calibration(camera), blocks(batch, height, width), depth, plane=level(batch, 0.3))


@pytest.mark.parametrize("lens", ["pinhole", "rational"])
@pytest.mark.parametrize(
    ("size", "name"),
    [*product([(96, 61), (33, 20), (9, 8)], ["default", "near"]), ((33, 20), "paper")],
)
def test_detections_equal_the_reference_with_aligned_depth(device, size, lens, name):
    given_ = aligned_frames(3, *size, lens), CONFIGS[name]
    want = detect(*given_, backend="reference")
    assert not want.has_depth[0]
    for _ in range(2):
        assert_equal(detect(*given_), want)


@given(st.sampled_from([1, 15, 40]), st.sampled_from([1, 16, 33]), st.integers(0, 65535))
@settings(max_examples=30)
def test_detections_equal_the_reference_with_one_pixel_of_depth(width, height, units):
    """The depth image has the minimum size, smaller than the tiles of the alignment."""
    calibration = small(48, 36)
    middle = {"cx": (width - 1) / 2, "cy": (height - 1) / 2}
    depth_camera = calibration.depth._replace(width=width, height=height, **middle)
    depth = np.zeros((1, height, width), np.uint16)
    depth[0, height // 2, width // 2] = units
    made = calibration._replace(depth=depth_camera)
    given_ = frames(made, blocks(1, 36, 48), depth, plane=level(1))
    assert_equal(detect(given_), detect(given_, backend="reference"))


@pytest.mark.parametrize(
    ("name", "lens", "depth_size", "color_size", "corners"),
    [
        ("wheeled", "pinhole", (80, 60), (1920, 1080), 250),
        ("wheeled", "plumb_bob", (641, 479), (1920, 1080), 250),
        ("wheeled", "rational", (1280, 720), (1281, 721), 200),
        ("paper", "rational", (1280, 720), (1281, 721), 100),
        ("wheeled", "equidistant", (639, 577), (2048, 515), 500),
        ("wheeled", "pinhole", (4096, 3072), (639, 481), 100),
    ],
)
def test_detections_equal_the_reference_with_large_images_and_lenses(
    device, name, lens, depth_size, color_size, corners
):
    """Images are as large as those of large cameras, more than 2^20 pixels, some with odd sides."""
    calibration = small()._replace(
        color=with_lens(small(*color_size).image, lens), depth=small(*depth_size).depth
    )
    depth = smooth_depth(1, small().depth)
    depth = cv2.resize(depth[0], depth_size, interpolation=cv2.INTER_NEAREST)[None]
    color = blocks(1, color_size[1], color_size[0])
    given_, config = frames(calibration, color, depth, plane=level(1, 0.3)), PRESETS[name]
    want = detect(given_, config, backend="reference")
    assert want.points is None or want.points.features.kept.sum() > corners
    assert want.num_obstacles[0] > 0
    assert_equal(detect(given_, config), want)


def test_results_do_not_change_with_images_in_aligned_memory():
    """Such images are read in place; results must not change if the images are changed later."""
    made = aligned_frames(2, 96, 61)
    memory = np.zeros(made.depth.nbytes + 64, np.uint8)
    start = -memory.ctypes.data % 64
    depth = memory[start : start + made.depth.nbytes].view(np.uint16).reshape(made.depth.shape)
    depth[:] = made.depth
    found = detect(made._replace(depth=depth))
    before = np.array(found.obstacles.num_points)
    depth[:] = 0
    assert np.array_equal(np.asarray(found.obstacles.num_points), before)
    assert_equal(found, detect(made, backend="reference"))
