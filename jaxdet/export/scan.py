"""Free floor of a frame as a laser scan, and as a local occupancy grid.

Both are in the floor frame (:mod:`jaxdet.export.shapes`: x right, y forward, z up).
"""

from typing import Any, NamedTuple

import cv2
import numpy as np

from jaxdet.export.shapes import FREE_COLUMNS, LEVEL, Row, corners, free_floor
from jaxdet.results.free_floor import RAY_RAD
from jaxdet.results.map_file import FREE, OCCUPIED, UNKNOWN, Grid
from jaxdet.results.occupancy import CELL_M, SHIFT
from jaxdet.results.tables import Frame
from jaxdet.types import RAYS, FreeEnd

SCAN_COLUMNS = (*FREE_COLUMNS, "free_end")
"""Columns of the frame table that this module needs."""
ANGLE_MIN = -np.pi
"""Angle of the first range, counter-clockwise from x [rad]; ranges are ``RAY_RAD`` apart."""


class Scan(NamedTuple):
    """Laser scan: ranges by angle."""

    ranges: np.ndarray
    """Distance to an obstacle or drop, ``(RAYS,)`` float32 [m]; inf if the floor extends to the end
    of the depth range, NaN if the end of the floor is unknown or no floor is visible."""
    range_min_m: float
    """Minimum range at which the frame shows floor or obstacles; nearer ones are out of view [m].
    """


def scan(row: Row) -> Scan | None:
    """Return the scan of a frame; None if the floor is unknown or no free floor was computed.

    Args:
        row: Row of the frame with :data:`SCAN_COLUMNS`.
    """
    if row["camera_height_m"] is None or row["free_end"] is None:
        return None
    bearing, start, stop = (np.array(row[name], np.float64) for name in FREE_COLUMNS)
    end = np.array(row["free_end"], np.int64)
    number = np.rint((np.pi / 2 - bearing - ANGLE_MIN) / RAY_RAD).astype(np.int64) % RAYS
    ranges = np.full(RAYS, np.nan, np.float32)
    seen = np.isin(end, (FreeEnd.OBSTACLE, FreeEnd.DROP))
    ranges[number] = np.where(seen, stop, np.where(end == FreeEnd.RANGE, np.inf, np.nan))
    return Scan(ranges, float(start.min(initial=np.inf)) if len(start) else 0.0)


def local_grid(frame: Frame, reach_m: float) -> Grid | None:
    """Draw the outlines and the free floor of a single frame as a grid around the camera.

    Args:
        frame: Frame with :data:`SCAN_COLUMNS`.
        reach_m: Extent of the grid in each direction [m].

    Returns:
        Grid with cells of :data:`jaxdet.results.occupancy.CELL_M` in the floor frame; None in the
        same cases as :func:`scan`.
    """
    if frame.row["camera_height_m"] is None or frame.row["free_end"] is None:
        return None
    half = int(np.ceil(reach_m / CELL_M))
    states = np.zeros((2 * half, 2 * half), np.uint8)

    def drawn(points: np.ndarray) -> np.ndarray:
        return np.rint((points / CELL_M + half - 0.5) * (1 << SHIFT)).astype(np.int32)

    free = free_floor(frame.row).in_world(LEVEL[None])
    if len(free.corners):
        parts = np.split(drawn(free.points), np.cumsum(free.corners)[:-1])
        cv2.fillPoly(states, parts, (1,), cv2.LINE_8, SHIFT)
    for obstacle in frame.obstacles:
        near = np.clip(corners(obstacle), -2 * reach_m, 2 * reach_m)
        cv2.fillConvexPoly(states, drawn(near), (2,), cv2.LINE_8, SHIFT)
    values = np.array([UNKNOWN, FREE, OCCUPIED], np.int8)[states]
    return Grid(values, (-half * CELL_M, -half * CELL_M), CELL_M)


def scan_message(found: Scan, head: dict[str, Any], range_max_m: float) -> dict[str, Any]:
    """Build a ``sensor_msgs/LaserScan``; ranges beyond ``range_max_m`` become inf."""
    return {
        "header": head,
        "angle_min": ANGLE_MIN,
        "angle_max": ANGLE_MIN + (RAYS - 1) * RAY_RAD,
        "angle_increment": RAY_RAD,
        "time_increment": 0.0,
        "scan_time": 0.0,
        "range_min": found.range_min_m,
        "range_max": range_max_m,
        "ranges": np.where(found.ranges > range_max_m, np.inf, found.ranges).tolist(),
        "intensities": [],
    }
