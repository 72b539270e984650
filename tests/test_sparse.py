"""Features whose depth is looked up, not aligned: ``detect`` equals the reference, hostile or not.

On CUDA ``detect`` looks depth up for these calibrations; elsewhere the same comparisons hold for
whatever the device does.
"""

from dataclasses import replace

import jax
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from jaxdet import detect
from jaxdet.config import Config, FeaturesConfig, GroundConfig
from jaxdet.presets import PRESETS
from jaxdet.stages import _align_points, _corners_cuda
from jaxdet.types import Calibration, Extrinsics, Frames
from tests.scenes import (
    assert_equal,
    blocks,
    frames,
    level,
    noise_depth,
    rotation,
    small,
    smooth_depth,
    with_lens,
)

TURNED = Extrinsics(rotation(3, -5, 8), (-0.03, 0.01, 0.02))
SMALL = small(96, 61)
CALIBRATIONS = {
    "d435": SMALL,
    "turned": small(75, 51, 1.6)._replace(color_from_depth=TURNED),
    "coarse": small(97, 61, 0.6)._replace(color_from_depth=TURNED),
}


def hostile_colors(height: int, width: int) -> list[np.ndarray]:
    """Noise, nothing, all edges in three ways, one huge component, a square, ties, blocks."""
    y, x = np.mgrid[:height, :width]
    angle, radius = (
        np.arctan2(y - height / 2, x - width / 2),
        np.hypot(y - height / 2, x - width / 2),
    )
    square = np.zeros((height, width))
    square[height // 3 : height // 2, width // 3 : width // 2] = 1
    patterns = [
        np.zeros((height, width)),
        (x + y) % 2,
        x // 8 % 2,
        y // 5 % 2,
        (radius + 5 * angle) // 6 % 2,
        square,
        (y // 4 + x // 4) % 2,
    ]
    noise = np.random.default_rng(1).integers(0, 256, (height, width, 3))
    grey = [np.repeat(255 * p[..., None], 3, axis=-1) for p in patterns]
    return [image.astype(np.uint8) for image in (noise, *grey, blocks(1, height, width)[0])]


def hostile_depths(camera) -> list[np.ndarray]:
    """A wall, noise, single units, out of range, nothing, ties, one pixel, screens and dust."""
    rng = np.random.default_rng(2)
    shape = camera.height, camera.width
    one = np.zeros(shape)
    one[camera.height // 2, camera.width // 2] = 1000
    dust = rng.random(shape)
    made = [
        rng.integers(0, 6, shape),
        np.full(shape, 9000),
        np.zeros(shape),
        np.full(shape, 1000),
        one,
        np.where(dust < 0.5, 100, 1500),
        np.where(dust < 0.02, 1500, 0),
        np.exp(rng.uniform(0, np.log(65536), shape)),
    ]
    plain = [smooth_depth(1, camera)[0], noise_depth(1, camera)[0]]
    return plain + [image.astype(np.uint16) for image in made]


def pairs(calibration: Calibration) -> Frames:
    """Every hostile colour image with four of the hostile depth images, each of those in use."""
    color = hostile_colors(calibration.color.height, calibration.color.width)
    depth = hostile_depths(calibration.depth)
    both = [(c, depth[(3 * i + k) % len(depth)]) for i, c in enumerate(color) for k in range(4)]
    return frames(
        calibration,
        np.stack([c for c, _ in both]),
        np.stack([d for _, d in both]),
        plane=level(len(both), 0.4, 0.2, 0.1),
    )


FEATURES = FeaturesConfig()
CONFIGS = {
    "default": Config(),
    "paper": PRESETS["paper"],
    "corners": replace(Config(), features=replace(FEATURES, grid_columns=0)),
    "full": replace(
        Config(), features=replace(FEATURES, min_distance=0.0, max_corners=4000, grid_columns=0)
    ),
    "strongest": replace(Config(), features=replace(FEATURES, quality_level=1.0)),
    "weakest": replace(
        Config(),
        features=replace(FEATURES, quality_level=1e-6, max_corners=64, grid_columns=20),
    ),
    "any_depth": replace(Config(), ground=GroundConfig(min_depth_m=0.0, max_depth_m=65.5)),
}


CASES = [(name, "d435") for name in CONFIGS]
CASES += [("default", "turned"), ("strongest", "coarse"), ("paper", "turned")]


@pytest.mark.parametrize(("name", "calibration"), CASES)
def test_hostile_frames(device, name, calibration):
    given_ = pairs(CALIBRATIONS[calibration])
    assert _align_points.covers(given_.calibration)
    want = detect(given_, CONFIGS[name], backend="reference")
    assert want.features.valid.any() and not want.has_depth.all() and want.has_depth.any()
    assert_equal(detect(given_, CONFIGS[name]), want)


def test_more_maxima_than_the_list_holds(device, monkeypatch):
    """On CUDA a frame whose list overflows is done by its block alone."""
    given_ = pairs(SMALL)
    want = detect(given_, backend="reference")
    monkeypatch.setattr(_corners_cuda, "CANDIDATES", 256)
    jax.clear_caches()
    assert_equal(detect(given_), want)
    jax.clear_caches()


@given(
    st.integers(0, 2**32 - 1),
    st.integers(1, 40),
    st.floats(0, 1),
    st.sampled_from([1, 3, 200, 3000, 65535]),
    st.sampled_from(["default", "paper", "corners"]),
)
@settings(max_examples=12, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_made_frames(device, seed, mesh, holes, deepest, name):
    rng = np.random.default_rng(seed)
    cells = rng.integers(0, 256, (2, 61 // mesh + 1, 96 // mesh + 1, 3))
    color = cells.repeat(mesh, axis=1).repeat(mesh, axis=2)[:, :61, :96].astype(np.uint8)
    depth = rng.integers(1, deepest + 1, (2, 61, 96)).astype(np.uint16)
    depth[rng.random(depth.shape) < holes] = 0
    given_ = frames(SMALL, color, depth, plane=level(2, rng.uniform(0.1, 1), rng.uniform(0, 1)))
    want = detect(given_, CONFIGS[name], backend="reference")
    assert_equal(detect(given_, CONFIGS[name]), want)


def test_what_needs_the_dense_alignment():
    bent = SMALL._replace(color=with_lens(SMALL.color, "plumb_bob"))
    assert not _align_points.covers(bent)
    assert not _align_points.covers(Calibration(SMALL.color))
