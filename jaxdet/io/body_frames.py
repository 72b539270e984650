"""Images in a body frame (x forward) instead of an optical frame (z forward, REP 103).

Drivers in Gazebo and Webots report such frames. A body frame is recognised by the rotation between
two cameras, as nobody mounts two cameras with the rotation between body and optical axes. If the
pose of a camera is known, its body frame is also recognised by the depth images: they show a floor
only if the rotation to optical axes is added.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from jaxdet.camera import undistort
from jaxdet.elementary import matmul
from jaxdet.errors import printable
from jaxdet.io.motion import difference, inverse
from jaxdet.io.transforms import TransformTree
from jaxdet.types import Frames, Intrinsics

T_BODY_OPTICAL = np.array(
    [[0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)
"""Transform from optical axes (x right, y down, z forward) to body axes (x forward, y left, z up).
"""
_NEAR_RAD = 0.26
"""Maximum angle between two cameras that see the same scene [rad]."""
_LOOKS = 8
"""Number of frames in which a floor is searched."""
_STEEP = 0.5
"""Minimum vertical component of the optical axis, up or down, at which depth is checked."""
_LEAST = 0.05
"""Minimum fraction of floor points with the rotation to optical axes."""
_MUCH_MORE = 5
"""Minimum ratio of the number of floor points with this rotation to the number without."""
_UNDER = 0.1
"""Maximum fraction of points below the floor, due to noise and reflections."""
_FLOOR_M, _FLOOR_SHARE = 0.03, 0.02
"""Tolerance of the height of floor points [m], and its increase per metre of depth."""
_LOWEST = 0.02
"""Fraction of the points below the camera that are below a floor of unknown height."""
_LEAST_LOWER = 0.25
"""Minimum fraction of floor points below the base frame; of a wall, less are at one height."""
_BELOW_M = 0.05
"""Minimum distance from the camera down to the floor, if the floor's height is unknown [m]."""


class Turned(NamedTuple):
    """Transform from the depth to the colour camera, both in optical axes."""

    T_color_depth: np.ndarray
    """Transform ``(4, 4)`` float64 [m]."""
    depth_is_body: bool
    """Whether the frame named by the depth images is a body frame."""
    color_is_body: bool
    """Whether the frame named by the colour images is a body frame."""


def in_optical_axes(T_color_depth: np.ndarray, depth_is_body: bool) -> Turned:
    """Convert the transform from the depth to the colour camera to optical axes.

    Args:
        T_color_depth: Transform ``(4, 4)`` float64 between the frames named by the images.
        depth_is_body: Whether the frame of the depth images is known to be a body frame.
    """
    to_color = inverse(T_BODY_OPTICAL)
    depth = matmul(T_color_depth, T_BODY_OPTICAL)
    color = matmul(to_color, T_color_depth)
    if _is_small(depth):
        return Turned(depth, True, False)
    if _is_small(color):
        return Turned(color, False, True)
    if depth_is_body and _is_small(T_color_depth):
        return Turned(matmul(to_color, depth), True, True)
    return Turned(T_color_depth, depth_is_body, False)


def body_frame_text(frame: str) -> str:
    """Return the warning about a body frame."""
    about = f"frame {printable(frame)!r} of the images is a body frame (x forward)"
    return f"{about}: its rotation to optical axes is added; --log.camera-frame sets another frame"


def optical_frame(tree: TransformTree, frame: str) -> str:
    """Return the name of the optical frame of a body frame; empty if the tree has none."""
    for name in sorted(tree.frames):
        if "optical" not in name or name == frame:
            continue
        T = tree.fixed(frame, name)
        if T is not None and max(difference(T, T_BODY_OPTICAL)) < 1e-3:
            return name
    return ""


def is_body_frame(
    num_frames: int, T_base: np.ndarray | None, read: Callable[[Sequence[int]], Frames]
) -> bool:
    """Return whether the depth images show a floor only with the rotation to optical axes.

    Frames are read only if the optical axis, without that rotation, points steeply up or down.

    Args:
        num_frames: Number of frames in the log.
        T_base: Pose of the camera on the robot, ``(4, 4)`` float64; None: the poses of the camera
            in the world are used instead.
        read: Function that reads the frames with the given numbers.
    """
    if not num_frames:
        return False
    numbers = np.unique(np.linspace(0, num_frames - 1, _LOOKS).astype(int)).tolist()
    first = read(numbers[:1]).T_world_camera if T_base is None else T_base[None]
    if first is None or abs(first[0, 2, 2]) < _STEEP:
        return False
    frames = read(numbers)
    poses = frames.T_world_camera if T_base is None else np.repeat(T_base[None], len(numbers), 0)
    if poses is None:
        return False
    camera, unit, shares = frames.calibration.depth, frames.calibration.depth_unit, []
    for row in np.flatnonzero(frames.valid & ~np.isnan(poses).any(axis=(1, 2))).tolist():
        points = _points(frames.depth[row], camera, unit)
        both = poses[row], matmul(poses[row], T_BODY_OPTICAL)
        shares.append([_floor_share(points, T, T_base is not None) for T in both])
    if not shares:
        return False
    as_is, as_body = np.median(np.array(shares), axis=0)
    return bool(as_body >= _LEAST and as_body > _MUCH_MORE * as_is)


def _is_small(T: np.ndarray) -> bool:
    return difference(np.eye(4), T)[1] < _NEAR_RAD


def _points(depth: np.ndarray, camera: Intrinsics, unit_m: float) -> np.ndarray:
    """Return a sample of measured points ``(N, 3)`` in the camera optical frame [m]."""
    step = max(1, min(depth.shape) // 60)
    v, u = np.mgrid[0 : camera.height : step, 0 : camera.width : step].astype(np.float64)
    x, y = undistort((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, camera)
    z = depth[::step, ::step] * unit_m
    points = np.stack([x * z, y * z, z], axis=-1)
    return points[z > 0]


def _floor_share(points: np.ndarray, T: np.ndarray, height_is_known: bool) -> float:
    """Return the fraction of floor points for a camera with the pose ``T``.

    If the camera height is unknown, or too many points are below the floor, since the base frame is
    above it, the floor is at the lowest points. In the second case it must be a large part.
    """
    if not len(points):
        return 0.0
    height = (points * T[2, :3]).sum(axis=1)
    slack = _FLOOR_M + _FLOOR_SHARE * points[:, 2]
    if height_is_known and (height < -T[2, 3] - slack).mean() <= _UNDER:
        return float((np.abs(height + T[2, 3]) <= slack).mean())
    below = height[height < -_BELOW_M]
    if not len(below):
        return 0.0
    floor = np.quantile(below, _LOWEST)
    share = float((np.abs(height - floor) <= slack).mean())
    return share if share >= _LEAST_LOWER or not height_is_known else 0.0
