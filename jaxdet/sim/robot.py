"""Pose of the robot and its cameras: path, mount, odometry."""

from typing import NamedTuple

import numpy as np

from jaxdet.sim.scene import Path, rotation_z

WHEEL_RADIUS_M = 0.10
"""Height of base_link above base_footprint [m]."""

OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Rotation from optical axes (right, down, forward) to body axes (forward, left, up): REP 103."""


class Pose(NamedTuple):
    """Planar pose of a robot."""

    x: float
    y: float
    yaw: float
    """Heading, counter-clockwise from above [rad]."""
    travelled: float
    """Travelled distance [m]."""

    @property
    def T(self) -> np.ndarray:
        """Homogeneous matrix ``T_world_base``, ``(4, 4)`` float64."""
        T = np.eye(4)
        T[:2, :2] = rotation_z(self.yaw)
        T[:2, 3] = self.x, self.y
        return T


def pose_at(path: Path, time_s: float) -> Pose:
    """Return the pose on a path at a time [s]; the motion reverses smoothly at both ends.

    The position along the axis is a(t) = length (1 - cos w t) / 2 with w = 2 speed / length.
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
    """Return forward speed [m/s], negative in reverse, and turn rate to the left [rad/s]."""
    a, b = pose_at(path, time_s - step_s), pose_at(path, time_s + step_s)
    heading = (a.yaw + b.yaw) / 2
    forward = (b.x - a.x) * np.cos(heading) + (b.y - a.y) * np.sin(heading)
    return float(forward / (2 * step_s)), (b.yaw - a.yaw) / (2 * step_s)


def drifted(pose: Pose, drift: float) -> Pose:
    """Return the pose that odometry measures, with ``drift`` as in ``SimConfig.odometry_drift``."""
    scale = 1 + drift
    return Pose(pose.x * scale, pose.y * scale, pose.yaw + drift * pose.travelled, pose.travelled)


def mount(height_m: float, pitch_rad: float, roll_rad: float) -> np.ndarray:
    """Return the pose of the colour camera on the robot.

    With pitch p and roll r, the downward direction in the optical frame is (sin r cos p,
    cos r cos p, sin p), as in :class:`jaxdet.types.GroundPlane`.

    Returns:
        ``T_base_color`` ``(4, 4)`` float64, from colour optical frame to base_footprint.
    """
    cp, sp, cr, sr = np.cos(pitch_rad), np.sin(pitch_rad), np.cos(roll_rad), np.sin(roll_rad)
    tilt = np.array([[1, 0, 0], [0, cp, sp], [0, -sp, cp]])
    turn = np.array([[cr, -sr, 0], [sr, cr, 0], [0, 0, 1]])
    T = np.eye(4)
    T[:3, :3] = OPTICAL @ tilt @ turn
    T[:3, 3] = 0.0, 0.0, height_m
    return T


def ground_frame(T_world_base: np.ndarray) -> np.ndarray:
    """Return the transform to the camera's ground frame, x right, y forward, z up.

    :func:`mount` has no yaw, and the camera is above the base's origin, so the ground frame is the
    base frame with other names of its axes.

    Returns:
        ``T_ground_world`` ``(4, 4)`` float64.
    """
    T = np.eye(4)
    T[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    return T @ np.linalg.inv(T_world_base)
