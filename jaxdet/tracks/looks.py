"""Looks at places of the world: in which frames an obstacle or floor was seen there.

The place of an obstacle is the cells along its contour, the edge that the camera saw. A frame looks
at a cell if it shows there

- the contour of an obstacle,
- floor, by its rays of free floor, or
- the end of such a ray at something above the step that is too small for an obstacle.

What is hidden by something nearer, out of view or not measured is none of these. Contours and ends
count within their noise, :func:`thickness`. Looks at a cell begin with the first frame that shows
an obstacle there, so what is put down later has as many as what was there before.
"""

from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from jaxdet.io.motion import motion_matrix
from jaxdet.results.arrow import list_array, vectors
from jaxdet.results.free_floor import RAY_RAD, FreeFloor, ray_bearings
from jaxdet.results.metric import TILT, tilted, to_world
from jaxdet.results.occupancy import CELL_M, TILE
from jaxdet.results.raster import Layer, rasterize
from jaxdet.results.tables import Tables
from jaxdet.types import RAYS, FreeEnd

CHUNK_FRAMES = 64
"""Number of frames that are looked at together."""
NEAR_M, PER_M = 0.05, 0.01
"""Noise of a contour [m], and its growth with the square of the distance [1/m]."""
FOUND, FLOOR, OTHER = 0, 1, 2
"""Kinds of looks: an obstacle, floor, and something above the step."""
POSE_COLUMNS = ("camera_position_world", *TILT, "floor_source")
"""Columns of frames for :func:`poses`."""
FRAME_COLUMNS = (*POSE_COLUMNS, "free_bearing_rad", "free_from_m", "free_to_m", "free_end")
OBSTACLE_COLUMNS = ("contour", "distance_m")


class Lines(NamedTuple):
    """Contours of obstacles in the world."""

    points: np.ndarray
    """Points of all contours, ``(P, 2)`` float64, NaN without a pose or a floor [m]."""
    lengths: np.ndarray
    """Number of points of each obstacle, ``(N,)`` int64."""


