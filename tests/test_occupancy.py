"""Map of a log: integer counts that do not depend on the order of frames."""

from pathlib import Path
from zipfile import ZipFile

import cv2
import numpy as np
import pytest

from jaxdet.errors import InputError
from jaxdet.results.free_floor import Polygons
from jaxdet.results.occupancy import CELL_M, MapImage, OccupancyMap, load_map, save_map


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


def test_a_map_with_a_changed_byte_is_refused_or_differs(tmp_path: Path) -> None:
    """Python raises various errors for changed fields of a zip file; each is an InputError here."""
    drawn, path = OccupancyMap(), tmp_path / "map.npz"
    drawn.add(square(0.0, 0.0))
    image = drawn.image()
    assert image is not None
    save_map(path, image)
    content, refused = path.read_bytes(), 0
    for place in range(len(content)):
        path.write_bytes(content[:place] + b"\xff" + content[place + 1 :])
        try:
            load_map(path)
        except InputError:
            refused += 1
    assert refused > len(content) // 2


def test_a_map_has_no_bytes_that_depend_on_the_version_of_python(tmp_path: Path) -> None:
    """Since Python 3.11.4, zip entries declared as large have another version in their headers."""
    image = MapImage(
        np.ones((2, 3), np.int32), np.ones((2, 3), np.int32), (1.0, 2.0), CELL_M, np.zeros((1, 2))
    )
    save_map(tmp_path / "map.npz", image)
    with ZipFile(tmp_path / "map.npz") as file:
        heads = [(i.filename, i.extract_version, i.flag_bits, i.extra) for i in file.infolist()]
    names = "counts", "free", "origin", "cell_m", "path"
    assert heads == [(f"{name}.npy", 20, 0, b"") for name in names]
    again = load_map(tmp_path / "map.npz")
    assert all(np.array_equal(a, b) for a, b in zip(image, again, strict=True))


def test_the_map_of_an_outline_is_at_its_position() -> None:
    grid = OccupancyMap()
    grid.add(square(1.0, 2.0))
    image = grid.image()
    assert image is not None
    assert 4 <= min(image.counts.shape) <= max(image.counts.shape) <= 6
    np.testing.assert_allclose(image.origin, (1.0, 2.0), atol=CELL_M)


def test_obstacles_without_a_position_are_not_on_the_map() -> None:
    grid = OccupancyMap()
    grid.add(np.full((1, 8), np.nan, np.float32))
    grid.add(square(1e12, 0))
    grid.add(square(0, 0, 1e6))
    assert grid.image() is None
    assert grid.skipped == 2


def test_outlines_added_together_count_separately() -> None:
    rng = np.random.default_rng(3)
    middle = rng.uniform(-15, 15, (60, 1, 2))
    turn, side = rng.uniform(0, 7, (60, 1)), rng.uniform(0.0, 2.0, (60, 1, 2))
    way = turn + np.array([0.3, 1.2, 3.4, 4.3])
    outlines = middle + side * np.stack([np.cos(way), np.sin(way)], axis=-1)
    outlines = outlines.reshape(60, 8).astype(np.float32)
    together = OccupancyMap()
    together.add(outlines)
    expected = np.zeros((800, 800), np.int32)
    for corners in outlines.astype(np.float64).reshape(-1, 4, 2):
        mask = np.zeros_like(expected)
        cells = np.rint((corners / CELL_M - 0.5 + 400) * 64).astype(np.int32)
        expected += cv2.fillConvexPoly(mask, cells, 1, cv2.LINE_8, 6)
    image = together.image()
    assert image is not None and expected.max() > 1
    left, low = np.rint(np.array(image.origin) / CELL_M).astype(int) + 400
    rows, columns = image.counts.shape
    np.testing.assert_array_equal(image.counts, expected[low : low + rows, left : left + columns])
    assert image.counts.sum() == expected.sum()


def fan(x: float, y: float, far: float) -> Polygons:
    """Return two adjacent parts of the free floor of a frame, up to 0.5 m and ``far``."""
    near = [[x, y], [x + 0.5, y], [x + 0.5, y + 0.5], [x, y + 0.5]]
    next_ = [[x, y + 0.5], [x + 0.5, y + 0.5], [x + far, y + 1.0], [x, y + 1.0]]
    return Polygons(np.array([*near, *next_]), np.array([4, 4]), np.array([0, 0]))


def joined(views: list[Polygons]) -> Polygons:
    """Return views as successive frames, of which the second has no free floor."""
    points, corners, _ = (np.concatenate(parts) for parts in zip(*views, strict=True))
    return Polygons(points, corners, np.repeat([0, 2, 3], 2)[: len(corners)])


def test_free_cells_are_counted_once_per_frame_in_any_order() -> None:
    views = [fan(0.0, 0.0, 0.5), fan(0.0, 0.0, 0.8), fan(-14.0, 13.0, 0.6)]
    one, other = OccupancyMap(), OccupancyMap()
    one.add_free(joined(views))
    one.add_free(None)
    one.add_free(Polygons(np.zeros((0, 2)), np.zeros(0, int), np.zeros(0, int)))
    for view in views[::-1]:
        other.add_free(view)
    a, b = one.image(), other.image()
    assert a is not None and b is not None
    np.testing.assert_array_equal(a.free, b.free)
    assert a.free.max() == 2 and a.counts.max() == 0
    column, row = (np.array([0.25, 0.5]) - a.origin) // CELL_M
    assert a.free[int(row), int(column)] == 2


def test_a_map_cell_may_be_counted_as_occupied_and_as_free() -> None:
    grid = OccupancyMap()
    grid.add(square(0.3, 0.3))
    near, far = fan(0.0, 0.0, 0.5), fan(1e12, 1e12, 0.5)
    grid.add_free(joined([near, far]))
    image = grid.image()
    assert image is not None and grid.skipped == 1
    assert ((image.free > 0) & (image.counts > 0)).any()
    assert image.free.shape == image.counts.shape
    np.testing.assert_allclose(image.origin, (0.0, 0.0), atol=CELL_M)


def test_counts_of_merged_maps_add_up():
    square = np.array([[0.0, 0.0, 0.3, 0.0, 0.3, 0.3, 0.0, 0.3]])
    one, other, both = OccupancyMap(), OccupancyMap(), OccupancyMap()
    for corners, part in ((square, one), (square + 0.1, other)):
        part.add(corners)
        both.add(corners)
    one.merge(other)
    merged, wanted = one.image(), both.image()
    assert merged and wanted and wanted.counts.max() == 2
    np.testing.assert_array_equal(merged.counts, wanted.counts)


def test_skipped_frames_of_merged_maps_add_up():
    maps = [OccupancyMap(), OccupancyMap()]
    for one in maps:
        one.add(np.full((1, 8), 1e15))
    maps[0].merge(maps[1])
    assert maps[0].skipped == 2
