"""Triangle soups: meshes whose triangles share no vertices, so that they can be concatenated.

Lengths are in metres, as are texture coordinates ``(s, t)``. The winding order of a triangle is
irrelevant: surfaces are lit on the visible side.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from jaxdet.sim.appearance import Texture


class Mesh(NamedTuple):
    """A mesh of ``F`` triangles."""

    corners: np.ndarray
    """Vertices ``(F, 3, 3)`` float64 [m]."""
    normals: np.ndarray
    """Unit normals for shading, ``(F, 3, 3)`` float64."""
    places: np.ndarray
    """Texture coordinates ``(F, 3, 2)`` float64 [m]."""
    texture_index: np.ndarray
    """Index into ``textures``, ``(F,)`` int32."""
    textures: tuple[Texture, ...]

    def moved(self, T: np.ndarray) -> "Mesh":
        """Return the mesh after a rigid transform ``(4, 4)``."""
        R = T[:3, :3]
        return self._replace(corners=self.corners @ R.T + T[:3, 3], normals=self.normals @ R.T)

    def scaled(self, factor: float) -> "Mesh":
        """Return the mesh scaled about the origin; the size of its pattern does not change."""
        return self._replace(corners=self.corners * factor, places=self.places * factor)


def join(meshes: Iterable[Mesh]) -> Mesh:
    """Concatenate one or more meshes."""
    parts = list(meshes)
    textures = list(dict.fromkeys(texture for part in parts for texture in part.textures))
    index = [
        np.array([textures.index(k) for k in part.textures], np.int32)[part.texture_index]
        for part in parts
    ]
    return Mesh(
        np.concatenate([part.corners for part in parts]),
        np.concatenate([part.normals for part in parts]),
        np.concatenate([part.places for part in parts]),
        np.concatenate(index),
        tuple(textures),
    )


def shift(x: float = 0.0, y: float = 0.0, z: float = 0.0, yaw: float = 0.0) -> np.ndarray:
    """Return the transform ``(4, 4)`` that rotates about the vertical, then translates."""
    T = np.eye(4)
    c, s = np.cos(yaw), np.sin(yaw)
    T[:2, :2] = [[c, -s], [s, c]]
    T[:3, 3] = x, y, z
    return T


def soup(
    corners: np.ndarray, places: np.ndarray, texture: Texture, normals: np.ndarray | None = None
) -> Mesh:
    """Build a mesh of triangles ``(F, 3, 3)``, flat-shaded by default, without degenerate ones."""
    if normals is None:
        flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals = np.repeat(flat[:, None], 3, axis=1)
    size = np.linalg.norm(normals, axis=-1, keepdims=True)
    normals = np.divide(normals, size, out=np.zeros_like(normals), where=size > 0)
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    kept = np.linalg.norm(area, axis=1) > 1e-12
    count = int(kept.sum())
    return Mesh(corners[kept], normals[kept], places[kept], np.zeros(count, np.int32), (texture,))


def quads(grid: np.ndarray) -> np.ndarray:
    """Split each cell of a grid ``(m, n, k)`` into triangles ``(2 (m-1) (n-1), 3, k)``."""
    a, b, c, d = grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]
    pairs = np.stack([np.stack([a, b, c], 2), np.stack([a, c, d], 2)], 2)
    return pairs.reshape(-1, 3, grid.shape[-1])


def sheet(points: np.ndarray, texture: Texture, places: np.ndarray | None = None) -> Mesh:
    """Build a flat-shaded surface through a grid of points ``(m, n, 3)``."""
    if places is None:
        places = points[..., :2]
    return soup(quads(points), quads(places), texture)
