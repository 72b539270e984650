"""Mesh primitives: rings, lathes, boxes, tubes, ellipsoids, prisms. Lengths in metres."""

from collections.abc import Iterable

import numpy as np

from jaxdet.sim.appearance import Texture
from jaxdet.sim.mesh import Mesh, join, quads, sheet, soup

Point = tuple[float, float, float] | np.ndarray


def rings(points: np.ndarray, texture: Texture, smooth_along: bool = False) -> Mesh:
    """Build the surface through a stack of closed rings, smoothly shaded around.

    Args:
        points: m rings of n points, ``(m, n, 3)``, counter-clockwise seen from the last ring.
        texture: Texture; its coordinate s runs around a ring, t from the first ring to the last.
        smooth_along: Whether to shade smoothly from ring to ring too.
    """
    closed = np.concatenate([points, points[:, :1]], axis=1)
    across = np.diff(closed, axis=1)
    girth = np.cumsum(np.linalg.norm(across, axis=-1).mean(0))
    along = np.linalg.norm(np.diff(points.mean(1), axis=0), axis=-1)
    reach = np.linalg.norm(np.diff(closed[:, :-1], axis=0), axis=-1).mean(1)
    s = np.broadcast_to(np.r_[0.0, girth], closed.shape[:2])
    t = np.broadcast_to(np.r_[0.0, np.cumsum(np.maximum(along, reach))][:, None], s.shape)
    diagonal = closed[1:, 1:] - closed[:-1, :-1], closed[1:, :-1] - closed[:-1, 1:]
    flat = np.cross(*diagonal)  # (m-1, n, 3), one per cell
    corner = flat + np.roll(flat, 1, axis=1)
    corner = np.concatenate([corner, corner[:, :1]], axis=1)
    if smooth_along:
        both = np.concatenate([corner[:1], corner[:-1] + corner[1:], corner[-1:]])
        lower, upper = both[:-1], both[1:]
    else:
        lower = upper = corner
    a, b, c, d = lower[:, :-1], lower[:, 1:], upper[:, 1:], upper[:, :-1]
    normals = np.stack([np.stack([a, b, c], 2), np.stack([a, c, d], 2)], 2).reshape(-1, 3, 3)
    return soup(quads(closed), quads(np.stack([s, t], -1)), texture, normals)


def fan(outline: np.ndarray, texture: Texture) -> Mesh:
    """Build the face inside a flat outline ``(n, 3)`` that is star-shaped about its centre."""
    center = np.broadcast_to(outline.mean(0), outline.shape)
    corners = np.stack([center, outline, np.roll(outline, -1, axis=0)], axis=1)
    normal = np.abs(np.cross(outline - center, np.roll(outline, -1, 0) - center).sum(0))
    across = np.delete(np.arange(3), int(np.argmax(normal)))
    return soup(corners, corners[..., across], texture)


def circle(radius: float, z: float, sides: int = 48, x: float = 0.0, y: float = 0.0) -> np.ndarray:
    """Return a horizontal ring of points ``(sides, 3)``."""
    angle = np.arange(sides) * (2 * np.pi / sides)
    ring = np.stack([x + radius * np.cos(angle), y + radius * np.sin(angle)], 1)
    return np.column_stack([ring, np.full(sides, z)])


def lathe(profile: Iterable[tuple[float, float]], texture: Texture, sides: int = 48) -> Mesh:
    """Build a surface of revolution through ``(radius, height)`` points.

    Points from bottom to top give an outer side, from top to bottom an inner side.
    """
    return rings(np.stack([circle(r, z, sides) for r, z in profile]), texture)


def cylinder(radius: float, height: float, texture: Texture, sides: int = 64) -> Mesh:
    """Build an upright cylinder on z = 0; at 64 sides its faces are within 0.12 % of the radius."""
    lid = fan(circle(radius, height, sides), texture)
    return join([lathe([(radius, 0.0), (radius, height)], texture, sides), lid])


