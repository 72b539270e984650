"""Geometry from table rows: poses of camera and floor, shapes of obstacles.

The *floor frame* of a camera has its origin at the ground projection of the optical centre: x
right, y forward, z up. Contours and outlines in the tables are in its x and y, heights in its z. If
the floor is unknown, a level floor at the height of the camera is assumed.
"""

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np

from jaxdet.floor.plane import down_vector, forward_vector
from jaxdet.io.motion import motion_matrix, quaternions
from jaxdet.results.free_floor import RAY_RAD, FreeFloor
from jaxdet.results.metric import TILT, distance_text, tilted
from jaxdet.results.reading import ResultLog

Row = Mapping[str, Any]

FRAME_COLUMNS = (
    *("stamp_ns", "log_time_ns", "camera_frame", "world_frame", "camera_position_world"),
    *("camera_orientation_world", "camera_height_m", "camera_pitch_rad", "camera_roll_rad"),
)
"""Columns of the frame table needed by this module, except by :func:`free_floor`."""
FREE_COLUMNS = ("free_bearing_rad", "free_from_m", "free_to_m")
"""Columns of the frame table needed by :func:`free_floor`."""
LEVEL = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
"""Pose of a level camera in its floor frame, for functions that expect a pose in the world."""
LEVEL.setflags(write=False)


def topic(log: ResultLog, name: str) -> str:
    """Return the topic of exported data; the cameras of a log have separate topics."""
    return f"/jaxdet/{name}" if log.label == log.name else f"/jaxdet/{log.camera}/{name}"


def camera_name(row: Row) -> str:
    """Return the optical frame in which obstacles are; ``camera`` if the log does not name it."""
    return row["camera_frame"] or "camera"


def floor_name(row: Row) -> str:
    """Return the name of the camera's floor frame."""
    return f"{camera_name(row)}_floor"


def T_camera_floor(row: Row) -> np.ndarray:
    """Return the transform from floor frame to optical frame, ``(4, 4)`` float64 [m]; read-only."""
    return _floor(*(row[f"camera_{name}"] for name in ("height_m", "pitch_rad", "roll_rad")))


@lru_cache(maxsize=4)  # called for each obstacle of a frame
def _floor(height: float | None, pitch: float | None, roll: float | None) -> np.ndarray:
    is_known = height is not None
    height, pitch, roll = (value or 0.0 for value in (height, pitch, roll))
    down = np.array([[0.0, 1.0, 0.0]])
    if is_known:
        down = down_vector(np.array([pitch]), np.array([roll]))
    forward = forward_vector(down)
    T = np.eye(4)
    T[:3, 0], T[:3, 1] = np.cross(down, forward)[0], forward[0]
    T[:3, 2], T[:3, 3] = -down[0], height * down[0]
    T.flags.writeable = False
    return T


def T_world_camera(row: Row) -> np.ndarray | None:
    """Return the transform from optical frame to world, ``(4, 4)`` float64 [m]; None if unknown."""
    if row["camera_position_world"] is None:
        return None
    return motion_matrix(row["camera_position_world"], row["camera_orientation_world"])


def T_world_upright(row: Row) -> np.ndarray | None:
    """Return :func:`T_world_camera` if the world's z is up for this camera, else None."""
    T, tilt = T_world_camera(row), (np.array([row[name]], np.float64) for name in TILT)
    return None if T is None or tilted(*tilt)[0] else T


def quaternion(T: np.ndarray) -> list[float]:
    """Return the unit quaternion x y z w of a rigid transform ``(4, 4)``."""
    return quaternions(T[:3, :3]).tolist()


def corners(obstacle: Row) -> np.ndarray:
    """Return the outline's corners in the floor frame, ``(4, 2)`` float64 [m], in either order."""
    return np.reshape(obstacle["corners_ground"], (4, 2)).astype(np.float64)


def contour(obstacle: Row) -> np.ndarray:
    """Return the visible edge in the floor frame, ``(n, 2)`` float64 [m]; n is 0 without one."""
    return np.reshape(obstacle["contour"] or [], (-1, 2)).astype(np.float64)


def heights(row: Row, obstacle: Row) -> tuple[float, float]:
    """Return the heights of the lowest and the highest point in the floor frame [m].

    If the table has no heights, they are computed from the top and bottom of the box in the camera
    frame, at the depth of the obstacle's centroid.
    """
    if obstacle["bottom_m"] is not None:
        return obstacle["bottom_m"], obstacle["top_m"]
    x, z = obstacle["x"], obstacle["z"]
    points = np.array([[x, obstacle["y_max"], z, 1.0], [x, obstacle["y_min"], z, 1.0]])
    low, high = (points @ np.linalg.inv(T_camera_floor(row)).T)[:, 2].tolist()
    return min(low, high), max(low, high)


def free_floor(row: Row) -> FreeFloor:
    """Return the free floor of a frame, with an empty ray between non-adjacent rays.

    Args:
        row: Row with :data:`FREE_COLUMNS`.
    """
    bearing, start, stop = (np.array(row[name] or [], np.float64) for name in FREE_COLUMNS)
    apart = np.flatnonzero(np.abs(np.diff(bearing)) > 1.5 * RAY_RAD) + 1
    seen = np.insert(np.ones(bearing.size, bool), apart, False)
    bearing, start, stop = (np.insert(a, apart, 0.0) for a in (bearing, start, stop))
    way = np.sin(bearing) + 1j * np.cos(bearing)
    parts = seen, way, bearing, start, stop, np.zeros(seen.size, np.int8)
    return FreeFloor(*(part[None] for part in parts))


def box(obstacle: Row, bottom: float, top: float) -> tuple[np.ndarray, np.ndarray]:
    """Convert the outline to a box.

    Returns:
        Transform from the box's frame to the floor frame, ``(4, 4)`` float64, with the origin in
        the centre and x from A to B; and the size ``(3,)`` float64 [m].
    """
    ring = corners(obstacle)
    along, across = ring[1] - ring[0], ring[3] - ring[0]
    length = float(np.hypot(*along))
    T = np.eye(4)
    T[:2, 0] = along / length if length else (1.0, 0.0)
    T[:2, 1] = -T[1, 0], T[0, 0]
    T[:3, 3] = *ring.mean(axis=0), (bottom + top) / 2
    return T, np.array([length, np.hypot(*across), top - bottom])


def number_of(obstacle: Row) -> int:
    """Return the obstacle's identifier: the number of its track, else its label."""
    track = obstacle.get("track")
    return obstacle["obstacle"] if track is None else track


def label(obstacle: Row) -> str:
    """Return a text with label and distance, as in the pictures, and the track after ``#``.

    The text ends with ``new`` if the obstacle is not in the known map.
    """
    track = obstacle.get("track")
    followed = "" if track is None else f"   #{track}"
    new = "   new" if obstacle.get("in_map") is False else ""
    away = distance_text(obstacle["distance_m"], obstacle["z_min"])
    return f"{obstacle['obstacle']}   {away}{followed}{new}"
