"""Counts of what frames show at places of the world: an obstacle, or floor.

The place of an obstacle is the cells along its contour, i.e. its visible edge. A frame is a
sighting of a cell if it shows there

- the contour of an obstacle;
- floor, along the frame's rays of free floor; or
- the end of such a ray at points above the step height that are too few for an obstacle.

Cells that are hidden by a nearer object, out of view or unmeasured are not sighted. Contours and
ray ends have the width of their noise, see :func:`thickness`. Sightings of a cell count from the
first frame that shows an obstacle there, so that an object put down later has the same fraction as
one that was there before.
"""

from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from jaxdet.io.motion import motion_matrix
from jaxdet.results.free_floor import RAY_RAD, FreeFloor, ray_bearings
from jaxdet.results.metric import TILT, tilted, to_world
from jaxdet.results.occupancy import CELL_M, TILE, Layer, rasterize
from jaxdet.results.tables import Tables, list_array, vectors
from jaxdet.types import RAYS, FreeEnd

CHUNK_FRAMES = 64
"""Number of frames that are processed together."""
NEAR_M, PER_M = 0.05, 0.01
"""Noise of a contour [m], and its increase with the square of the distance [1/m]."""
FOUND, FLOOR, OTHER = 0, 1, 2
"""Kinds of sightings: an obstacle, floor, and other points above the step height."""
POSE_COLUMNS = ("camera_position_world", *TILT, "floor_source")
"""Columns of the frame table for :func:`poses`."""
FRAME_COLUMNS = (*POSE_COLUMNS, "free_bearing_rad", "free_from_m", "free_to_m", "free_end")
OBSTACLE_COLUMNS = ("contour", "distance_m")


class Lines(NamedTuple):
    """Contours of obstacles in the world."""

    points: np.ndarray
    """Points of all contours, ``(P, 2)`` float64 [m], NaN without a pose or a floor."""
    lengths: np.ndarray
    """Number of contour points of each obstacle, ``(N,)`` int64."""


class Sightings:
    """Sightings of the cells of a log, stored in tiles, so that memory grows with the area seen."""

    def __init__(self) -> None:
        self._tiles: dict[tuple[int, int], np.ndarray] = {}
        """Sightings by kind, ``(3, TILE, TILE)`` int32, by row and column of the tile."""

    def add(self, chunk: Tables) -> None:
        """Add the frames of a chunk.

        Args:
            chunk: Tables with :data:`FRAME_COLUMNS` and :data:`OBSTACLE_COLUMNS`.
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
        """Add a raster whose first cell has column ``x`` and row ``y``."""
        rows, columns = cells.shape
        for row in range(y // TILE, (y + rows - 1) // TILE + 1):
            for column in range(x // TILE, (x + columns - 1) // TILE + 1):
                top, left = row * TILE - y, column * TILE - x  # position of the tile in the raster
                part = cells[max(top, 0) : top + TILE, max(left, 0) : left + TILE]
                tile = self._tiles.setdefault((row, column), np.zeros((3, TILE, TILE), np.int32))
                up, aside = max(-top, 0), max(-left, 0)
                area = tile[:, up : up + part.shape[0], aside : aside + part.shape[1]]
                area[FOUND] += part == 1 + FOUND
                known = area[FOUND] > 0
                area[FLOOR] += known & (part == 1 + FLOOR)
                area[OTHER] += known & (part == 1 + OTHER)

    def of(self, chunk: Tables) -> np.ndarray:
        """Return the sightings of the places of obstacles, summed over the cells of each place.

        Args:
            chunk: Tables with the columns of :meth:`add`.

        Returns:
            Counts ``(N, 3)`` int64, by kind; 0 without a position in the world.
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


def shares(counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return persistence and fraction of floor, ``(N,)`` float64 each, NaN without sightings.

    Args:
        counts: Sightings ``(N, 3)`` integer, by kind.

    Example:
        >>> [share.tolist() for share in shares(np.array([[3, 1, 0]]))]
        [[0.75], [0.25]]
    """
    total = counts.sum(axis=1)
    with np.errstate(invalid="ignore"):
        return counts[:, FOUND] / total, counts[:, FLOOR] / total


def thickness(distance_m: np.ndarray) -> np.ndarray:
    """Return the width of contours, with their noise on both sides, int64 [cell].

    Example:
        >>> thickness(np.array([0.5, 2.0, 4.0])).tolist()
        [2, 4, 8]
    """
    distance = np.asarray(distance_m).astype(np.float64)
    noise = NEAR_M + PER_M * (distance * distance)
    return np.maximum(np.rint(2 * noise / CELL_M), 1).astype(np.int64)


def poses(frames: pa.Table) -> np.ndarray:
    """Return ``T_world_camera`` of frames, ``(F, 4, 4)``.

    It is NaN if the pose or the floor is unknown, or the world's z is not up.
    """
    place, turn = (vectors(frames[name], size) for name, size in zip(_POSE, (3, 4), strict=True))
    tilt = (frames[name].to_numpy().astype(np.float64) for name in TILT[1:])
    known = np.isfinite(place).all(axis=1) & np.isfinite(turn).all(axis=1)
    known &= ~tilted(turn, *tilt) & (frames["floor_source"].to_numpy() != "none")
    return np.where(known[:, None, None], motion_matrix(place, turn), np.nan)


_POSE = POSE_COLUMNS[:2]


def free_floor(frames: pa.Table) -> FreeFloor:
    """Return the free floor of frames, ``(F, RAYS)``, from their columns."""
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
    """Transform points ``(P, 2)`` (right, forward) to the world, each by its own pose."""
    return to_world(points[:, None, None], T_world_camera).reshape(-1, 2)


def _falling(values: np.ndarray) -> list[int]:
    """Return the distinct values in descending order."""
    return np.unique(values)[::-1].tolist()


def _lengths(column: pa.ChunkedArray) -> np.ndarray:
    """Return the lengths of lists ``(N,)`` int64; 0 for null."""
    return pc.fill_null(list_array(column).value_lengths(), 0).to_numpy().astype(np.int64)