def box(size: Point, texture: Texture, at: Point = (0.0, 0.0, 0.0), top: float = 1.0) -> Mesh:
    """Build a box.

    Args:
        size: Size along x, y, z [m].
        texture: Texture; its coordinates on a face begin at a corner.
        at: Middle of the underside [m].
        top: Size of the upper face relative to the lower.
    """
    half = np.array(size)[:2] / 2
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half
    low = np.column_stack([corners, np.zeros(4)])
    high = np.column_stack([corners * top, np.full(4, float(size[2]))])
    faces = [[low[i], low[j], high[j], high[i]] for i, j in ((0, 1), (1, 2), (2, 3), (3, 0))]
    faces += [list(high), list(low[::-1])]
    parts: list[Mesh] = []
    for face in faces:
        grid = np.array([[face[0], face[1]], [face[3], face[2]]]) + np.asarray(at)
        width, height = np.linalg.norm([grid[0, 1] - grid[0, 0], grid[1, 0] - grid[0, 0]], axis=1)
        places = np.array([[[0, 0], [width, 0]], [[0, height], [width, height]]])
        parts.append(sheet(grid, texture, places))
    return join(parts)


def tube(
    path: Iterable[Point],
    radii: Iterable[float | tuple[float, float]],
    texture: Texture,
    sides: int = 14,
    rounded: bool = True,
) -> Mesh:
    """Build a round or elliptic tube along a line of points.

    Args:
        path: ``k`` points.
        radii: Radius at each point, or both radii of an ellipse.
        texture: Texture.
        sides: Number of points per ring.
        rounded: Whether hemispheres close the ends, else flat lids.
    """
    line = np.array([np.asarray(p, float) for p in path])
    size = np.array([np.broadcast_to(np.asarray(r, float), 2) for r in radii])
    way = np.gradient(line, axis=0)
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    helper = np.array([1.0, 0.0, 0.0]) if abs(way[:, 2]).min() > 0.3 else np.array([0.0, 0.0, 1.0])
    side = np.cross(way, helper)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    up = np.cross(way, side)
    if rounded:
        bend = np.array([np.pi / 2 * k / 4 for k in (0.1, 1, 2, 3)])
        head, tail = np.sin(bend), np.cos(bend)
        reach = size.mean(1)
        before = line[0] - np.outer(tail * reach[0], way[0])
        after = line[-1] + np.outer(tail * reach[-1], way[-1])[::-1]
        line = np.concatenate([before, line, after])
        ends = np.outer(head, size[0]), np.outer(head[::-1], size[-1])
        size = np.concatenate([ends[0], size, ends[1]])
        side, up = (np.concatenate([[a[0]] * 4, a, [a[-1]] * 4]) for a in (side, up))
    angle = np.arange(sides) * (2 * np.pi / sides)
    c, s = np.cos(angle)[None, :, None], np.sin(angle)[None, :, None]
    ring = (
        line[:, None] + side[:, None] * size[:, None, :1] * c + up[:, None] * size[:, None, 1:] * s
    )
    lids = [] if rounded else [fan(ring[0], texture), fan(ring[-1], texture)]
    return join([rings(ring, texture, smooth_along=rounded), *lids])


def ellipsoid(center: Point, radii: Point, texture: Texture, sides: int = 16) -> Mesh:
    """Build an ellipsoid with horizontal rings."""
    lift = np.linspace(-np.pi / 2 + 0.05, np.pi / 2 - 0.05, sides // 2 + 1)
    angle = np.arange(sides) * (2 * np.pi / sides)
    ball = np.stack(
        [
            np.outer(np.cos(lift), np.cos(angle)),
            np.outer(np.cos(lift), np.sin(angle)),
            np.outer(np.sin(lift), np.ones(sides)),
        ],
        axis=-1,
    )
    return rings(ball * np.asarray(radii) + np.asarray(center), texture, smooth_along=True)


def prism(outline: np.ndarray, width: float, texture: Texture, bevel: float = 0.0) -> Mesh:
    """Extrude a side view ``(n, 2)`` in x, z (counter-clockwise seen from -y) along y.

    Args:
        outline: Corners of a star-shaped polygon.
        width: Width along y [m].
        texture: Texture.
        bevel: Bevel of the long edges [m].
    """
    middle = outline.mean(0)
    inner = middle + (outline - middle) * (1 - bevel / np.abs(outline - middle).max())
    half = width / 2
    places = [(-half, inner), (-half + bevel, outline), (half - bevel, outline), (half, inner)]
    if bevel == 0:
        places = places[1:3]
    stack = np.stack([np.column_stack([o[:, 0], np.full(len(o), y), o[:, 1]]) for y, o in places])
    closed = np.concatenate([stack, stack[:, :1]], axis=1)
    girth = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(closed[0], axis=0), axis=1))]
    s = np.broadcast_to(girth, closed.shape[:2])
    t = closed[..., 1]
    skin = soup(quads(closed), quads(np.stack([s, t], -1)), texture)
    return join([skin, fan(stack[0], texture), fan(stack[-1], texture)])
