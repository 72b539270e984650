"""Depth of a floor, a box or a cylinder, by its equation."""

import numpy as np

from jaxdet.types import Intrinsics


def rays_of(camera: Intrinsics, T_world_camera: np.ndarray) -> np.ndarray:
    """Return directions ``(H, W, 3)`` in the world, of length 1 along the optical axis."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    local = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)])
    return np.moveaxis(local, 0, -1) @ T_world_camera[:3, :3].T


def floor_depth(origin: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """Return the depth of the floor z = 0."""
    with np.errstate(divide="ignore"):
        depth = -origin[2] / rays[..., 2]
    return np.where(depth > 0, depth, np.inf)


def box_depth(origin: np.ndarray, rays: np.ndarray, center, size, yaw: float) -> np.ndarray:
    """Return the depth of an upright box on the floor."""
    c, s = np.cos(yaw), np.sin(yaw)
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    start, way = (origin - [*center, size[2] / 2]) @ R, rays @ R
    half = np.array(size) / 2
    with np.errstate(divide="ignore"):
        a, b = (-half - start) / way, (half - start) / way
    enter, leave = np.minimum(a, b).max(-1), np.maximum(a, b).min(-1)
    return np.where((enter <= leave) & (enter > 0), enter, np.inf)


def cylinder_depth(origin: np.ndarray, rays: np.ndarray, center, radius: float) -> np.ndarray:
    """Return the depth of an infinite upright cylinder."""
    x, y = origin[:2] - center
    a = rays[..., 0] ** 2 + rays[..., 1] ** 2
    b = x * rays[..., 0] + y * rays[..., 1]
    root = b * b - a * (x * x + y * y - radius**2)
    return np.where(root > 0, (-b - np.sqrt(np.maximum(root, 0))) / a, np.inf)
