"""The map of a log: integer counts that depend on no order."""

import numpy as np
import pytest

from jaxdet.engine.occupancy import CELL_M, OccupancyMap


def square(x: float, y: float, side: float = 0.2) -> np.ndarray:
    return np.array([[x, y, x + side, y, x + side, y + side, x, y + side]], np.float32)


def test_map_counts_do_not_depend_on_order() -> None:
    spots = [(0.0, 0.0), (0.1, 0.1), (-30.0, 12.85), (12.75, -12.85), (0.0, 0.0)]
    outlines = np.concatenate([square(x, y) for x, y in spots])
    one, other = OccupancyMap(), OccupancyMap()
    one.add(outlines)
    for outline in outlines[::-1]:
        other.add(outline[None])
    a, b = one.image(), other.image()
    assert a is not None
    assert b is not None
    np.testing.assert_array_equal(a.counts, b.counts)
    assert a.origin == b.origin == pytest.approx((-30.0, -12.85), abs=CELL_M)
    assert a.counts.max() == 3


def test_map_cell_positions() -> None:
    grid = OccupancyMap()
    grid.add(square(1.0, 2.0))
    image = grid.image()
    assert image is not None
    assert 4 <= min(image.counts.shape) <= max(image.counts.shape) <= 6
    np.testing.assert_allclose(image.origin, (1.0, 2.0), atol=CELL_M)


def test_map_leaves_out_what_has_no_place() -> None:
    grid = OccupancyMap()
    grid.add(np.full((1, 8), np.nan, np.float32))
    grid.add(square(1e12, 0))
    grid.add(square(0, 0, 1e6))
    assert grid.image() is None
    assert grid.skipped == 2
