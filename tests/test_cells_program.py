"""cells: the results of the kernel equal the reference."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxdet import reference
from jaxdet.camera import cell_side
from jaxdet.config import SurfaceConfig
from jaxdet.reference._cells import nearest_depths
from jaxdet.stages._tables import cell_tables
from jaxdet.types import Calibration, Cells, Intrinsics
from tests.scenes import (
    D435_DEPTH,
    assert_equal,
    noise_depth,
    small,
    smooth_depth,
    with_lens,
)
from tests.steps import cells

pytestmark = pytest.mark.twin

THREE = SurfaceConfig(cell_rad=0.0078)


def program(depth: np.ndarray, calibration: Calibration, config: SurfaceConfig) -> Cells:
    side = cell_side(calibration.depth, config.cell_rad)
    found, nearest = cells(depth, cell_tables(calibration, config), side)
    np.testing.assert_array_equal(nearest, nearest_depths(depth, side))
    return found


def assert_same(depth: np.ndarray, calibration: Calibration, config: SurfaceConfig) -> None:
    assert_equal(program(depth, calibration, config), reference.cells(depth, calibration, config))


@pytest.mark.parametrize("lens", ["pinhole", "plumb_bob", "inverse"])
def test_cells_equal_the_reference_with_every_lens(lens: str, device: Any) -> None:
    calibration = Calibration(with_lens(D435_DEPTH, lens))
    depth = np.concatenate([noise_depth(1, D435_DEPTH), smooth_depth(2, D435_DEPTH)])
    assert_same(depth, calibration, THREE)


@pytest.mark.parametrize("side", [1, 2, 3, 7, 8, 9, 15])
def test_cells_equal_the_reference_with_cells_of_any_side(side: int, device: Any) -> None:
    """Cells of nine pixels and more per side compute the median by bisection."""
    calibration = small(263, 195)
    camera = calibration.depth
    depth = np.concatenate([noise_depth(2, camera, side), smooth_depth(1, camera)])
    depth[1] = np.where(depth[1] % 3 == 0, 0, 1000 + depth[1] % 50)
    assert_same(depth, calibration, replace(THREE, cell_rad=side / camera.fx))


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1), st.sampled_from([1e-4, 0.00025, 0.001, 0.01]))
def test_cells_equal_the_reference_in_any_depth_unit(seed: int, unit: float) -> None:
    calibration = small(40, 30)._replace(depth_unit=unit)
    assert_same(noise_depth(2, calibration.depth, seed), calibration, replace(THREE, cell_rad=0.04))


def test_cells_equal_the_reference_on_images_smaller_than_a_cell(device: Any) -> None:
    camera = Intrinsics(7, 5, 640.0, 640.0, 3.5, 2.5)
    assert_same(np.full((3, 5, 7), 800, np.uint16), Calibration(camera), THREE)


def test_cells_equal_the_reference_without_depth_and_in_batches(device: Any) -> None:
    calibration = small(64, 48)
    assert_same(np.zeros((1, 48, 64), np.uint16), calibration, replace(THREE, cell_rad=0.05))
    assert_same(noise_depth(9, calibration.depth), calibration, replace(THREE, cell_rad=0.05))
