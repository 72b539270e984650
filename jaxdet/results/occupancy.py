"""The map of a whole log: how often each cell was an obstacle's, and how often free."""

from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

CELL_M = 0.05
"""Side of a cell [m]; cells are counted from the world's origin."""
TILE = 256
"""Side of a tile [cell]; only tiles that something touches exist."""
MAX_CELLS = 1 << 26
MAX_OUTLINE_CELLS = 1 << 22

_SHIFT = 6
_UNITS = 1 << _SHIFT


class MapImage(NamedTuple):
    """An occupancy map; row 0 is the lowest Y."""

    counts: np.ndarray
    """``(rows, columns)`` int32, outlines that cover each cell."""
    free: np.ndarray
    """``(rows, columns)`` int32, frames that saw it free; not known where both are 0."""
    origin: tuple[float, float]
    """World X and Y of the outer corner of cell (0, 0) [m]."""
    cell_m: float
    """Side of a cell [m]."""
    path: np.ndarray
    """``(F, 2)`` float64, world X and Y of the camera, in frame order [m]."""


class OccupancyMap:
    """Integer counts on tiles, so neither the order of the frames nor the path's length matters.

    A cell is occupied where an outline covers it, free where it was only seen free, else not known.
    What has no place on the map (further than a 32-bit cell number, or absurdly large), outlines
    and the free floor of frames, is counted in ``skipped``.
    """

    def __init__(self) -> None:
        self.tiles: dict[tuple[int, int], np.ndarray] = {}
        self.free_tiles: dict[tuple[int, int], np.ndarray] = {}
        self.path: list[np.ndarray] = []
        self.skipped = 0

    def add_path(self, T_world_camera: np.ndarray | None) -> None:
        """Appends the cameras' positions of poses ``(B, 4, 4)``; unknown ones are left out."""
        if T_world_camera is not None:
            xy = T_world_camera[:, :2, 3]
            self.path.append(xy[np.isfinite(xy).all(axis=1)])

    def add(self, corners: np.ndarray) -> None:
        """Counts outlines ``(R, 8)`` float32, world X and Y [m]; NaN ones are left out."""
        for polygon in corners[np.isfinite(corners).all(axis=1)].reshape(-1, 4, 2):
            self._add_union(self.tiles, polygon[None])

    def add_free(self, fans: np.ndarray | None) -> None:
        """Counts free floor ``(F, n, 4, 2)``, convex, world X and Y [m]; NaN is left out.

        A cell that several of a frame's parts cover is counted once for the frame.
        """
        for parts in [] if fans is None else fans:
            known = parts[np.isfinite(parts).all(axis=(1, 2))]
            if len(known):
                self._add_union(self.free_tiles, known)

    def _add_union(self, tiles: dict[tuple[int, int], np.ndarray], polygons: np.ndarray) -> None:
        """Counts the cells that any of these convex polygons ``(n, 4, 2)`` [m] covers."""
        cells = polygons.astype(np.float64) / CELL_M - 0.5
        low = np.floor(cells.min(axis=(0, 1))).astype(np.int64)
        size = np.ceil(cells.max(axis=(0, 1))).astype(np.int64) - low + 1
        if np.abs(low).max() > 1 << 30 or int(size[0]) * int(size[1]) > MAX_OUTLINE_CELLS:
            self.skipped += 1
            return
        mask = np.zeros((int(size[1]), int(size[0])), np.uint8)
        for points in np.rint((cells - low) * _UNITS).astype(np.int32):
            cv2.fillConvexPoly(mask, points, 1, cv2.LINE_8, _SHIFT)
        first, last = low // TILE, (low + size - 1) // TILE
        for row in range(int(first[1]), int(last[1]) + 1):
            for column in range(int(first[0]), int(last[0]) + 1):
                tile = tiles.setdefault((row, column), np.zeros((TILE, TILE), np.int32))
                _add_to_tile(tile, mask, low, row, column)

    def image(self) -> MapImage | None:
        """The map as one array, or None when nothing is on it or it would be too large."""
        path = np.concatenate(self.path) if self.path else np.zeros((0, 2))
        keys = np.array([*self.tiles, *self.free_tiles])
        if not len(keys):
            return None
        low = keys.min(axis=0)
        shape = (keys.max(axis=0) - low + 1) * TILE
        if int(shape[0]) * int(shape[1]) > MAX_CELLS:
            return None
        counts, free = (_joined(tiles, low, shape) for tiles in (self.tiles, self.free_tiles))
        origin = (float(low[1]) * TILE * CELL_M, float(low[0]) * TILE * CELL_M)
        return _cropped(MapImage(counts, free, origin, CELL_M, path))


def _add_to_tile(
    tile: np.ndarray, mask: np.ndarray, low: np.ndarray, row: int, column: int
) -> None:
    x, y = int(low[0]) - column * TILE, int(low[1]) - row * TILE
    part = mask[max(0, -y) : TILE - y, max(0, -x) : TILE - x]
    x, y = max(x, 0), max(y, 0)
    tile[y : y + part.shape[0], x : x + part.shape[1]] += part


def _joined(
    tiles: dict[tuple[int, int], np.ndarray], low: np.ndarray, shape: np.ndarray
) -> np.ndarray:
    """Tiles as one array, whose first tile is ``low``."""
    counts = np.zeros((int(shape[0]), int(shape[1])), np.int32)
    for (row, column), tile in tiles.items():
        top, left = (row - int(low[0])) * TILE, (column - int(low[1])) * TILE
        counts[top : top + TILE, left : left + TILE] = tile
    return counts


def save_map(path: Path, image: MapImage) -> None:
    """Writes the map as npz.

    ``counts`` and ``free`` (H, W) int32, ``origin`` (2,), ``cell_m`` and ``path`` (F, 2), see
    :class:`jaxdet.render.MapImage`.
    """
    np.savez_compressed(
        path,
        counts=image.counts,
        free=image.free,
        origin=np.array(image.origin),
        cell_m=np.array(image.cell_m),
        path=image.path,
    )


def _cropped(image: MapImage) -> MapImage:
    seen = (image.counts > 0) | (image.free > 0)
    rows, columns = np.flatnonzero(seen.any(axis=1)), np.flatnonzero(seen.any(axis=0))
    part = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    counts, free = (np.ascontiguousarray(a[part]) for a in (image.counts, image.free))
    x, y = image.origin
    origin = (x + float(columns[0]) * CELL_M, y + float(rows[0]) * CELL_M)
    return MapImage(counts, free, origin, CELL_M, image.path)
