"""Occupancy grid at the end of a log, in which cells that an obstacle has left are free.

The map of a run counts outlines. This grid instead updates clamped log-odds in the order of frames,
as OctoMap does (Hornung et al. 2013, "OctoMap: an efficient probabilistic 3D mapping framework",
Section 4.2): outlines raise the occupancy of a cell, free floor lowers it, and a few frames suffice
to change its state.
"""

from collections.abc import Iterator

import cv2
import numpy as np

from jaxdet.export.shapes import FREE_COLUMNS, T_world_upright, contour, free_floor
from jaxdet.results.map_file import FREE, OCCUPIED, UNKNOWN, Grid, KnownPlaces
from jaxdet.results.metric import to_world
from jaxdet.results.occupancy import Layer, Raster, rasterize
from jaxdet.results.reading import ResultLog, Results
from jaxdet.results.tables import Frame
from jaxdet.tracks.folder import tracking
from jaxdet.tracks.places import IN_MAP, is_lasting, shares_in_map
from jaxdet.tracks.sightings import OBSTACLE_COLUMNS, POSE_COLUMNS

HIT, MISS = 85, -40
"""Log-odds that an outline and free floor add to a cell [1/100], as in OctoMap."""
LEAST, MOST = -200, 350
"""Bounds of the log-odds [1/100], as in OctoMap; nine frames with free floor clear any cell."""

_FLOOR, _OUTLINE, _EDGE = 1, 2, 3
"""Cell values in the raster of a frame: free floor, outlines, and contours inside outlines."""
_ADDED = np.array([0, MISS, HIT, HIT], np.int16)
_FRAME_COLUMNS = (*POSE_COLUMNS, *FREE_COLUMNS)


def last_grid(results: Results, log: ResultLog, known: KnownPlaces | None = None) -> Grid | None:
    """Return the occupancy grid at the end of a log; None if the run made no map.

    After ``jaxdet track``, obstacles at places where floor was often seen are omitted
    (``track.most_floor``). So are groups of adjacent cells without any lasting contour cell, which
    are mostly corners of rectangles.

    Args:
        results: Results of a run.
        log: Log in the results.
        known: Known map, whose obstacles are omitted; None: all obstacles are drawn.
    """
    counted = results.map(log)
    if counted is None:
        return None
    first = np.rint(np.array(counted.origin) / counted.cell_m).astype(np.int64)
    odds = np.zeros(counted.counts.shape, np.int16)
    most_floor = tracking(log.folder).most_floor if results.tracked(log) else 1.0
    # Number of frames in which each cell is floor (counted from its first outline on), inside an
    # outline, and on a contour.
    sightings = np.zeros((3, *counted.counts.shape), np.int32)
    seen_floor = np.zeros(counted.counts.shape, bool)
    for frame in _frames(results, log, most_floor, known):
        if (raster := _raster(frame)) is None:
            continue
        cells, (x, y) = raster.cells, (raster.low - first).tolist()
        rows, columns = counted.counts.shape
        top, left = max(y, 0), max(x, 0)
        part = cells[top - y : max(rows - y, 0), left - x : max(columns - x, 0)]
        here = slice(top, top + part.shape[0]), slice(left, left + part.shape[1])
        odds[here] = np.clip(odds[here] + _ADDED[part], LEAST, MOST)
        seen_floor[here] |= part == _FLOOR
        floor, outlines, contours = (sightings[kind][here] for kind in range(3))
        outlines += part >= _OUTLINE
        contours += part == _EDGE
        floor += (part == _FLOOR) & (outlines > 0)
    occupied = odds > 0
    if results.tracked(log):
        floor, outlines, contours = sightings
        lasting = (contours > 0) & is_lasting(floor / np.maximum(floor + outlines, 1), most_floor)
        occupied = _groups_with(lasting, occupied)
    free = (seen_floor | (odds < 0)) & ~occupied
    states = np.where(occupied, OCCUPIED, np.where(free, FREE, UNKNOWN))
    return Grid(states.astype(np.int8), counted.origin, counted.cell_m)


def _groups_with(lasting: np.ndarray, occupied: np.ndarray) -> np.ndarray:
    """Return a mask of the occupied cells in connected groups that contain a lasting cell."""
    count, labels = cv2.connectedComponents(occupied.astype(np.uint8), connectivity=8)
    group = labels.astype(np.int32)
    has_one = np.zeros(count, bool)
    has_one[group[lasting & occupied]] = True
    return has_one[group] & occupied


def _frames(
    results: Results, log: ResultLog, most_floor: float, known: KnownPlaces | None
) -> Iterator[Frame]:
    """Yield the frames of a log, each with the obstacles to draw."""
    tracked = results.tracked(log)
    columns = ("corners_world", *OBSTACLE_COLUMNS, *(["floor_seen"] * tracked))
    for chunk in results.chunks(log, _FRAME_COLUMNS, columns):
        drawn = np.ones(chunk.obstacles.num_rows, bool)
        if tracked:
            drawn = is_lasting(chunk.obstacles["floor_seen"].to_numpy(), most_floor)
        if known is not None:
            drawn &= ~(shares_in_map(chunk, known) >= IN_MAP)
        for frame, first in zip(chunk.each(), chunk.first.tolist(), strict=False):
            own = zip(frame.obstacles, drawn[first:].tolist(), strict=False)
            yield Frame(frame.row, [obstacle for obstacle, shown in own if shown])


def _raster(frame: Frame) -> Raster | None:
    """Return the cells that a frame updates; an outline without a contour counts as a contour."""
    T = T_world_upright(frame.row)
    if T is None:
        return None
    placed = [o for o in frame.obstacles if o["corners_world"]]
    outlines, bare = (
        [np.reshape(o["corners_world"], (4, 2)) for o in placed if bool(o["contour"]) == edged]
        for edged in (True, False)
    )
    edges = [to_world(contour(o)[None, None], T[None])[0, 0] for o in placed if o["contour"]]
    free = free_floor(frame.row).in_world(T[None])
    areas = np.split(free.points, np.cumsum(free.corners)[:-1]) if len(free.corners) else []
    layers = [Layer(_FLOOR, "areas", areas), Layer(_OUTLINE, "outlines", outlines)]
    return rasterize([*layers, Layer(_EDGE, "outlines", bare), Layer(_EDGE, "lines", edges)])
