"""Corners on cells equal the reference."""

from dataclasses import replace
from typing import Any

import jax
import numpy as np
import pytest

from jaxdet import reference
from jaxdet.config import FeaturesConfig, SurfaceConfig
from jaxdet.reference._cells import cover
from jaxdet.stages import _cover, _features
from jaxdet.stages._corners import corner_settings
from jaxdet.types import Calibration, Features, Keep
from tests.scenes import assert_equal, blocks, noise_depth, small, smooth_depth

CORNERS = FeaturesConfig(max_corners=200)
CELLS = SurfaceConfig(cell_rad=0.02)


@pytest.mark.parametrize("size", [(80, 60), (131, 97), (33, 31)])
@pytest.mark.parametrize("use_mask", [True, False])
@pytest.mark.parametrize("is_aligned", [True, False])
def test_corners(size: tuple[int, int], use_mask: bool, is_aligned: bool, device: Any) -> None:
    calibration = small(*size, color_scale=1.5)
    assert calibration.depth
    if is_aligned:
        calibration = Calibration(calibration.color)
    camera, color = calibration.depth or calibration.color, calibration.color
    depth = np.concatenate(
        [smooth_depth(2, camera), noise_depth(1, camera), 0 * smooth_depth(1, camera)]
    )
    image = blocks(len(depth), color.height, color.width)
    config = replace(CORNERS, use_mask=use_mask)
    grid = reference.cells(depth, calibration, CELLS)
    keep = grid.in_view & (grid.z < 1200) & (np.arange(grid.z.shape[2]) % 7 > 1)

    over = cover(grid, keep, color)
    frame = np.arange(len(depth))[:, None]
    z = grid.z.reshape(len(depth), -1)[frame[..., None], over]
    z = np.where(over >= 0, z, 0).astype(np.uint16)
    mask = over >= 0
    expected = reference.features(image, Keep(mask, z, mask.any(axis=(1, 2))), calibration, config)
    cell = np.where(expected.valid, over[frame, expected.v, expected.u], -1)

    run = jax.jit(_cover.corners_on_cells, static_argnames="slots")
    rays = _features.rays(color)
    settings = corner_settings(config)
    label = np.random.default_rng(0).integers(-1, 9, grid.z.shape).astype(np.int32)
    points, found, labels = run(image, grid, keep, label, rays, settings, slots=config.max_corners)
    assert expected.kept.sum() > 20
    assert_equal(Features(*(np.asarray(a) for a in points)), expected)
    np.testing.assert_array_equal(found, cell)
    own = np.take_along_axis(label.reshape(len(depth), -1), np.maximum(cell, 0), axis=1)
    np.testing.assert_array_equal(labels, np.where(cell >= 0, own, -1))
