"""Triangle meshes: soups of triangles, each with its own corners, so that joining is concatenating.

Lengths in metres. Surfaces carry places ``(s, t)`` in metres for their texture. Which way round a
triangle goes does not matter: a surface is lit on the side that is looked at.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from jaxdet.sim.looks import Texture


class Mesh(NamedTuple):
    """``F`` triangles."""

    corners: np.ndarray
    """``(F, 3, 3)`` float64 [m]."""
    normals: np.ndarray
    """``(F, 3, 3)`` float64, unit, for shading."""
    places: np.ndarray
    """``(F, 3, 2)`` float64, place on the surface [m]."""
    look: np.ndarray
    """``(F,)`` int32, index into ``looks``."""
    looks: tuple[Texture, ...]

    def moved(self, T: np.ndarray) -> "Mesh":
        """The mesh under a rigid motion ``(4, 4)``."""
        R = T[:3, :3]
        return self._replace(corners=self.corners @ R.T + T[:3, 3], normals=self.normals @ R.T)

    def scaled(self, factor: float) -> "Mesh":
        """The mesh made larger about the origin; its texture keeps its scale."""
        return self._replace(corners=self.corners * factor, places=self.places * factor)


def join(meshes: Iterable[Mesh]) -> Mesh:
    """All meshes as one; at least one."""
    parts = list(meshes)
    looks = list(dict.fromkeys(look for part in parts for look in part.looks))
    index = [np.array([looks.index(k) for k in part.looks], np.int32)[part.look] for part in parts]
    return Mesh(
        np.concatenate([part.corners for part in parts]),
        np.concatenate([part.normals for part in parts]),
        np.concatenate([part.places for part in parts]),
        np.concatenate(index),
        tuple(looks),
    )


def shift(x: float = 0.0, y: float = 0.0, z: float = 0.0, yaw: float = 0.0) -> np.ndarray:
    """The motion ``(4, 4)`` that turns by ``yaw`` about the vertical, then moves."""
    T = np.eye(4)
    c, s = np.cos(yaw), np.sin(yaw)
    T[:2, :2] = [[c, -s], [s, c]]
    T[:3, 3] = x, y, z
    return T


def soup(
    corners: np.ndarray, places: np.ndarray, look: Texture, normals: np.ndarray | None = None
) -> Mesh:
    """A mesh of triangles ``(F, 3, 3)``, flat-shaded where no normals are given; empty triangles
    are left out."""  # noqa: D205, D209
    if normals is None:
        flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals = np.repeat(flat[:, None], 3, axis=1)
    size = np.linalg.norm(normals, axis=-1, keepdims=True)
    normals = np.divide(normals, size, out=np.zeros_like(normals), where=size > 0)
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    kept = np.linalg.norm(area, axis=1) > 1e-12
    count = int(kept.sum())
    return Mesh(corners[kept], normals[kept], places[kept], np.zeros(count, np.int32), (look,))


def quads(grid: np.ndarray) -> np.ndarray:
    """The two triangles of each cell of a grid ``(m, n, k)``: ``(2 (m-1) (n-1), 3, k)``."""
    a, b, c, d = grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]
    pairs = np.stack([np.stack([a, b, c], 2), np.stack([a, c, d], 2)], 2)
    return pairs.reshape(-1, 3, grid.shape[-1])


def sheet(points: np.ndarray, look: Texture, places: np.ndarray | None = None) -> Mesh:
    """A flat-shaded surface through a grid of points ``(m, n, 3)``."""
    if places is None:
        places = points[..., :2]
    return soup(quads(points), quads(places), look)
