"""Solid shapes of objects as horizontal slices, for intersection tests."""

from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

import cv2
import numpy as np

from jaxdet.sim.mesh import Mesh

SLICE_M = 0.15
"""Maximum height of a slice [m]; in a slice a slanted part takes up all space that it crosses."""
TOUCH_M = 0.002
"""Objects that intersect by less than this only touch [m]."""


class Solid(NamedTuple):
    """An object as ``S`` horizontal slices of its connected parts, each a convex hull from above.

    A table, for instance, consists of a top and four legs, so that a chair fits under it.
    """

    box: np.ndarray
    """Minimum and maximum x, y, z of each slice, ``(S, 2, 3)`` float64 [m]."""
    outlines: tuple[np.ndarray, ...]
    """Convex polygon ``(n, 2)`` float64 of each slice [m]."""


def solid_of(mesh: Mesh) -> Solid:
    """Return the solid of an object; panes and lids without a volume are ignored."""
    boxes, outlines = [], []
    for part in _parts(mesh.corners):
        bottom, top = part[..., 2].min(), part[..., 2].max()
        levels = np.linspace(bottom, top, int(np.ceil((top - bottom) / SLICE_M)) + 1)
        for low, high in pairwise(levels.tolist()):
            outline = hull_between(part, low, high)
            if len(outline) > 2:
                boxes.append([[*outline.min(0), low], [*outline.max(0), high]])
                outlines.append(outline)
    return Solid(np.array(boxes).reshape(-1, 2, 3), tuple(outlines))


def swept(meshes: list[Mesh]) -> Solid:
    """Return the volume swept by an object on a straight path, from its meshes along the path."""
    corners = np.concatenate([mesh.corners for mesh in meshes])
    low, high = corners[..., 2].min(), corners[..., 2].max()
    outline = hull_between(corners, low, high)
    return Solid(np.array([[[*outline.min(0), low], [*outline.max(0), high]]]), (outline,))


def intersect(one: Solid, other: Solid, clear_m: float = -TOUCH_M) -> bool:
    """Return whether two solids are horizontally less than ``clear_m`` apart at any height [m]."""
    if not len(one.outlines) or not len(other.outlines):
        return False
    low = np.maximum(one.box[:, None, 0], other.box[None, :, 0])
    high = np.minimum(one.box[:, None, 1], other.box[None, :, 1])
    near = (high - low > (-clear_m, -clear_m, TOUCH_M)).all(axis=-1)
    pairs = np.argwhere(near).tolist()
    return any(gap(one.outlines[i], other.outlines[j]) < clear_m for i, j in pairs)


def gap(one: np.ndarray, other: np.ndarray) -> float:
    """Return the gap between two convex polygons by the separating axis test.

    The gap is at most the distance of the polygons, and negative if and only if they overlap.

    Args:
        one: Polygon ``(n, 2)``, counter-clockwise [m].
        other: Polygon ``(m, 2)``, counter-clockwise [m].
    """
    best = -np.inf
    for a, b in ((one, other), (other, one)):
        edge = np.roll(a, -1, axis=0) - a
        outward = np.stack([edge[:, 1], -edge[:, 0]]) / np.hypot(*edge.T)
        ahead = (b @ outward).min(axis=0) - (a * outward.T).sum(axis=1)
        best = max(best, float(ahead.max()))
    return best


def hull_between(corners: np.ndarray, low: float, high: float) -> np.ndarray:
    """Return the convex hull, seen from above, of the parts of triangles between two heights.

    Args:
        corners: Triangles ``(F, 3, 3)`` [m].
        low: Lower height [m].
        high: Upper height [m].

    Returns:
        Polygon ``(n, 2)`` float64, counter-clockwise [m].
    """
    a, b = corners, np.roll(corners, -1, axis=1)
    points = corners.reshape(-1, 3)
    parts = [points[(points[:, 2] >= low) & (points[:, 2] <= high)]]
    for level in (low, high):
        crosses = (a[..., 2] - level) * (b[..., 2] - level) < 0
        share = (level - a[crosses, 2]) / (b[crosses, 2] - a[crosses, 2])
        parts.append(a[crosses] + share[:, None] * (b[crosses] - a[crosses]))
    between = np.concatenate(parts)[:, :2]
    # Centred, so that OpenCV's float32 is exact to a tenth of a micrometre.
    middle = between.mean(0)
    hull = cv2.convexHull((between - middle).astype(np.float32), returnPoints=False)
    return between[hull.ravel()]


def _parts(corners: np.ndarray) -> Iterator[np.ndarray]:
    """Yield the triangles ``(F, 3, 3)`` of each part of a mesh that is connected by vertices."""
    places = np.rint(corners * 1e5).astype(np.int64)  # keys are unique within 21 m
    _, face = np.unique(places @ (1, 1 << 21, 1 << 42), return_inverse=True)
    part = np.arange(face.max() + 1)
    while True:
        least = part[face].min(axis=1)
        before = part.copy()
        np.minimum.at(part, face, least[:, None])
        part = part[part]
        if (part == before).all():
            break
    own = part[face[:, 0]]
    for one in np.unique(own):
        yield corners[own == one]