class Looks:
    """Looks at the cells of a log, in tiles, so that memory grows with the area that was seen."""

    def __init__(self) -> None:
        self._tiles: dict[tuple[int, int], np.ndarray] = {}
        """By row and column of the tile, looks of each kind ``(3, TILE, TILE)`` int32."""

    def add(self, chunk: Tables) -> None:
        """Add the next frames.

        Args:
            chunk: With :data:`FRAME_COLUMNS` and :data:`OBSTACLE_COLUMNS`.
        """
        T = poses(chunk.frames)
        known = np.flatnonzero(np.isfinite(T).all(axis=(1, 2)))
        if not len(known):
            return
        free = free_floor(chunk.frames)
        areas = free.in_world(T)
        area_of = np.searchsorted(areas.frame, np.arange(len(T) + 1))
        polygons = np.split(areas.points, np.cumsum(areas.corners)[:-1])
        lines = contours(chunk, T)
        points = np.split(lines.points, np.cumsum(lines.lengths)[:-1])
        distance = chunk.obstacles["distance_m"].to_numpy()
        frame, ray = np.nonzero(free.end == FreeEnd.OBSTACLE)
        way = free.way[frame, ray]
        ends = np.stack([np.real(way), np.imag(way)], axis=1)
        ends = _in_world(ends * free.to_m[frame, ray, None], T[frame])
        end_of = np.searchsorted(frame, np.arange(len(T) + 1))
        first = chunk.first
        for f in known.tolist():
            here = slice(end_of[f], end_of[f + 1])
            own = slice(*first[f : f + 2].tolist())
            layers = [Layer(1 + FLOOR, "areas", polygons[area_of[f] : area_of[f + 1]])]
            wide = thickness(free.to_m[frame[here], ray[here]])
            layers += [Layer(1 + OTHER, "dots", [ends[here][wide == t]], t) for t in _falling(wide)]
            wide = thickness(distance[own])
            for t in _falling(wide):
                shapes = [points[own][i] for i in np.flatnonzero(wide == t)]
                layers.append(Layer(1 + FOUND, "lines", [s for s in shapes if len(s)], t))
            if raster := rasterize(layers):
                self._count(raster.cells, *raster.low.tolist())

    def _count(self, cells: np.ndarray, x: int, y: int) -> None:
        """Count a raster whose first cell has column ``x`` and row ``y``."""
        rows, columns = cells.shape
        for row in range(y // TILE, (y + rows - 1) // TILE + 1):
            for column in range(x // TILE, (x + columns - 1) // TILE + 1):
                top, left = row * TILE - y, column * TILE - x  # of the tile on the raster
                part = cells[max(top, 0) : top + TILE, max(left, 0) : left + TILE]
                tile = self._tiles.setdefault((row, column), np.zeros((3, TILE, TILE), np.int32))
                up, aside = max(-top, 0), max(-left, 0)
                area = tile[:, up : up + part.shape[0], aside : aside + part.shape[1]]
                area[FOUND] += part == 1 + FOUND
                known = area[FOUND] > 0
                area[FLOOR] += known & (part == 1 + FLOOR)
                area[OTHER] += known & (part == 1 + OTHER)

    def of(self, chunk: Tables) -> np.ndarray:
        """Return the looks at the places of obstacles, summed over their cells.

        Args:
            chunk: With the columns of :meth:`add`.

        Returns:
            ``(N, 3)`` int64, by kind; 0 without a place in the world.
        """
        lines = contours(chunk, poses(chunk.frames))
        found = np.zeros((len(lines.points), 3), np.int64)
        known = np.flatnonzero(np.isfinite(lines.points).all(axis=1))
        cell = np.floor(lines.points[known] / CELL_M).astype(np.int64)
        tiles, tile = np.unique(cell // TILE, axis=0, return_inverse=True)
        for number, (column, row) in enumerate(tiles.tolist()):
            if (row, column) in self._tiles:
                own = tile.ravel() == number
                x, y = (cell[own] % TILE).T
                found[known[own]] = self._tiles[row, column][:, y, x].T
        total = np.concatenate([np.zeros((1, 3), np.int64), np.cumsum(found, axis=0)])
        last = np.cumsum(lines.lengths)
        return total[last] - total[last - lines.lengths]


def shares(looks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return persistence and the share of floor, ``(N,)`` float64 each, NaN without looks.

    Args:
        looks: ``(N, 3)`` integer, by kind.

    Example:
        >>> [share.tolist() for share in shares(np.array([[3, 1, 0]]))]
        [[0.75], [0.25]]
    """
    total = looks.sum(axis=1)
    with np.errstate(invalid="ignore"):
        return looks[:, FOUND] / total, looks[:, FLOOR] / total


def thickness(distance_m: np.ndarray) -> np.ndarray:
    """Return the thickness of contours with their noise to both sides, int64 [cell].

    Example:
        >>> thickness(np.array([0.5, 2.0, 4.0])).tolist()
        [2, 4, 8]
    """
    distance = np.asarray(distance_m).astype(np.float64)
    noise = NEAR_M + PER_M * (distance * distance)
    return np.maximum(np.rint(2 * noise / CELL_M), 1).astype(np.int64)


def poses(frames: pa.Table) -> np.ndarray:
    """Return ``T_world_camera`` ``(F, 4, 4)`` of frames, NaN without a pose or a level floor."""
    place, turn = (vectors(frames[name], size) for name, size in zip(_POSE, (3, 4), strict=True))
    tilt = (frames[name].to_numpy().astype(np.float64) for name in TILT[1:])
    known = np.isfinite(place).all(axis=1) & np.isfinite(turn).all(axis=1)
    known &= ~tilted(turn, *tilt) & (frames["floor_source"].to_numpy() != "none")
    return np.where(known[:, None, None], motion_matrix(place, turn), np.nan)


_POSE = POSE_COLUMNS[:2]


def free_floor(frames: pa.Table) -> FreeFloor:
    """Return the free floor of frames from their columns, ``(F, RAYS)``."""
    names = "free_bearing_rad", "free_from_m", "free_to_m", "free_end"
    count = _lengths(frames[names[0]])
    frame = np.repeat(np.arange(len(count)), count)
    columns = [list_array(frames[name]).flatten().to_numpy() for name in names]
    ray = np.rint(columns[0].astype(np.float64) / RAY_RAD).astype(np.int64) + RAYS // 2
    bearing, way = (np.broadcast_to(row, (len(count), RAYS)) for row in ray_bearings())
    seen, end = np.zeros((2, len(count), RAYS), np.int8)
    start, stop = np.zeros((2, len(count), RAYS))
    for array, values in ((seen, 1), (start, columns[1]), (stop, columns[2]), (end, columns[3])):
        array[frame, ray] = values
    return FreeFloor(seen.astype(bool), way, bearing, start, stop, end)


def contours(chunk: Tables, T_world_camera: np.ndarray) -> Lines:
    """Return the contours of all obstacles of a chunk."""
    count = _lengths(chunk.obstacles["contour"]) // 2
    values = list_array(chunk.obstacles["contour"]).flatten().to_numpy().astype(np.float64)
    frame = np.repeat(np.arange(len(T_world_camera)), np.diff(chunk.first))
    T = T_world_camera[np.repeat(frame, count)]
    return Lines(_in_world(values.reshape(-1, 2), T), count)


def _in_world(points: np.ndarray, T_world_camera: np.ndarray) -> np.ndarray:
    """Return points ``(P, 2)``, right and forward, in the world, each by its own pose."""
    return to_world(points[:, None, None], T_world_camera).reshape(-1, 2)


def _falling(values: np.ndarray) -> list[int]:
    """Return the different values, the largest first."""
    return np.unique(values)[::-1].tolist()


def _lengths(column: pa.ChunkedArray) -> np.ndarray:
    """Return the lengths of lists ``(N,)`` int64; 0 for null."""
    return pc.fill_null(list_array(column).value_lengths(), 0).to_numpy().astype(np.int64)
