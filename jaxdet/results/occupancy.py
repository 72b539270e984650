"""Floor grids in the world: the occupancy map of a log, and rasters of the shapes of a frame.

The map counts the outlines that cover each cell, and the frames that show the cell free.
"""

from collections import defaultdict
from collections.abc import Sequence
from itertools import islice
from pathlib import Path
from typing import Literal, NamedTuple
from zipfile import ZIP_DEFLATED, ZipFile, ZipInfo

import cv2
import numpy as np

from jaxdet.errors import InputError
from jaxdet.results.free_floor import Polygons

CELL_M = 0.05
"""Side of a cell [m]; cells are counted from the world's origin."""
TILE = 256
"""Side of a tile [cell]; a tile is made when a shape first touches it."""
MAX_CELLS = 1 << 26
"""Maximum number of cells in a map."""
MAX_OUTLINE_CELLS = 1 << 22
"""Maximum number of cells in the box around an outline or around a frame's free floor."""

Tiles = defaultdict[tuple[int, int], np.ndarray]
"""Counts ``(TILE, TILE)`` int32 by row and column of the tile."""

SHIFT = 6
"""Number of fraction bits of coordinates [cell] that are passed to OpenCV's drawing functions."""
UNITS = 1 << SHIFT


class MapImage(NamedTuple):
    """Occupancy map; row 0 is the lowest Y."""

    counts: np.ndarray
    """Number of outlines that cover each cell, ``(rows, columns)`` int32."""
    free: np.ndarray
    """Number of frames that saw each cell free, ``(rows, columns)`` int32. A cell for which this
    and the number of outlines are 0 is unknown."""
    origin: tuple[float, float]
    """World X and Y of the outer corner of cell (0, 0) [m]."""
    cell_m: float
    """Side of a cell [m]."""
    path: np.ndarray
    """World X and Y of the camera in the order of the frames, ``(F, 2)`` float64 [m]."""


