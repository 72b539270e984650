"""Synthetic cells of floors, ramps and boxes, and assertions on their floors."""

from typing import NamedTuple

import numpy as np

from jaxdet.camera import RAY_BITS, fixed_rays, pixel_rays
from jaxdet.config import FloorConfig
from jaxdet.floor.plane import down_vector, flat_plane, forward_vector
from jaxdet.reference._floor import FloorFit, find_floor
from jaxdet.types import GroundPlane, Intrinsics, Refusal

CAMERA = Intrinsics(160, 120, 152.0, 152.0, 79.5, 59.5)
CONFIG = FloorConfig()
UNIT = 0.001
Box = tuple[tuple[float, float, float], tuple[float, float, float]]
BOXES: list[Box] = [
    ((-0.6, 1.2, 0.0), (-0.2, 1.6, 0.3)),
    ((0.3, 1.8, 0.0), (0.9, 2.2, 0.6)),
    ((-4.0, 3.5, 0.0), (4.0, 3.6, 2.5)),
]
"""Two boxes and a wall behind them. Each has two opposite corners: right, forward and up from the
ground projection of the camera [m]."""


class Pose(NamedTuple):
    """Camera pose: height [m], pitch and roll [degree]."""

    height: float
    pitch: float
    roll: float

    def plane(self, height: float = 0.0, pitch: float = 0.0, roll: float = 0.0) -> GroundPlane:
        """Return the pose as a prior, with the given errors [m, degree]."""
        angles = np.radians([[self.pitch + pitch], [self.roll + roll]])
        return flat_plane(np.array([self.height + height]), *angles)


POSES = [Pose(0.3, 10, 1), Pose(0.62, 19, 10), Pose(0.62, 19, -10), Pose(1.2, 35, 3)]


def cast(
    pose: Pose, boxes: list[Box], *, ramp: tuple[float, float] | None = None, floor: bool = True
) -> np.ndarray:
    """Return the depth of a floor, boxes and a ramp (start [m], slope) if given, ``(R, C)`` [m]."""
    x, y = pixel_rays(CAMERA)
    rays = np.stack([x, y, np.ones_like(x)], axis=-1)
    down = down_vector(*np.radians([[pose.pitch], [pose.roll]]))
    forward = forward_vector(down)
    axes = np.concatenate([np.cross(down, forward), forward, -down])
    along, origin = rays @ axes.T, np.array([0.0, 0.0, pose.height])
    z = np.full(x.shape, np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        if floor:
            z = np.where(along[..., 2] < 0, pose.height / -along[..., 2], np.inf)
        if ramp:
            drop = ramp[1] * along[..., 1] - along[..., 2]
            tilted = np.where(drop > 0, (pose.height + ramp[0] * ramp[1]) / drop, np.inf)
            z = np.minimum(z, tilted) if ramp[1] > 0 else np.maximum(z, tilted)
        for box in boxes:
            ends = np.sort((np.array(box)[:, None, None] - origin) / along, axis=0)
            enter, leave = ends[0].max(axis=-1), ends[1].min(axis=-1)
            z = np.where((enter < leave) & (enter > 0), np.minimum(z, enter), z)
    return z


def cast_step(pose: Pose, drop: float, start: float) -> np.ndarray:
    """Return the depth of a floor with a step of ``drop`` at ``start`` and a box before it [m]."""
    low = pose._replace(height=pose.height + drop)
    box = (-0.3, start - 0.5, drop), (0.1, start - 0.2, drop + 0.3)
    return cast(low, [((-9.0, -1.0, 0.0), (9.0, start, drop)), box])


def measured(z: np.ndarray, seed: int = 0, noise: float = 0.002) -> np.ndarray:
    """Return the image [mm] that a stereo camera measures of depth [m], with noise and holes."""
    rng = np.random.default_rng(seed)
    z = np.minimum(z, 20)
    z = z + rng.normal(0, 1, z.shape) * noise * z * z
    z[rng.random(z.shape) < 0.1] = 0
    return np.where(z < 8, np.rint(z / UNIT), 0).astype(np.uint16)


def positions(z: np.ndarray, camera: Intrinsics, step: int = 1) -> list[np.ndarray]:
    """Return the positions of every ``step``-th pixel of depth images ``(B, H, W)``."""
    part = slice(step // 2, None, step)
    depth = z[:, part, part].astype(np.int64)
    half = 1 << (RAY_BITS - 1)
    x, y = ((ray[part, part] * depth + half) >> RAY_BITS for ray in fixed_rays(camera))
    return [a.astype(np.int32) for a in (x, y, depth)]


def found(z: np.ndarray, prior: GroundPlane, config: FloorConfig = CONFIG) -> FloorFit:
    """Return the floor that the reference finds in one synthetic frame."""
    return find_floor(*positions(z[None], CAMERA), prior, config, UNIT)


def errors(fit: FloorFit, pose: Pose) -> tuple[float, float, float]:
    """Return the errors of height [mm], pitch and roll [degree]."""
    plane = fit.plane
    pitch, roll = np.degrees([plane.pitch[0], plane.roll[0]])
    return 1000 * (plane.height[0] - pose.height), pitch - pose.pitch, roll - pose.roll


def assert_found(fit: FloorFit, pose: Pose, angle: float = 0.12, height: float = 4.0) -> None:
    assert fit.own[0]
    assert fit.refused[0] == Refusal.NONE
    off = errors(fit, pose)
    assert abs(off[0]) < height, off
    assert max(abs(off[1]), abs(off[2])) < angle, off


def assert_refused(fit: FloorFit, why: Refusal, prior: GroundPlane) -> None:
    assert Refusal(int(fit.refused[0])) == why
    assert not fit.own[0]
    for mine, given in zip(fit.plane, prior, strict=True):
        np.testing.assert_array_equal(mine, given)
