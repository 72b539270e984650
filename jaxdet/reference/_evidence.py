"""Features of pairs of surfaces: distances, what lies between them, and their sizes."""

from typing import NamedTuple

import numpy as np

from jaxdet.affinity import NO_STEP
from jaxdet.config import ObstacleConfig
from jaxdet.reference._outlines import contours
from jaxdet.reference._view import Extents, View, extents

MOST_BETWEEN = 11
"""Two surfaces in a row or column are compared if at most this many runs of cells are between."""
# surfaces are viewed obliquely: depths may differ by a tenth of the distance between them
SLOPE = 10
# surfaces that do not face each other are pairs if their contours are at most this many times
# ``depth_gap_m`` apart
CONTACT = 2
PERCENT = 100


class Facing(NamedTuple):
    """Statistics of surfaces that face each other in rows or in columns, each ``(S, S)`` int64.

    Only the upper triangle is used. Two surfaces face each other where at most ``MOST_BETWEEN``
    runs of cells lie between, none of which belongs to one of them. This may occur several times in
    a row or column.
    """

    places: np.ndarray  # number of places where two surfaces face each other
    through: np.ndarray  # number of ``places`` with floor or something farther in between
    hidden: np.ndarray
    """Number of ``places`` with something nearer, and nothing farther, between the surfaces."""
    holes: np.ndarray
    """Number of the remaining ``places`` with something between the surfaces: cells without depth,
    or surfaces at about the same depth."""
    agree: np.ndarray
    """Number of places in ``hidden`` or ``holes`` where the depths of both surfaces agree."""
    steps: np.ndarray  # sum of steps in depth, except at ``through`` [depth units]


class Pairs(NamedTuple):
    """Pairs of surfaces of a frame that may belong to one object."""

    one: np.ndarray  # (P,) int64, number of a surface
    other: np.ndarray  # (P,) int64, a surface with a higher number
    features: np.ndarray
    """Features ``(P, 26)`` int64, in the order of :data:`jaxdet.affinity.PAIR_FEATURES` [depth
    units, cells, lines, percent]."""