class OccupancyMap:
    """Integer counts on tiles, which don't depend on the order of the frames.

    A cell is occupied if an outline covers it, free if it was only seen free, otherwise unknown.
    Outlines and free floors that are too far away for 32-bit numbers of cells, or too large, are
    counted in ``skipped``.
    """

    def __init__(self) -> None:
        self.tiles: Tiles = defaultdict(_empty_tile)
        self.free_tiles: Tiles = defaultdict(_empty_tile)
        self.path: list[np.ndarray] = []
        self.skipped = 0

    def add_path(self, T_world_camera: np.ndarray) -> None:
        """Append the positions of poses ``(B, 4, 4)``; unknown poses, with NaN, are left out."""
        xy = T_world_camera[:, :2, 3]
        self.path.append(xy[np.isfinite(xy).all(axis=1)])

    def add(self, corners: np.ndarray) -> None:
        """Count outlines ``(R, 8)``, world X and Y [m]; outlines with NaN are left out."""
        known = corners[np.isfinite(corners).all(axis=1)].reshape(-1, 2)
        outlines, low, size, fits = placed(known, np.full(len(known) // 4, 4))
        self.skipped += int((~fits).sum())
        (used,) = np.nonzero(fits)
        outlines = outlines.reshape(-1, 4, 2)
        # Outlines are counted tile by tile, as outlines in one call should be near each other.
        column, row = low[used].T // TILE
        tiles, tile = np.unique((column << 32) + row, return_inverse=True)
        for number in range(len(tiles)):
            part = used[tile == number]
            _add_outlines(self.tiles, outlines[part], low[part], size[part])

    def add_free(self, free: Polygons | None) -> None:
        """Count free floor; a cell counts once per frame, even if several polygons cover it."""
        if free is None:
            return
        first = np.flatnonzero(np.diff(free.frame, prepend=-1))
        last = np.append(first[1:], len(free.frame))
        corners = np.concatenate([[0], np.cumsum(free.corners)])
        points, low, size, fits = placed(free.points, corners[last] - corners[first])
        self.skipped += int((~fits).sum())
        polygons = np.split(points, corners[1:-1])
        for g in np.flatnonzero(fits).tolist():
            mask = np.zeros(size[g, ::-1], np.int32)
            parts = polygons[first[g] : last[g]]
            cv2.fillPoly(mask, parts, (1,), cv2.LINE_8, SHIFT)
            _add_to_tiles(self.free_tiles, mask, *low[g].tolist())

    def merge(self, later: "OccupancyMap") -> None:
        """Add the counts of another map, whose path continues the path of this map."""
        self.path += later.path
        self.skipped += later.skipped
        for mine, more in ((self.tiles, later.tiles), (self.free_tiles, later.free_tiles)):
            for place, tile in more.items():
                mine[place] = mine[place] + tile if place in mine else tile

    @property
    def cells(self) -> int:
        """Number of cells in the smallest rectangle of tiles that contains all counts."""
        _, shape = self._place()
        return int(shape[0]) * int(shape[1])

    def _place(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the lowest tile, and the numbers of rows and columns of cells."""
        keys = np.array([*self.tiles, *self.free_tiles])
        if not len(keys):
            return np.zeros(2, int), np.zeros(2, int)
        low = keys.min(axis=0)
        return low, (keys.max(axis=0) - low + 1) * TILE

    def image(self) -> MapImage | None:
        """Return the map as one array; None if it is empty or would be too large."""
        path = np.concatenate(self.path) if self.path else np.zeros((0, 2))
        if not 0 < self.cells <= MAX_CELLS:
            return None
        low, shape = self._place()
        counts, free = (_joined(tiles, low, shape) for tiles in (self.tiles, self.free_tiles))
        origin = (float(low[1]) * TILE * CELL_M, float(low[0]) * TILE * CELL_M)
        return _cropped(MapImage(counts, free, origin, CELL_M, path))


class Placed(NamedTuple):
    """Groups of points, each in the smallest box of cells around it."""

    points: np.ndarray
    """Points relative to the middle of the first cell, ``(P, 2)`` int32 [``UNITS`` per cell]."""
    low: np.ndarray
    """Column and row of the first cell, ``(G, 2)`` int64."""
    size: np.ndarray
    """Numbers of columns and rows, ``(G, 2)`` int64."""
    fits: np.ndarray
    """Whether the group is small enough and near enough for the map, ``(G,)`` bool."""


def placed(points: np.ndarray, count: np.ndarray) -> Placed:
    """Return groups of points in units of cells; the middles of cells have integer coordinates.

    Args:
        points: World X and Y of all groups, one after the other, ``(P, 2)`` [m].
        count: Number of points of each group, at least one, ``(G,)`` integer.
    """
    cells, start = points.T.astype(np.float64, order="C"), np.cumsum(count) - count
    cells /= CELL_M
    cells -= 0.5
    low = np.floor(np.minimum.reduceat(cells, start, axis=1))
    size = np.ceil(np.maximum.reduceat(cells, start, axis=1)) - low + 1
    fits = (np.abs(low).max(axis=0) <= 1 << 30) & (size[0] * size[1] <= MAX_OUTLINE_CELLS)
    low, size = np.where(fits, [low, size], 0)
    cells -= np.repeat(low, count, axis=1)
    cells *= UNITS
    if not fits.all():
        cells[:, np.repeat(~fits, count)] = 0
    units = np.rint(cells, out=cells).T.astype(np.int32, order="C")
    return Placed(units, low.T.astype(np.int64), size.T.astype(np.int64), fits)


def _add_outlines(tiles: Tiles, outlines: np.ndarray, low: np.ndarray, size: np.ndarray) -> None:
    """Count convex outlines ``(R, 4, 2)`` that are near each other; see :class:`Placed`.

    All are drawn into one image, with their boxes one below the other.
    """
    below = np.cumsum(size[:, 1])
    top = below - size[:, 1]
    sheet = np.zeros((below[-1], size[:, 0].max()), np.uint8)
    outlines[:, :, 1] += (top * UNITS)[:, None]
    for outline in outlines:
        cv2.fillConvexPoly(sheet, outline, 1, cv2.LINE_8, SHIFT)
    row, column = np.divmod(np.flatnonzero(sheet.view(bool)), sheet.shape[1])

    origin = low.min(axis=0)
    width, height = (low + size).max(axis=0) - origin
    x, y = (low - origin).T
    line = np.repeat((y - top) * width + x, size[:, 1]) + np.arange(below[-1]) * width
    counts = np.bincount(line[row] + column, minlength=width * height).reshape(height, width)
    _add_to_tiles(tiles, counts, *origin.tolist())


def _empty_tile() -> np.ndarray:
    return np.zeros((TILE, TILE), np.int32)


def _add_to_tiles(tiles: Tiles, counts: np.ndarray, x: int, y: int) -> None:
    """Add counts ``(rows, columns)`` of a box of cells whose first cell is ``(x, y)``."""
    rows, columns = counts.shape
    for row in range(y // TILE, (y + rows - 1) // TILE + 1):
        for column in range(x // TILE, (x + columns - 1) // TILE + 1):
            top, left = row * TILE - y, column * TILE - x  # position of the tile in the counts
            up, aside = (top if top > 0 else 0), (left if left > 0 else 0)
            part = counts[up : top + TILE, aside : left + TILE]
            area = tiles[row, column][up - top : rows - top, aside - left : columns - left]
            area += part


def _joined(tiles: Tiles, low: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """Return tiles as one array, whose first tile is ``low``."""
    counts = np.zeros((int(shape[0]), int(shape[1])), np.int32)
    for (row, column), tile in tiles.items():
        top, left = (row - int(low[0])) * TILE, (column - int(low[1])) * TILE
        counts[top : top + TILE, left : left + TILE] = tile
    return counts


def save_map(path: Path, image: MapImage) -> None:
    """Write the map as npz.

    Its arrays are ``counts`` and ``free`` (H, W) int32, ``origin`` (2,), ``cell_m`` and ``path``
    (F, 2), see :class:`MapImage`.
    """
    arrays = {
        "counts": image.counts,
        "free": image.free,
        "origin": np.array(image.origin),
        "cell_m": np.array(image.cell_m),
        "path": image.path,
    }
    # savez_compressed is not used, as it declares large entries, whose bytes depend on Python.
    with ZipFile(path, "w") as file:
        for name, array in arrays.items():
            entry = ZipInfo(f"{name}.npy")
            entry.compress_type = ZIP_DEFLATED
            with file.open(entry, "w") as part:
                np.lib.format.write_array(part, array, allow_pickle=False)


def load_map(path: Path) -> MapImage:
    """Return the map that :func:`save_map` wrote.

    Raises:
        InputError: The file is missing, or not a map.
    """
    try:
        with path.open("rb") as file, np.load(file) as parts:  # NumPy leaves damaged files open
            x, y = parts["origin"].tolist()
            cell = float(parts["cell_m"])
            image = MapImage(parts["counts"], parts["free"], (x, y), cell, parts["path"])
            _check_map(image)
            return image
    except Exception as error:  # a damaged file causes various errors in zip, zlib and NumPy
        raise InputError("is not a map", path=str(path), remedy="run jaxdet run again") from error


def _check_map(image: MapImage) -> None:
    """Raise ValueError if an array of a map has a wrong shape, type or value."""
    shape = image.counts.shape
    good = len(shape) == 2 and min(shape) > 0 and image.free.shape == shape
    good = good and image.counts.dtype.kind == image.free.dtype.kind == "i"
    good = good and image.path.dtype.kind == "f" and image.path.shape[1:] == (2,)
    good = good and 1e-3 <= image.cell_m <= 10 and bool(np.isfinite(image.path).all())
    if not good or not all(abs(value) < 1e9 for value in image.origin):
        raise ValueError(image)


def _cropped(image: MapImage) -> MapImage:
    seen = (image.counts > 0) | (image.free > 0)
    rows, columns = np.flatnonzero(seen.any(axis=1)), np.flatnonzero(seen.any(axis=0))
    part = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    counts, free = (np.ascontiguousarray(a[part]) for a in (image.counts, image.free))
    x, y = image.origin
    origin = (x + float(columns[0]) * CELL_M, y + float(rows[0]) * CELL_M)
    return MapImage(counts, free, origin, CELL_M, image.path)


class Layer(NamedTuple):
    """Shapes whose cells get the same value."""

    value: int
    kind: Literal["areas", "outlines", "lines", "dots"]
    """Polygons that do not overlap; convex polygons; open lines; or sets of points."""
    shapes: Sequence[np.ndarray]
    """Corners of each shape, ``(n, 2)`` float64, world X and Y [m]."""
    thickness: int = 1
    """Thickness of lines and dots [cell]."""


class Raster(NamedTuple):
    """Cells around the shapes of a frame."""

    cells: np.ndarray
    """Values ``(rows, columns)`` uint8, 0 without a shape; row 0 is the lowest Y."""
    low: np.ndarray
    """Column and row of the first cell, counted from the world's origin, ``(2,)`` int64."""


def rasterize(layers: Sequence[Layer]) -> Raster | None:
    """Draw layers, each over the previous layers.

    Args:
        layers: Layers; shapes that are too large or too far away for a map are left out.

    Returns:
        The smallest raster around the shapes; None without shapes, or if it would be too large.
    """
    shapes = [shape for layer in layers for shape in layer.shapes]
    if not shapes:
        return None
    fits = placed(np.concatenate(shapes), np.array([len(shape) for shape in shapes])).fits
    fitting = [shape for shape, fit in zip(shapes, fits, strict=True) if fit]
    if not fitting:
        return None
    pad = CELL_M * max(layer.thickness // 2 + 1 for layer in layers)
    points = np.concatenate(fitting)
    around = [points, points.min(axis=0, keepdims=True) - pad, points.max(axis=0)[None] + pad]
    together = placed(np.concatenate(around), np.array([len(points) + 2]))
    if not together.fits[0]:
        return None
    places = np.split(together.points[:-2], np.cumsum([len(shape) for shape in fitting])[:-1])
    cells = np.zeros(together.size[0, ::-1], np.uint8)
    of = np.repeat(np.arange(len(layers)), [len(layer.shapes) for layer in layers])[fits]
    left = iter(places)
    for layer, count in zip(layers, np.bincount(of, minlength=len(layers)), strict=True):
        _draw(cells, layer, list(islice(left, count)))
    return Raster(cells, together.low[0])


def _draw(cells: np.ndarray, layer: Layer, places: list[np.ndarray]) -> None:
    if layer.kind == "areas" and places:
        cv2.fillPoly(cells, places, (layer.value,), cv2.LINE_8, SHIFT)
    elif layer.kind == "outlines":
        for place in places:
            cv2.fillConvexPoly(cells, place, (layer.value,), cv2.LINE_8, SHIFT)
    elif layer.kind == "dots":
        for place in places:  # a closed line of one point is a dot
            lines = list(place[:, None])
            cv2.polylines(cells, lines, True, (layer.value,), layer.thickness, cv2.LINE_8, SHIFT)
    elif places:
        cv2.polylines(cells, places, False, (layer.value,), layer.thickness, cv2.LINE_8, SHIFT)
