"""Free floor claimed: how much of the floor that can be driven on lies inside outlines."""

from typing import NamedTuple

import numpy as np

from benchmarks.paper.shots import Shot
from jaxdet.camera import pixel_rays
from jaxdet.config import Config
from jaxdet.eval.polygon import inside
from jaxdet.metric import rectangles, world_angle
from jaxdet.types import Detections

REACH_M = 4.0
"""Floor farther from the camera's foot than this does not count [m]."""
STEP_PX = 2
"""Every second pixel of every second row counts."""


class Claim(NamedTuple):
    """Pixels of one frame."""

    drivable: int
    """That show floor to drive on, within reach."""
    claimed: int
    """Of those, inside the rectangle of some obstacle."""

    @property
    def share(self) -> float:
        """Claimed of drivable; 0 where no such floor is seen."""
        return self.claimed / self.drivable if self.drivable else 0.0


def claim_of(shot: Shot, found: Detections, config: Config) -> Claim:
    """The drivable floor of a frame that its outlines claim.

    Args:
        shot: The frame.
        found: ``B = 1``.
        config: For the outlines' margin.

    Returns:
        Pixels counted; drivable is what :func:`jaxdet.sim.floor_truth` says.
    """
    points = _drivable_floor(shot)
    count = int(found.labels.num_obstacles[0])
    unit = shot.calibration.depth_unit
    claimed = np.zeros(len(points), bool)
    for outline in rectangles(found.obstacles, unit, config.footprint)[0, :count]:
        claimed |= inside(outline, points)
    return Claim(len(points), int(claimed.sum()))


def _drivable_floor(shot: Shot) -> np.ndarray:
    """Its true places in the camera's ground frame, ``(n, 2)`` float64 right, forward [m]."""
    assert shot.truth.drivable is not None and shot.truth.depth_m is not None
    part = np.zeros(shot.color.shape[:2], bool)
    part[::STEP_PX, ::STEP_PX] = True
    v, u = np.nonzero(part & shot.truth.drivable[0])
    z = shot.truth.depth_m[0, v, u].astype(np.float64)
    ray_x, ray_y = pixel_rays(shot.calibration.color)
    camera = np.stack([ray_x[v, u] * z, ray_y[v, u] * z, z], axis=-1)
    T = shot.T_world_camera
    dx, dy = (camera @ T[:2, :3].T).T
    sin, cos = world_angle(T)
    ground = np.stack([dx * cos - dy * sin, dx * sin + dy * cos], axis=-1)
    return ground[np.hypot(*ground.T) <= REACH_M]
