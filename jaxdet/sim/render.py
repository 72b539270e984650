"""Noise-free rendering of a scene: surfaces, light, depth, object numbers, heights."""

from enum import IntEnum
from functools import lru_cache
from threading import Lock
from typing import NamedTuple

import numpy as np

from jaxdet.sim.exposure import LIGHTS, LightName
from jaxdet.sim.ground import ground_height
from jaxdet.sim.raycast import Caster, View
from jaxdet.sim.scene import Ground, Scene
from jaxdet.sim.world import Part, world_at
from jaxdet.types import Intrinsics


class PixelKind(IntEnum):
    """Kind of surface in a pixel."""

    NOTHING = 0
    FLOOR = 1
    WALL = 2
    OBSTACLE = 3


class Rendering(NamedTuple):
    """Image of a camera without sensor errors."""

    color: np.ndarray
    """RGB of the surfaces without light, ``(H, W, 3)`` float32 [grey levels], not clipped."""
    light: np.ndarray
    """Lighting ``(H, W, 3)`` float32: cosine between surface normal and lamp, times the visible
    fraction of the lamp; specular reflection of the lamp; cosine between surface normal and view.
    """
    gloss: np.ndarray
    """Gloss of the surface, ``(H, W)`` float32."""
    depth: np.ndarray
    """z in the camera, ``(H, W)`` float64 [m]; inf without a hit."""
    obstacle_id: np.ndarray
    """Number of the object (also of walls), ``(H, W)`` uint8, 0 = floor or nothing."""
    kind: np.ndarray
    """Kind of surface, ``(H, W)`` uint8, :class:`PixelKind`."""
    points: np.ndarray
    """World points ``(H, W, 3)`` float64 [m]; not finite without a hit."""
    ground: Ground
    """Shape of the floor."""
    mirrored: np.ndarray | None = None
    """z of the mirror image in a glossy floor, as if it were below the floor, ``(H, W)`` float64
    [m]; inf where it is empty, NaN outside of the floor; None: the floor doesn't mirror."""
    behind: np.ndarray | None = None
    """z behind clear panes, ``(H, W)`` float64 [m]; inf without a hit, NaN outside of panes;
    None: no clear panes. Colour and light are mixed with those behind the pane; all other arrays
    refer to the pane."""

    @property
    def height(self) -> np.ndarray:
        """Height of surfaces above the floor beneath, ``(H, W)`` float32 [m], NaN without a hit."""
        height = np.full(self.depth.shape, np.nan, np.float32)
        solid = self.kind >= PixelKind.WALL
        x, y, z = self.points[solid].T
        height[solid] = z - ground_height(self.ground, x, y)
        height[self.kind == PixelKind.FLOOR] = 0.0
        return height


def render(
    scene: Scene,
    camera: Intrinsics,
    T_world_camera: np.ndarray,
    *,
    seed: int = 0,
    time_s: float = 0.0,
    light: LightName | None = "normal",
    device: str = "cpu",
) -> Rendering:
    """Render a scene.

    Args:
        scene: Scene.
        camera: Camera; its distortion is ignored.
        T_world_camera: Pose of the optical frame in the world, ``(4, 4)`` float64.
        seed: Seed of the texture offsets.
        time_s: Time, for moving objects [s].
        light: Illumination, which sets the softness of shadows; None: no lighting is computed.
        device: Warp device of the ray caster.
    """
    when = time_s if scene.moves else 0.0
    caster = caster_of(scene, when, seed, device)
    softness = LIGHTS[light].softness if light else 0.0
    samples = LIGHTS[light].samples if light else 0
    view = View(T_world_camera, scene.light.direction, softness)
    face, depth, color, shine = (a[0] for a in caster.cast(camera, [view], samples))
    seen = face >= 0
    gloss = np.where(seen, caster.gloss[face], np.float32(0))
    number = np.where(seen, caster.object_of[face], 0).astype(np.uint8)
    kinds = np.full(len(scene.objects) + 1, PixelKind.OBSTACLE, np.uint8)
    kinds[0] = PixelKind.FLOOR
    kinds[len(kinds) - len(scene.walls) :] = PixelKind.WALL
    color[~seen] = scene.background
    mirrored = behind = None
    if _mirrors(scene):
        flipped = view._replace(T_world_camera=np.diag([1.0, 1.0, -1.0, 1.0]) @ T_world_camera)
        ghost = caster_of(scene, when, seed, device, "objects").cast(camera, [flipped])
        floor = seen & (number == 0)
        mirrored = np.where(floor, ghost.depth[0], np.nan)
        share = np.where(floor, gloss * (1 - shine[..., 2]) ** 2, 0)[..., None]
        image = np.where(ghost.face[0][..., None] >= 0, ghost.color[0], scene.background)
        color = (color + share * (image - color)).astype(np.float32)
    clear = np.where(seen, caster.clear[face], np.float32(0))
    if clear.any():
        back = caster_of(scene, when, seed, device, "opaque").cast(camera, [view], samples)
        behind = np.where(clear > 0, back.depth[0], np.nan)
        image = np.where(back.face[0][..., None] >= 0, back.color[0], scene.background)
        color = color + clear[..., None] * (image - color).astype(np.float32)
        shine = shine + clear[..., None] * (back.light[0] - shine)
    v, u = np.mgrid[: camera.height, : camera.width]
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)])
    with np.errstate(invalid="ignore"):
        local = np.moveaxis(rays * depth, 0, -1)
        points = local @ T_world_camera[:3, :3].T + T_world_camera[:3, 3]
    return Rendering(
        color=color,
        light=shine,
        gloss=gloss,
        depth=depth,
        obstacle_id=number,
        kind=np.where(seen, kinds[number], PixelKind.NOTHING).astype(np.uint8),
        points=points,
        ground=scene.ground,
        mirrored=mirrored,
        behind=behind,
    )


def _mirrors(scene: Scene) -> bool:
    """Return whether the floor mirrors objects: it is glossy and level, and there are objects."""
    level = scene.ground == Ground(seed=scene.ground.seed)
    return scene.floor.gloss > 0 and level and bool(scene.objects)


_building = Lock()


def caster_of(scene: Scene, time_s: float, seed: int, device: str, part: Part = "all") -> Caster:
    """Return the ray caster of a scene, or of a part of it, at a time [s]; casters are cached."""
    with _building:
        return _caster(scene, time_s, seed, device, part)


@lru_cache(maxsize=16)  # the current frames of all simulating threads
def _caster(scene: Scene, time_s: float, seed: int, device: str, part: Part) -> Caster:
    return Caster([world_at(scene, time_s, part)], seed, device)
