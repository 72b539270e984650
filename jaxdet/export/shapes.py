"""Rows of the tables as shapes: where the camera and its floor are, and what stands on it.

The *floor frame* of a camera has its origin on the floor below the optical centre, x right,
y forward, z up: contours and outlines of the tables are its x and y, heights its z. Where the
floor is unknown it is a level one at the height of the camera.
"""

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np

from jaxdet.floor.plane import down_vector, forward_vector
from jaxdet.io.motion import motion_matrix, quaternions
from jaxdet.results.free_floor import RAY_RAD, FreeFloor
from jaxdet.results.metric import TILT, tilted
from jaxdet.results.reading import ResultLog

Row = Mapping[str, Any]

FRAME_COLUMNS = (
    *("stamp_ns", "log_time_ns", "camera_frame", "world_frame", "camera_position_world"),
    *("camera_orientation_world", "camera_height_m", "camera_pitch_rad", "camera_roll_rad"),
)
"""What the functions here but :func:`free_floor` use of frames."""
FREE_COLUMNS = ("free_bearing_rad", "free_from_m", "free_to_m")
"""What that uses."""
LEVEL = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
"""Pose of a level camera in its floor frame, for what takes poses in the world."""
LEVEL.setflags(write=False)


def topic(log: ResultLog, name: str) -> str:
    """A topic for what is shown of a log; of one with several cameras each has its own."""
    return f"/jaxdet/{name}" if log.label == log.name else f"/jaxdet/{log.camera}/{name}"


def camera_name(row: Row) -> str:
    """The frame of the camera that lengths refer to; ``camera`` where the log names none."""
    return row["camera_frame"] or "camera"


def floor_name(row: Row) -> str:
    """What the floor frame of the camera is called."""
    return f"{camera_name(row)}_floor"


def T_camera_floor(row: Row) -> np.ndarray:
    """``(4, 4)`` float64, floor frame to optical frame, of a row of frames [m]; constant."""
    return _floor(*(row[f"camera_{name}"] for name in ("height_m", "pitch_rad", "roll_rad")))


@lru_cache(maxsize=4)  # the obstacles of a frame ask one after the other
def _floor(height: float | None, pitch: float | None, roll: float | None) -> np.ndarray:
    known = height is not None
    height, pitch, roll = (value or 0.0 for value in (height, pitch, roll))
    down = np.array([[0.0, 1.0, 0.0]])
    if known:
        down = down_vector(np.array([pitch]), np.array([roll]))
    forward = forward_vector(down)
    T = np.eye(4)
    T[:3, 0], T[:3, 1] = np.cross(down, forward)[0], forward[0]
    T[:3, 2], T[:3, 3] = -down[0], height * down[0]
    T.flags.writeable = False
    return T


def T_world_camera(row: Row) -> np.ndarray | None:
    """``(4, 4)`` float64, optical frame to world [m]; None where the pose is unknown."""
    if row["camera_position_world"] is None:
        return None
    return motion_matrix(row["camera_position_world"], row["camera_orientation_world"])


def T_world_upright(row: Row) -> np.ndarray | None:
    """The same of frames whose floor has a place in the world; None of others."""
    T, known = T_world_camera(row), (np.array([row[name]], np.float64) for name in TILT)
    return None if T is None or tilted(*known)[0] else T


def quaternion(T: np.ndarray) -> list[float]:
    """The unit quaternion x y z w of a rigid motion ``(4, 4)``."""
    return quaternions(T[:3, :3]).tolist()


def corners(obstacle: Row) -> np.ndarray:
    """``(4, 2)`` float64, the outline in the floor frame [m], counter-clockwise or clockwise."""
    return np.reshape(obstacle["corners_ground"], (4, 2)).astype(np.float64)


def contour(obstacle: Row) -> np.ndarray:
    """``(n, 2)`` float64, the visible edge in the floor frame [m]; n is 0 without one."""
    return np.reshape(obstacle["contour"] or [], (-1, 2)).astype(np.float64)


def heights(row: Row, obstacle: Row) -> tuple[float, float]:
    """The lowest and the highest point in the floor frame [m].

    Where the table has no heights they are those of the box in the camera, at its centroid.
    """
    if obstacle["bottom_m"] is not None:
        return obstacle["bottom_m"], obstacle["top_m"]
    x, z = obstacle["x"], obstacle["z"]
    points = np.array([[x, obstacle["y_max"], z, 1.0], [x, obstacle["y_min"], z, 1.0]])
    low, high = (points @ np.linalg.inv(T_camera_floor(row)).T)[:, 2].tolist()
    return min(low, high), max(low, high)


def free_floor(row: Row) -> FreeFloor:
    """The free floor of a row of frames, with an empty ray where the table leaves some out.

    Args:
        row: With :data:`FREE_COLUMNS`.
    """
    bearing, start, stop = (np.array(row[name] or [], np.float64) for name in FREE_COLUMNS)
    apart = np.flatnonzero(np.abs(np.diff(bearing)) > 1.5 * RAY_RAD) + 1
    seen = np.insert(np.ones(bearing.size, bool), apart, False)
    bearing, start, stop = (np.insert(a, apart, 0.0) for a in (bearing, start, stop))
    way = np.sin(bearing) + 1j * np.cos(bearing)
    parts = seen, way, bearing, start, stop, np.zeros(seen.size, np.int8)
    return FreeFloor(*(part[None] for part in parts))


def box(obstacle: Row, bottom: float, top: float) -> tuple[np.ndarray, np.ndarray]:
    """The outline as a box that stands on the floor.

    Returns:
        ``(4, 4)`` float64, the box's frame to the floor frame: its origin is the middle, x goes
        from A to B; and ``(3,)`` float64, its lengths [m].
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
    """What tells it from others: its track's number, else its own."""
    track = obstacle.get("track")
    return obstacle["obstacle"] if track is None else track


def label(obstacle: Row) -> str:
    """Its number and distance, as in the pictures, and after ``#`` its track."""
    track = obstacle.get("track")
    followed = "" if track is None else f"   #{track}"
    return f"{obstacle['obstacle']}   {obstacle['distance_m']:.2f} m{followed}"
