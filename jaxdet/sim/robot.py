"""Where the robot and its cameras are: the path, the mount, the odometry."""

from typing import NamedTuple

import numpy as np

from jaxdet.sim.scene import Path, rotation_z

WHEEL_RADIUS_M = 0.10
"""base_link above base_footprint [m]."""

OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Optical axes (right, down, forward) to body axes (forward, left, up): ROS REP 103."""


class Pose(NamedTuple):
    """A robot on the plane."""

    x: float
    y: float
    yaw: float
    """Counter-clockwise from above [rad]."""
    travelled: float
    """Length of the way it has gone [m]."""

    @property
    def T(self) -> np.ndarray:
        """``T_world_base`` ``(4, 4)`` float64."""
        T = np.eye(4)
        T[:2, :2] = rotation_z(self.yaw)
        T[:2, 3] = self.x, self.y
        return T


def pose_at(path: Path, time_s: float) -> Pose:
    """The pose at a time; the robot starts and turns back softly, heading along the line.

    The way along the line's axis is a(t) = length (1 - cos w t) / 2 with w = 2 speed / length.
    """
    if path.length <= 0:
        return Pose(*path.start, path.yaw, 0.0)
    phase = 2 * path.speed / path.length * (time_s + path.lead_s)
    along = path.length * (1 - np.cos(phase)) / 2
    k = 2 * np.pi / path.weave_length
    local = np.array([along, path.weave * np.sin(k * along)])
    heading = np.arctan(path.weave * k * np.cos(k * along))
    x, y = rotation_z(path.yaw) @ local + path.start
    turns, rest = divmod(phase, 2 * np.pi)
    legs = (
        2 * turns + (1 - np.cos(rest)) / 2 if rest <= np.pi else 2 * turns + (3 + np.cos(rest)) / 2
    )
    return Pose(float(x), float(y), float(path.yaw + heading), float(legs * path.length))


def velocity_at(path: Path, time_s: float, step_s: float = 1e-3) -> tuple[float, float]:
    """Forward speed [m/s], negative when backing, and turn rate to the left [rad/s]."""
    a, b = pose_at(path, time_s - step_s), pose_at(path, time_s + step_s)
    heading = (a.yaw + b.yaw) / 2
    forward = (b.x - a.x) * np.cos(heading) + (b.y - a.y) * np.sin(heading)
    return float(forward / (2 * step_s)), (b.yaw - a.yaw) / (2 * step_s)


def drifted(pose: Pose, drift: float) -> Pose:
    """What the odometry says: ``drift`` is both its scale error and its turn [rad] per metre
    travelled."""  # noqa: D205, D209
    scale = 1 + drift
    return Pose(pose.x * scale, pose.y * scale, pose.yaw + drift * pose.travelled, pose.travelled)


def mount(height_m: float, pitch_rad: float, roll_rad: float) -> np.ndarray:
    """The colour camera on the robot.

    The floor's direction in the optical frame is (sin r cos p, cos r cos p, sin p), as
    :class:`jaxdet.types.GroundPlane` has it.

    Returns:
        ``T_base_color`` ``(4, 4)`` float64, colour optical frame to base_footprint.
    """
    cp, sp, cr, sr = np.cos(pitch_rad), np.sin(pitch_rad), np.cos(roll_rad), np.sin(roll_rad)
    tilt = np.array([[1, 0, 0], [0, cp, sp], [0, -sp, cp]])
    turn = np.array([[cr, -sr, 0], [sr, cr, 0], [0, 0, 1]])
    T = np.eye(4)
    T[:3, :3] = OPTICAL @ tilt @ turn
    T[:3, 3] = 0.0, 0.0, height_m
    return T


def ground_frame(T_world_base: np.ndarray) -> np.ndarray:
    """The camera's ground frame: its centre dropped on the floor, x right, y forward, z up.

    :func:`mount` puts the camera over the base's origin without a turn, so that this is the
    base's frame with its axes renamed.

    Returns:
        ``T_ground_world`` ``(4, 4)`` float64.
    """
    T = np.eye(4)
    T[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    return T @ np.linalg.inv(T_world_base)
