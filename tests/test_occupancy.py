"""The map of a log: integer counts that depend on no order."""

import numpy as np
import pytest

from jaxdet.results.occupancy import CELL_M, OccupancyMap


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


def fan(x: float, y: float, far: float) -> np.ndarray:
    """Two parts of one frame's free floor that share an edge, of 0.5 m and ``far``."""
    near = [[x, y], [x + 0.5, y], [x + 0.5, y + 0.5], [x, y + 0.5]]
    next_ = [[x, y + 0.5], [x + 0.5, y + 0.5], [x + far, y + 1.0], [x, y + 1.0]]
    return np.array([near, next_, np.full((4, 2), np.nan)])


def test_free_cells_are_counted_once_a_frame_in_any_order() -> None:
    views = np.stack([fan(0.0, 0.0, 0.5), fan(0.0, 0.0, 0.8), fan(-14.0, 13.0, 0.6)])
    one, other = OccupancyMap(), OccupancyMap()
    one.add_free(views)
    one.add_free(None)
    for view in views[::-1]:
        other.add_free(view[None])
    a, b = one.image(), other.image()
    assert a is not None and b is not None
    np.testing.assert_array_equal(a.free, b.free)
    assert a.free.max() == 2 and a.counts.max() == 0
    column, row = (np.array([0.25, 0.5]) - a.origin) // CELL_M
    assert a.free[int(row), int(column)] == 2


def test_a_cell_may_be_occupied_and_free() -> None:
    grid = OccupancyMap()
    grid.add(square(0.3, 0.3))
    grid.add_free(fan(0.0, 0.0, 0.5)[None])
    grid.add_free(np.full((1, 3, 4, 2), 1e12))
    image = grid.image()
    assert image is not None and grid.skipped == 1
    assert ((image.free > 0) & (image.counts > 0)).any()
    assert image.free.shape == image.counts.shape
    np.testing.assert_allclose(image.origin, (0.0, 0.0), atol=CELL_M)
