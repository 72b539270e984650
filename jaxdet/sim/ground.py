"""Height and mesh of the floor, and poses of objects and the robot on it."""

import numpy as np

from jaxdet.sim.appearance import Texture
from jaxdet.sim.mesh import Mesh, sheet
from jaxdet.sim.scene import Ground

EXTENT_M = 60.0
"""Half the side of the floor [m]."""
RISER_M = 1e-5
"""Half of the horizontal extent of a step's riser [m]."""
_ALONG = np.arange(-5.0, 14.0, 0.08)
_ACROSS = np.arange(-7.0, 7.0, 0.08)
"""Grid of the bumpy part of the floor, along and across the slope [m]."""
_STANCE_M = 0.2
"""Half the distance over which the tilt of the ground under an object is measured [m]."""


def ground_height(ground: Ground, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the height of the floor above z = 0 at ``x``, ``y`` [m].

    Bumps fade out towards the border of the grid in the floor's mesh.
    """
    c, s = np.cos(ground.slope_yaw), np.sin(ground.slope_yaw)
    a, b = c * x + s * y, c * y - s * x
    height = np.tan(ground.slope_rad) * np.clip(a - ground.slope_start_m, 0, ground.slope_length_m)
    if ground.bump_m:
        rng = np.random.default_rng([ground.seed, 11])
        waves, depth = 5, ground.bump_m
        for line, place in ((_ALONG, a), (_ACROSS, b)):
            depth = depth * np.clip(np.minimum(place - line[0], line[-1] - place), 0, 1)
        for _ in range(waves):
            way, phase = rng.uniform(0, 2 * np.pi, 2)
            k = 2 * np.pi / (ground.bump_size_m * rng.uniform(0.7, 1.4))
            wave = np.sin(k * (np.cos(way) * x + np.sin(way) * y) + phase)
            height = height + depth / waves * wave
    for edge in ground.edges_m:
        height = height - ground.drop_m * (a > edge)
    return height


def floor_mesh(ground: Ground, texture: Texture) -> Mesh:
    """Build the mesh of the floor, ``2 EXTENT_M`` wide: few triangles, or a grid for bumps.

    On bumps of height a and length L the error of the grid is at most ``a (0.25 m / L)^2 / 2``,
    0.05 a for the default.
    """
    lines = np.array([-EXTENT_M, EXTENT_M])
    start, length = ground.slope_start_m, ground.slope_length_m
    ramp = [start, start + length] if ground.slope_rad else []
    steps = [edge + side * RISER_M for edge in ground.edges_m for side in (-1, 1)]
    along = np.unique(np.clip([*lines, *ramp, *steps], -EXTENT_M, EXTENT_M))
    across = lines
    if ground.bump_m:
        along, across = np.union1d(along, _ALONG), np.union1d(across, _ACROSS)
    a, b = np.meshgrid(along, across, indexing="ij")
    c, s = np.cos(ground.slope_yaw), np.sin(ground.slope_yaw)
    x, y = c * a - s * b, s * a + c * b
    return sheet(np.stack([x, y, ground_height(ground, x, y)], axis=-1), texture)


def standing(ground: Ground, x: float, y: float) -> np.ndarray:
    """Return the transform that places an object at ``x, y`` on the ground: height and tilt.

    Returns:
        Transform ``(4, 4)`` float64, to be applied after the object's planar pose.
    """
    T = np.eye(4)
    if ground == Ground():
        return T
    step = np.array([-_STANCE_M, _STANCE_M])
    dx = np.diff(ground_height(ground, x + step, y + 0 * step))[0] / (2 * _STANCE_M)
    dy = np.diff(ground_height(ground, x + 0 * step, y + step))[0] / (2 * _STANCE_M)
    up = np.array([-dx, -dy, 1.0]) / np.sqrt(dx * dx + dy * dy + 1)
    axis = np.array([-up[1], up[0], 0.0])
    skew = np.array([[0, 0, axis[1]], [0, 0, -axis[0]], [-axis[1], axis[0], 0]])
    R = np.eye(3) + skew + skew @ skew / (1 + up[2])
    place = np.array([x, y, 0.0])
    T[:3, :3] = R
    lift = float(ground_height(ground, np.array(x), np.array(y)))
    T[:3, 3] = place - R @ place + (0.0, 0.0, lift)
    return T
