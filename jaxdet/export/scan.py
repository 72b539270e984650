"""The free floor of a frame around the camera's foot: as a laser scan, and as a grid.

Both are in the floor frame, see :mod:`jaxdet.export.shapes`: x right, y forward, z up.
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
"""Columns of frames that are read here."""
ANGLE_MIN = -np.pi
"""Angle of the first range, counter-clockwise from x [rad]; the others are ``RAY_RAD`` apart."""


class Scan(NamedTuple):
    """Ranges by angle."""

    ranges: np.ndarray
    """``(RAYS,)`` float32 [m]: to an obstacle or a drop; inf where the floor goes on to the end of
    the depth range, NaN where nothing is known beyond the floor that is seen, or none is seen."""
    range_min_m: float
    """Least range at which the frame shows floor or an obstacle; what is nearer is not seen."""


def scan(row: Row) -> Scan | None:
    """The scan of a frame; None where its floor is not known or its free floor was not found.

    Args:
        row: A row of frames with :data:`SCAN_COLUMNS`.
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
    """What a frame alone shows around the camera's foot: outlines over free floor.

    Args:
        frame: With :data:`SCAN_COLUMNS`.
        reach_m: How far the grid goes to each side [m].

    Returns:
        Cells of :data:`jaxdet.results.occupancy.CELL_M` in the floor frame; None like
        :func:`scan`.
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
    """A ``sensor_msgs/LaserScan``."""
    return {
        "header": head,
        "angle_min": ANGLE_MIN,
        "angle_max": ANGLE_MIN + (RAYS - 1) * RAY_RAD,
        "angle_increment": RAY_RAD,
        "time_increment": 0.0,
        "scan_time": 0.0,
        "range_min": found.range_min_m,
        "range_max": range_max_m,
        "ranges": found.ranges.tolist(),
        "intensities": [],
    }
