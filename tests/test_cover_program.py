"""Features on cells equal the reference."""

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
from jaxdet.types import MAX_OBSTACLES, SAMPLED_CELLS, Calibration, Features, Keep
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
    keep = (grid.z > 0) & (np.arange(grid.z.shape[2]) % 7 > 1)
    batch, bounds = len(depth), np.array([500, 1200], np.int32)
    taken = keep & grid.in_view & (grid.z <= bounds[1])

    over = cover(grid, taken, color)
    frame = np.arange(batch)[:, None]
    z = grid.z.reshape(batch, -1)[frame[..., None], over]
    z = np.where(over >= 0, z, 0).astype(np.uint16)
    mask = over >= 0
    expected = reference.features(image, Keep(mask, z, mask.any(axis=(1, 2))), calibration, config)
    cell = np.where(expected.valid, over[frame, expected.v, expected.u], -1)
    label = np.random.default_rng(0).integers(-1, 2 * MAX_OBSTACLES, grid.z.shape).astype(np.int32)
    own = np.take_along_axis(label.reshape(batch, -1), np.maximum(cell, 0), axis=1)
    own = np.where((cell >= 0) & (own < MAX_OBSTACLES), own, -1)

    def sample(values: np.ndarray) -> np.ndarray:
        return values[SAMPLED_CELLS].reshape(batch, -1)

    shown = keep & grid.in_view & ((grid.z <= bounds[1]) | (label >= 0))
    assert (keep & grid.in_view & ~shown).any()
    middle = np.moveaxis(grid.middle.astype(np.int32), -1, 0)
    columns = [*middle, grid.x, grid.y, grid.z, shown, shown]
    sampled = Features(*map(sample, columns), overflow=expected.overflow)
    of_cells = np.where(grid.in_view & (label < MAX_OBSTACLES), label, -1)

    run = jax.jit(_cover.features_on_cells, static_argnames="slots")
    rays, settings, slots = _features.rays(color), corner_settings(config), config.max_corners
    out = run(image, grid, keep, label, rays, settings, bounds, slots=slots)
    columns, labels, has_depth = jax.tree.map(np.asarray, out)
    points = Features(*columns, overflow=expected.overflow)
    assert expected.kept.sum() > 20
    assert_equal(_part(points, slice(0, slots)), expected)
    assert_equal(_part(points, slice(slots, None)), sampled)
    np.testing.assert_array_equal(labels, np.concatenate([own, sample(of_cells)], axis=1))
    in_range = grid.in_view & (grid.z >= bounds[0]) & (grid.z <= bounds[1])
    np.testing.assert_array_equal(has_depth, in_range.any(axis=(1, 2)))


def _part(points: Features, slots: slice) -> Features:
    columns = (a[:, slots] for a in points[:-1])
    return Features(*columns, overflow=points.overflow)
