"""Images whose frame is a body frame, with x forward, where an optical one has z forward (REP 103).

Drivers of Gazebo and Webots name such frames. Between two cameras the rotation tells: nobody
mounts one camera turned against the other by what turns body axes into optical ones. On a robot
the depth images tell: through the frame as it stands they show no floor, and with the optical
rotation they do.
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
"""From optical axes (x right, y down, z forward) to body axes (x forward, y left, z up)."""
_NEAR_RAD = 0.26
"""How much two cameras that see the same may be turned against each other."""
_LOOKS = 8
"""Frames whose floor is looked for."""
_STEEP = 0.5
"""Vertical part of the optical axis from which a mount is doubted."""
_LEAST = 0.05
"""Share of the points that must be floor."""
_MUCH_MORE = 5
"""How many times more floor the optical rotation must show."""
_UNDER = 0.1
"""Largest share of the points that may be below a floor: noise, and reflections."""
_FLOOR_M, _FLOOR_SHARE = 0.03, 0.02
"""How far floor may be from its plane: at any distance, and for each metre."""
_BELOW_M = 0.05
"""A floor of unknown height is at least this far below the camera."""


class Turned(NamedTuple):
    """A transform between two cameras, in optical axes."""

    T_color_depth: np.ndarray
    depth_is_body: bool
    color_is_body: bool


def in_optical_axes(T_color_depth: np.ndarray, depth_is_body: bool) -> Turned:
    """Return the transform from depth to colour between optical frames.

    Args:
        T_color_depth: ``(4, 4)`` float64, between the frames that the images name.
        depth_is_body: Whether depth's frame is known to be a body frame.
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
    return f"{about}: the rotation to optical axes is applied; --log.camera-frame names another"


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
    """Return whether the depth images show a floor only with the optical rotation.

    A sample of frames is read where the optical axis, as it stands, looks steeply up or down.

    Args:
        num_frames: Frames of the log.
        T_base: ``(4, 4)`` float64, the camera on the robot; None: its poses in the world count.
        read: Reads the frames of some numbers.
    """
    if not num_frames or (T_base is not None and abs(T_base[2, 2]) < _STEEP):
        return False
    numbers = np.unique(np.linspace(0, num_frames - 1, _LOOKS).astype(int)).tolist()
    if T_base is None:
        first = read(numbers[:1]).T_world_camera
        if first is None or abs(first[0, 2, 2]) < _STEEP:
            return False
    frames = read(numbers)
    shares = []
    for row in np.flatnonzero(frames.valid).tolist():
        T = T_base
        if T is None:
            poses = frames.T_world_camera
            T = None if poses is None or np.isnan(poses[row]).any() else poses[row]
        if T is not None:
            depth = frames.depth[row]
            points = _points(depth, frames.calibration.depth, frames.calibration.depth_unit)
            turned = matmul(T, T_BODY_OPTICAL)
            known = T_base is not None
            shares.append([_floor_share(points, one, known) for one in (T, turned)])
    if not shares:
        return False
    as_is, as_body = np.median(np.array(shares), axis=0)
    return bool(as_body >= _LEAST and as_body > _MUCH_MORE * as_is)


def _is_small(T: np.ndarray) -> bool:
    return difference(np.eye(4), T)[1] < _NEAR_RAD


def _points(depth: np.ndarray, camera: Intrinsics, unit_m: float) -> np.ndarray:
    """Return some measured points ``(N, 3)`` in the camera's optical frame [m]."""
    step = max(1, min(depth.shape) // 60)
    v, u = np.mgrid[0 : camera.height : step, 0 : camera.width : step].astype(np.float64)
    x, y = undistort((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, camera)
    z = depth[::step, ::step] * unit_m
    points = np.stack([x * z, y * z, z], axis=-1)
    return points[z > 0]


def _floor_share(points: np.ndarray, T: np.ndarray, height_is_known: bool) -> float:
    """Return the share of the points that are floor, where the camera is placed by ``T``.

    Where its height is not known, floor is where the lowest points are. Nothing is below a floor.
    """
    if not len(points):
        return 0.0
    height = (points * T[2, :3]).sum(axis=1)
    slack = _FLOOR_M + _FLOOR_SHARE * points[:, 2]
    below = height[height < -_BELOW_M]
    if not height_is_known and not len(below):
        return 0.0
    floor = -T[2, 3] if height_is_known else np.quantile(below, 0.02)
    if (height < floor - slack).mean() > _UNDER:
        return 0.0
    return float((np.abs(height - floor) <= slack).mean())
