"""Casting camera rays on a scene's solids.

Rays have a unit component along the optical axis, so the ray parameter *is* the depth z. Each
solid is tried only inside the image rectangle that its corners span.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from jaxdet.sim.scene import Box, Cylinder, Scene, bounds, rotation_z
from jaxdet.types import Intrinsics

NEAR = 1e-3
"""Nothing nearer is seen [m]."""


class Hits(NamedTuple):
    """What each pixel's ray meets first."""

    depth: np.ndarray
    """``(H, W)`` float64, z in the camera [m]; inf where nothing is hit."""
    obstacle_id: np.ndarray
    """``(H, W)`` uint8, number of the object, 0 = floor or nothing."""
    rays: np.ndarray
    """``(3, H, W)`` float64, ray directions in the world, 1 along the optical axis."""


@lru_cache(maxsize=8)
def camera_rays(camera: Intrinsics) -> np.ndarray:
    """Directions ``(3, H * W)`` float64 through the pixels' centres, z = 1; no distortion."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    x, y = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
    rays = np.stack([x.ravel(), y.ravel(), np.ones(x.size)])
    rays.setflags(write=False)
    return rays


def cast(scene: Scene, camera: Intrinsics, T_world_camera: np.ndarray) -> Hits:
    """Find what each pixel sees.

    Args:
        scene: The world.
        camera: A camera; its distortion is ignored.
        T_world_camera: ``(4, 4)`` float64, optical frame to world.
    """
    R, origin = T_world_camera[:3, :3], T_world_camera[:3, 3]
    shape = (camera.height, camera.width)
    rays = (R @ camera_rays(camera)).reshape(3, *shape)
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = -origin[2] / rays[2]
        depth[~(depth > NEAR)] = np.inf
        number = np.zeros(shape, np.uint8)
        for i, solid in enumerate(scene.solids):
            where = _window(solid, camera, T_world_camera)
            if where is None:
                continue
            t = _hit(solid, origin, rays[:, *where])
            nearer = t < depth[where]
            depth[where][nearer] = t[nearer]
            number[where][nearer] = i + 1
    return Hits(depth, number, rays)


def _window(
    solid: Box | Cylinder, camera: Intrinsics, T_world_camera: np.ndarray
) -> tuple[slice, slice] | None:
    """The image rectangle around a solid; None where it is out of sight."""
    x, y, z = (np.linalg.inv(T_world_camera) @ np.c_[bounds(solid), np.ones(8)].T)[:3]
    if (z < NEAR).all():
        return None
    if (z < NEAR).any():
        return slice(0, camera.height), slice(0, camera.width)
    u, v = x / z * camera.fx + camera.cx, y / z * camera.fy + camera.cy
    rows = slice(max(0, int(v.min()) - 1), max(0, min(camera.height, int(v.max()) + 2)))
    columns = slice(max(0, int(u.min()) - 1), max(0, min(camera.width, int(u.max()) + 2)))
    empty = rows.start >= rows.stop or columns.start >= columns.stop
    return None if empty else (rows, columns)


def _hit(solid: Box | Cylinder, origin: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """Depth ``(h, w)`` at which rays enter a solid, inf where they miss it."""
    if isinstance(solid, Box):
        return _hit_box(solid, origin, rays)
    return _hit_cylinder(solid, origin, rays)


def _slab(low: float, high: float, start: float, step: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    a, b = (low - start) / step, (high - start) / step
    return np.minimum(a, b), np.maximum(a, b)


def _entry(enter: np.ndarray, leave: np.ndarray) -> np.ndarray:
    return np.where((enter <= leave) & (enter > NEAR), enter, np.inf)


def _hit_box(box: Box, origin: np.ndarray, rays: np.ndarray) -> np.ndarray:
    R = rotation_z(-box.yaw)
    x, y = R @ (origin[:2] - box.center)
    half_x, half_y = box.size[0] / 2, box.size[1] / 2
    enter, leave = _slab(-half_x, half_x, x, R[0, 0] * rays[0] + R[0, 1] * rays[1])
    for low, high, start, step in (
        (-half_y, half_y, y, R[1, 0] * rays[0] + R[1, 1] * rays[1]),
        (box.base, box.base + box.size[2], origin[2], rays[2]),
    ):
        near, far = _slab(low, high, start, step)
        enter, leave = np.maximum(enter, near), np.minimum(leave, far)
    return _entry(enter, leave)


def _hit_cylinder(cylinder: Cylinder, origin: np.ndarray, rays: np.ndarray) -> np.ndarray:
    x, y = origin[:2] - cylinder.center
    a = rays[0] ** 2 + rays[1] ** 2
    b = x * rays[0] + y * rays[1]
    root = np.sqrt(b * b - a * (x * x + y * y - cylinder.radius**2))
    near, far = _slab(cylinder.base, cylinder.base + cylinder.height, origin[2], rays[2])
    return _entry(np.maximum((-b - root) / a, near), np.minimum((-b + root) / a, far))
