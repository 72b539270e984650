"""One noise-free picture of a scene: colour, depth, obstacle numbers, points."""

from typing import NamedTuple

import numpy as np

from jaxdet.sim.raycast import cast
from jaxdet.sim.scene import Box, Cylinder, Scene, rotation_z
from jaxdet.sim.texture import sample
from jaxdet.types import Intrinsics

_UP = np.array([0.0, 0.0, 1.0])


class Rendering(NamedTuple):
    """What an ideal camera sees."""

    color: np.ndarray
    """``(H, W, 3)`` float32, RGB in grey levels, not clipped."""
    depth: np.ndarray
    """``(H, W)`` float64, z in the camera [m]; inf where nothing is hit."""
    obstacle_id: np.ndarray
    """``(H, W)`` uint8, number of the object, 0 = floor or nothing."""
    points: np.ndarray
    """``(H, W, 3)`` float64, world [m]; not finite where nothing is hit."""


def render(
    scene: Scene, camera: Intrinsics, T_world_camera: np.ndarray, seed: int = 0
) -> Rendering:
    """Look at a scene.

    Args:
        scene: The world.
        camera: A camera; its distortion is ignored.
        T_world_camera: ``(4, 4)`` float64, optical frame to world.
        seed: Variation of the textures.
    """
    hits = cast(scene, camera, T_world_camera)
    with np.errstate(invalid="ignore"):
        points = np.moveaxis(hits.rays * hits.depth, 0, -1) + T_world_camera[:3, 3]
    color = np.empty((*hits.depth.shape, 3), np.float32)
    color[:] = scene.background
    seen = np.isfinite(hits.depth)
    for number in np.unique(hits.obstacle_id):
        chosen = seen & (hits.obstacle_id == number)
        solid = scene.solids[number - 1] if number else None
        rays = hits.rays[:, chosen].T
        pixel_m = hits.depth[chosen] / camera.fx
        color[chosen] = _shade(scene, solid, points[chosen], rays, pixel_m, seed + int(number))
    return Rendering(color, hits.depth, hits.obstacle_id, points)


def _shade(
    scene: Scene,
    solid: Box | Cylinder | None,
    points: np.ndarray,
    rays: np.ndarray,
    pixel_m: np.ndarray,
    seed: int,
) -> np.ndarray:
    """Colours ``(n, 3)`` float32 of points ``(n, 3)`` on one surface, Lambert's law."""
    st, normal = _surface(solid, points)
    texture = scene.floor if solid is None else solid.texture
    # A pixel covers more where the surface is slanted; the root is between its two widths.
    slant = np.abs((normal * rays).sum(1)) / np.sqrt((rays * rays).sum(1))
    color = sample(texture, seed, st, pixel_m / np.sqrt(np.maximum(slant, 0.05)))
    lamp = np.asarray(scene.light.direction) / np.linalg.norm(scene.light.direction)
    shine = scene.light.ambient + scene.light.diffuse * np.maximum(normal @ lamp, 0)
    return color * np.broadcast_to(shine, len(color))[:, None].astype(np.float32)


def _surface(solid: Box | Cylinder | None, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Surface coordinates ``(n, 2)`` [m] and outward normals ``(n, 3)`` or ``(1, 3)``."""
    if solid is None:
        return points[:, :2], _UP[None]
    if isinstance(solid, Box):
        return _box_surface(solid, points)
    return _cylinder_surface(solid, points)


def _box_surface(box: Box, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    half = np.array(box.size) / 2
    R = np.eye(3)
    R[:2, :2] = rotation_z(box.yaw)
    local = (points - [*box.center, box.base + half[2]]) @ R
    axis = np.argmax(np.abs(local) - half, axis=1)
    side = np.sign(np.take_along_axis(local, axis[:, None], 1))
    across = np.array([[1, 2], [0, 2], [0, 1]])[axis]
    st = np.take_along_axis(local + half, across, 1)
    return st, side * R.T[axis]


def _cylinder_surface(cylinder: Cylinder, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    x, y = (points[:, :2] - cylinder.center).T
    z = points[:, 2] - cylinder.base
    st = np.stack([np.arctan2(y, x) * cylinder.radius, z], 1)
    normal = np.stack([x, y, np.zeros_like(x)], 1) / cylinder.radius
    top = z > cylinder.height - 1e-6
    st[top] = np.stack([x, y], 1)[top]
    normal[top] = _UP
    return st, normal
