"""Ray caster in Warp, on the CPU or a CUDA device."""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import warp as wp

from jaxdet.sim import ray_kernels as kernels
from jaxdet.sim.appearance import Texture
from jaxdet.sim.texture import pattern
from jaxdet.sim.world import World
from jaxdet.types import Intrinsics


class View(NamedTuple):
    """A view of one of the caster's worlds."""

    T_world_camera: np.ndarray
    """Pose of the optical frame in the world, ``(4, 4)`` float64."""
    lamp: tuple[float, float, float] = (0.0, 0.0, 1.0)
    """Direction towards the lamp."""
    lamp_radius: float = 0.0
    """Radius of the lamp's disc at unit distance, which softens shadows."""
    world: int = 0
    """Index of the world."""


class Hits(NamedTuple):
    """First intersection of each pixel's ray, for ``B`` views."""

    face: np.ndarray
    """Index of the triangle over all worlds, ``(B, H, W)`` int32; -1: no hit."""
    depth: np.ndarray
    """z in the camera, ``(B, H, W)`` float64 [m]; inf without a hit."""
    color: np.ndarray
    """Colour of the surface, ``(B, H, W, 3)`` float32 [grey levels], not clipped."""
    light: np.ndarray
    """Lighting ``(B, H, W, 3)`` float32: cosine between surface normal and lamp, times the visible
    fraction of the lamp; specular reflection of the lamp; cosine between surface normal and view.
    """


class Caster:
    """Worlds on a device, ready for ray casting.

    Args:
        worlds: Worlds.
        seed: Seed of the texture offsets.
        device: Warp device.
    """

    def __init__(self, worlds: Sequence[World], seed: int = 0, device: str = "cpu") -> None:
        self.device = device
        wp.load_module(kernels, device=device)  # once, before threads use it
        self.first = np.r_[0, np.cumsum([len(w.object_of) for w in worlds])].astype(np.int32)
        self._meshes = [self._mesh(world) for world in worlds]
        textures = list(
            dict.fromkeys(texture for world in worlds for texture in world.mesh.textures)
        )
        self.object_of = np.concatenate([w.object_of for w in worlds])
        index = [np.array([textures.index(k) for k in w.mesh.textures], np.int32) for w in worlds]
        texture_of = np.concatenate(
            [i[w.mesh.texture_index] for i, w in zip(index, worlds, strict=True)]
        )
        self.gloss = np.array([texture.gloss for texture in textures], np.float32)[texture_of]
        self.clear = np.array([texture.clear for texture in textures], np.float32)[texture_of]
        corners = np.concatenate([world.mesh.corners for world in worlds])
        kinds = tuple(sorted({texture.kind for texture in textures}))
        self._arrays = (
            self._put(np.array([m.id for m in self._meshes], np.uint64), wp.uint64),
            self._put(self.first[:-1], wp.int32),
            self._put(_planes(corners), wp.float64),
            self._put(np.concatenate([w.mesh.normals for w in worlds]).astype(np.float32), wp.vec3),
            self._put(np.concatenate([w.mesh.places for w in worlds]).astype(np.float32), wp.vec2),
            self._put(texture_of, wp.int32),
            self._put(_texture_rows(textures, kinds, seed), wp.float32),
            _patterns(kinds, device),
        )

    def cast(self, camera: Intrinsics, views: Sequence[View], samples: int = 0) -> Hits:
        """Cast the rays of all views.

        Args:
            camera: Camera of all views; its distortion is ignored.
            views: ``B`` views.
            samples: Shadow rays per pixel; 0: no lighting is computed.
        """
        shape = (len(views), camera.height, camera.width)
        poses = np.array([view.T_world_camera[:3].ravel() for view in views], np.float64)
        pinhole = np.array([(camera.fx, camera.fy, camera.cx, camera.cy)] * len(views), np.float64)
        lamps = np.array([(*_unit(view.lamp), view.lamp_radius) for view in views], np.float32)
        types: tuple[Any, ...] = (wp.int32, wp.float64, wp.vec3, wp.vec3)
        out = [wp.empty(shape, dtype=kind, device=self.device) for kind in types]
        view_inputs = [
            self._put(np.array([view.world for view in views], np.int32), wp.int32),
            self._put(poses, wp.float64),
            self._put(pinhole, wp.float64),
            self._put(lamps, wp.float32),
            samples,
        ]
        inputs = [*self._arrays, *view_inputs]
        wp.launch(kernels.raycast_view, shape, inputs, out, device=self.device)
        return Hits(*(array.numpy() for array in out))

    def _put(self, array: np.ndarray, dtype: Any) -> wp.array:
        return wp.array(np.ascontiguousarray(array), dtype=dtype, device=self.device)

    def _mesh(self, world: World) -> wp.Mesh:
        points = world.mesh.corners.reshape(-1, 3).astype(np.float32)
        indices = np.arange(len(points), dtype=np.int32)
        return wp.Mesh(self._put(points, wp.vec3), self._put(indices, wp.int32))


def _unit(vector: tuple[float, float, float]) -> np.ndarray:
    return np.asarray(vector) / np.linalg.norm(vector)


def _planes(corners: np.ndarray) -> np.ndarray:
    """Return unit normal and offset of each triangle, ``(F, 4)`` float64."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return np.column_stack([normal, (normal * corners[:, 0]).sum(1)])


def _texture_rows(textures: Sequence[Texture], kinds: tuple[str, ...], seed: int) -> np.ndarray:
    """Return the texture parameters ``(L, 12)`` float32, as documented in the kernel."""
    shifts = np.random.default_rng([seed, 3]).random((len(textures), 2))
    rows = [
        (kinds.index(k.kind), *k.color, *k.accent, k.size_m, k.grain, k.gloss, *shifts[i])
        for i, k in enumerate(textures)
    ]
    return np.array(rows, np.float32)


@lru_cache(maxsize=8)
def _patterns(kinds: tuple[str, ...], device: str) -> wp.array:
    stack = np.stack([pattern(kind) for kind in kinds])
    return wp.array(stack, dtype=wp.vec3, device=device)