def pairs(
    label: np.ndarray, free: np.ndarray, view: View, unit: float, config: ObstacleConfig
) -> Pairs:
    """Find the pairs of surfaces that may belong to one object, and compute their features.

    Their distance on the floor is at most ``lateral_gap_m`` sideways and ``forward_gap_m`` forward
    (Eq. 6 on both axes at once). Also, they face each other in some row or column, or their
    contours are close.

    Args:
        label: Surfaces ``(R, C)``, -1 = none.
        free: Whether each cell is free, ``(R, C)`` bool: floor, or beyond the range.
        view: Positions of the cells.
        unit: Metres in one depth unit.
        config: The maximum gaps.
    """
    extent, gap = extents(label, view), round(config.depth_gap_m / unit)
    rows = facing(label, free, view.z, view.x, gap)
    columns = facing(label.T, free.T, view.z.T, view.y.T, gap)
    aside, ahead = _extent_gaps(extent)
    distance = _contour_gaps(label, view, len(extent.cells))
    near = (aside <= round(config.lateral_gap_m / unit)) & (
        ahead <= round(config.forward_gap_m / unit)
    )
    near &= (rows.places + columns.places > 0) | (distance <= CONTACT * gap)
    one, other = at = np.nonzero(np.triu(near, 1))

    sizes = extent.top, extent.bottom, extent.depth, extent.width, extent.cells
    rank = np.argsort(np.lexsort(sizes))
    fewer = rank[one] < rank[other]
    less, more = np.where(fewer, one, other), np.where(fewer, other, one)
    narrower = np.maximum(np.minimum(extent.width[one], extent.width[other]), 1)
    shorter = np.minimum(extent.rows[one], extent.rows[other])
    closed = (rows.places - rows.through)[at]
    step = rows.steps[at] // np.maximum(closed, 1)
    features = [
        distance[at],
        np.maximum(ahead[at], 0),
        PERCENT * -aside[at] // narrower,  # rounded down
        np.where(closed > 0, step, round(NO_STEP / (1000 * unit))),
        rows.through[at],
        PERCENT * rows.hidden[at] // shorter,
        rows.agree[at],
        PERCENT * rows.agree[at] // shorter,
        columns.through[at],
        (columns.hidden + columns.holes)[at],
        np.minimum(extent.near[one], extent.near[other]),
    ]
    for size in (extent.cells, extent.width, extent.depth, extent.bottom, extent.top):
        features += [size[less], size[more]]
    features += [extent.near[less] - extent.near[more], rows.places[at], columns.places[at]]
    for lines in (rows, columns):
        features.append(PERCENT * lines.through[at] // np.maximum(lines.places[at], 1))
    return Pairs(one, other, np.stack(features, axis=1))


def facing(
    label: np.ndarray, free: np.ndarray, z: np.ndarray, along: np.ndarray, gap: int
) -> Facing:
    """Count how surfaces face each other along the rows of a frame.

    Args:
        label: Surfaces ``(R, C)``, -1 = none.
        free: Whether each cell is free, ``(R, C)`` bool.
        z: Depths ``(R, C)`` int64 [depth units].
        along: Position along the row, ``(R, C)`` int64 [depth units].
        gap: Maximum difference of depths that agree [depth units]; cells between two surfaces are
            nearer if the difference exceeds half of the gap.

    Example:
        >>> label, z = np.array([[0, 0, 1, 2, 2]]), np.array([[900, 900, 700, 905, 905]])
        >>> found = facing(label, label < 0, z, z * 0, 40)
        >>> found.hidden[0, 2], found.agree[0, 2], found.places[0, 1]
        (np.int64(1), np.int64(1), np.int64(1))
    """
    count = int(label.max(initial=-1)) + 1
    out = Facing(*(np.zeros((count, count), np.int64) for _ in Facing._fields))
    start, end = _runs(label)
    if len(start) < 2:
        return out
    row, own = start // label.shape[1], label.ravel()[start]
    depth, place = z.ravel(), along.ravel()
    bounds = np.stack([start, end], axis=1).ravel()
    nearest, farthest = (f.reduceat(depth, bounds)[::2] for f in (np.minimum, np.maximum))
    nearest, farthest = np.minimum(nearest, depth[end]), np.maximum(farthest, depth[end])
    frees = np.append(0, np.cumsum(free))
    near, far = np.full(len(start), 1 << 40), np.full(len(start), -1)
    for away in range(1, min(MOST_BETWEEN + 2, len(start))):
        left, right = slice(0, -away), slice(away, None)
        between = [slice(k, k - away) for k in range(1, away)]
        near, far = near[: len(start) - away], far[: len(start) - away]
        if between:
            near, far = (
                np.minimum(near, nearest[between[-1]]),
                np.maximum(far, farthest[between[-1]]),
            )
        faces = (row[left] == row[right]) & (own[left] != own[right])
        for middle in between:
            faces &= (own[middle] != own[left]) & (own[middle] != own[right])
        last, first = end[left], start[right]
        step, apart = np.abs(depth[first] - depth[last]), np.abs(place[first] - place[last])
        low, high = np.minimum(depth[first], depth[last]), np.maximum(depth[first], depth[last])
        through = (frees[first] > frees[last + 1]) | (far > high + gap)
        hidden = ~through & (near < low - gap // 2)
        holes = ~through & ~hidden & (first > last + 1)
        agree = (hidden | holes) & (step <= gap + apart // SLOPE)
        counted = np.ones_like(step), through, hidden, holes, agree, np.where(through, 0, step)
        pair = np.sort(np.stack([own[left], own[right]]), axis=0)[:, faces]
        for total, value in zip(out, counted, strict=True):
            np.add.at(total, tuple(pair), value[faces])
    return out


def _runs(label: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the first and last cell of each run of one surface in a row, as flat indices."""
    beyond = np.full((len(label), 1), -2)
    before = np.concatenate([beyond, label[:, :-1]], axis=1)
    after = np.concatenate([label[:, 1:], beyond], axis=1)
    return np.flatnonzero((label >= 0) & (label != before)), np.flatnonzero(
        (label >= 0) & (label != after)
    )


def _contour_gaps(label: np.ndarray, view: View, count: int) -> np.ndarray:
    """Return the smallest distance between the contours of surfaces on the floor, ``(S, S)``."""
    if not count:
        return np.zeros((0, 0), np.int64)
    lines, used = contours(label, view.right, view.forward, count)
    points = np.concatenate([line[:n] for line, n in zip(lines, used, strict=True)])
    first, squared = np.cumsum(used) - used, np.zeros((count, count), np.int64)
    for number, line in enumerate(np.split(points.astype(np.int64), first[1:])):
        apart = ((line[:, None] - points) ** 2).sum(axis=-1).min(axis=0)
        squared[number] = np.minimum.reduceat(apart, first)
    # Integer square root: float64 is exact up to twice these lengths.
    return np.floor(np.sqrt(squared)).astype(np.int64)


def _extent_gaps(extent: Extents) -> tuple[np.ndarray, np.ndarray]:
    """Return the gaps between surfaces on the floor, sideways and forward, ``(S, S)`` each.

    A gap is negative if the surfaces overlap [depth units].
    """
    aside = np.maximum(extent.left, extent.left[:, None])
    aside = aside - np.minimum(extent.right, extent.right[:, None])
    ahead = np.maximum(extent.near, extent.near[:, None])
    ahead = ahead - np.minimum(extent.far, extent.far[:, None])
    return aside, ahead
