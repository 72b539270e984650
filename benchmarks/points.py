"""Feature frames of any size, for the stages that process points."""

from dataclasses import replace

import numpy as np

from benchmarks.scene import CALIBRATIONS, CONFIG, HEIGHT_M, PITCH_RAD
from jaxdet.config import Config
from jaxdet.floor.plane import flat_plane, repeat_plane
from jaxdet.types import Calibration, Features, GroundPlane

OBSTACLES = 8


def camera() -> Calibration:
    """Return the calibration of the camera of the points."""
    return CALIBRATIONS["640x480"]


def plane_of(batch: int) -> GroundPlane:
    """Return the floor of each frame."""
    one = flat_plane(*(np.array([a]) for a in (HEIGHT_M, PITCH_RAD, 0.0)))
    return repeat_plane(one, batch)


def settings(config: Config, n: int) -> Config:
    """Return the configuration with ``n`` corner slots."""
    return replace(config, features=replace(config.features, max_corners=n))


def points(batch: int, n: int, seed: int = 0) -> Features:
    """Create frames in which all ``n`` slots contain a kept point.

    Nearly all points lie on eight upright boards, 0.1 to 0.6 m wide and up to 6 cm deep; one in a
    hundred is clutter at any depth from 0.3 m to the maximum.

    Args:
        batch: Number of frames ``B``.
        n: Number of points ``N`` per frame.
        seed: Random seed.
    """
    rng, color, shape = np.random.default_rng(seed), camera().image, (batch, n)
    near, far = 300, round(CONFIG.ground.max_depth_m * 1000)
    board = np.arange(batch)[:, None], rng.integers(0, OBSTACLES, shape)
    boards = batch, OBSTACLES
    front = rng.integers(near, far, boards)[board] + rng.integers(0, 60, shape)
    middle = rng.uniform(-0.45, 0.45, boards)[board] * front
    width = rng.integers(100, 600, boards)[board]
    clutter = rng.random(shape) < 0.01
    z = np.where(clutter, rng.integers(near, far, shape), front)
    aside = middle + rng.uniform(-0.5, 0.5, shape) * width
    x = np.where(clutter, rng.uniform(-0.5, 0.5, shape) * z, aside)
    y = rng.uniform(-0.3, 0.1, shape) * z
    u = np.clip(x / z * color.fx + color.cx, 0, color.width - 1)
    v = np.clip(y / z * color.fy + color.cy, 0, color.height - 1)
    u, v, x, y, z = (a.astype(np.int32) for a in (u, v, x, y, z))
    yes = np.ones(shape, bool)
    return Features(u, v, x, y, z, valid=yes, kept=yes, overflow=np.zeros(batch, bool))
