"""Grouping of surfaces into obstacles, by the evidence that they belong to the same object."""

import numpy as np

from jaxdet.affinity import affinity, evidence
from jaxdet.config import ObstacleConfig
from jaxdet.reference._components import components
from jaxdet.reference._evidence import pairs
from jaxdet.reference._outlines import contours, straight_parts
from jaxdet.reference._surfaces import renumbered
from jaxdet.reference._view import View, extents
from jaxdet.types import MAX_LABELS


def obstacles(
    label: np.ndarray,
    free: np.ndarray,
    view: View,
    farthest: int,
    unit: float,
    config: ObstacleConfig,
) -> np.ndarray:
    """Group the surfaces of a frame into obstacles.

    1. Surfaces too small to be an obstacle are merged into one they touch (:func:`whole_surfaces`).
    2. Each pair of surfaces at most a gap apart on the floor (Eq. 6) has evidence for or against
       belonging to the same object (:func:`jaxdet.reference._evidence.pairs`,
       :mod:`jaxdet.affinity`).
    3. Groups of surfaces are merged while the sum of the evidence between them is positive
       (:func:`contracted`).
    4. Groups that bend around free floor are split at the bends (:func:`straight_parts`).

    Groups that are smaller than ``min_size_m``, have fewer than ``min_cells`` cells or begin beyond
    the range are removed. Cells outside the colour image are used too, as they help to decide what
    belongs together.

    Args:
        label: Surfaces ``(R, C)``, -1 = none.
        free: Whether each cell is free, ``(R, C)`` bool: floor, or beyond the range.
        view: Positions of the cells.
        farthest: End of the range [depth units].
        unit: Metres in one depth unit.
        config: The gaps and sizes.

    Returns:
        Obstacles ``(R, C)`` int64, in the order of their nearest z, then of their leftmost point,
        then of their first cell; -1 = none.
    """
    label = whole_surfaces(label, view, unit, config)
    found = pairs(label, free, view, unit, config)
    weight = evidence(found.features, affinity(config.affinity, unit))
    group = contracted(int(label.max(initial=-1)) + 1, found.one, found.other, weight)
    label = _regrouped(label, group)
    label = _straightened(label, view, unit, config)
    return _ordered(label, view, farthest, unit, config)


def contracted(count: int, one: np.ndarray, other: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Partition a graph with positive and negative weights: correlation clustering.

    Greedy additive edge contraction: the two nodes with the largest weight between them are merged
    and their weights to each other node are summed, until no weight is positive. So the sum of many
    weak negative weights can outweigh one link. Keuper et al., *Efficient decomposition of image
    and mesh graphs by lifted multicuts*, ICCV 2015, algorithm 1.

    Args:
        count: Number of nodes.
        one: First node of each link, ``(P,)`` integer.
        other: Second node of each link, ``(P,)`` integer.
        weight: Weights ``(P,)`` integer. Ties are resolved in favour of the smallest nodes.

    Returns:
        Smallest node of each node's group, ``(count,)`` int64.

    Example:
        >>> contracted(3, np.array([0, 1, 0]), np.array([1, 2, 2]), np.array([5, 4, -3])).tolist()
        [0, 0, 0]
        >>> contracted(3, np.array([0, 1, 0]), np.array([1, 2, 2]), np.array([5, 4, -4])).tolist()
        [0, 0, 2]
    """
    group, between = np.arange(count), np.zeros((count, count), np.int64)
    between[one, other] = between[other, one] = weight
    while count and between.max() > 0:
        kept, gone = np.unravel_index(np.argmax(between), between.shape)
        between[kept] += between[gone]
        between[:, kept] += between[:, gone]
        between[kept, kept] = between[gone] = between[:, gone] = 0
        group[group == gone] = kept
    return group


def whole_surfaces(
    label: np.ndarray, view: View, unit: float, config: ObstacleConfig
) -> np.ndarray:
    """Merge surfaces smaller than ``min_size_m`` or thinner than three cells into others.

    Each is merged into the surface that most of its cells touch (in the next cell or the one after
    it, in a row or column) with a depth step of at most ``contact_m``.

    Returns:
        Renumbered surfaces ``(R, C)`` int64.
    """
    extent = extents(label, view)
    size = np.maximum(extent.width, extent.top - extent.bottom)
    small = (size < round(config.min_size_m / unit)) | (np.minimum(extent.rows, extent.columns) < 3)
    pair, count = _contacts(label, view, round(config.contact_m / unit))
    both = np.concatenate([pair, pair[::-1]], axis=1)
    order = np.lexsort((both[1], -np.concatenate([count, count]), both[0]))
    piece, first = np.unique(both[0, order], return_index=True)
    joins = np.stack([piece, both[1, order][first]])[:, small[piece]]
    group = components(len(small), *joins)
    return _regrouped(label, group)


def _regrouped(label: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Replace labels by their group ``(S,)`` and renumber them; -1 stays."""
    return renumbered(np.append(group, -1)[label])


def _contacts(label: np.ndarray, view: View, step: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the pairs of surfaces in contact, and the number of contacts of each pair.

    Cells are in contact if their depths differ by at most ``step`` [depth units].
    """
    found = []
    for axis in (0, 1):
        for away in (1, 2):
            size = label.shape[axis] - away
            a, b = (np.take(label, np.arange(size) + k, axis) for k in (0, away))
            za, zb = (np.take(view.z, np.arange(size) + k, axis) for k in (0, away))
            touch = (a >= 0) & (b >= 0) & (a != b) & (np.abs(za - zb) <= step)
            found.append(np.sort(np.stack([a[touch], b[touch]]), axis=0))
    pair, count = np.unique(np.concatenate(found, axis=1), axis=1, return_counts=True)
    return pair.astype(np.int64), count


def _straightened(label: np.ndarray, view: View, unit: float, config: ObstacleConfig) -> np.ndarray:
    """Split obstacles that bend around free floor, between columns of cells.

    There are at most ``MAX_LABELS`` parts.
    """
    bend, shortest = (round(a / unit) for a in (config.bend_m, config.side_m))
    if not bend:
        return label
    count = int(label.max(initial=-1)) + 1
    lines, used = contours(label, view.right, view.forward, count)
    out, free = label.copy(), count
    for number in range(count):
        own = label == number
        column = np.flatnonzero(own.any(axis=0))
        line = lines[number, : used[number]]
        for start in straight_parts(line, bend, shortest, shortest)[1:]:
            if free == MAX_LABELS:
                break
            out[own & (np.arange(label.shape[1]) >= column[start])] = free
            free += 1
    return renumbered(out)


def _ordered(
    label: np.ndarray, view: View, farthest: int, unit: float, config: ObstacleConfig
) -> np.ndarray:
    """Renumber obstacles by distance; the label of those too small or too far away becomes -1."""
    extent = extents(label, view)
    size = np.maximum(extent.width, extent.top - extent.bottom)
    good = (size >= round(config.min_size_m / unit)) & (extent.cells >= config.min_cells)
    good &= extent.nearest <= farthest
    leftmost = np.full(len(good), 1 << 40)
    on = label >= 0
    np.minimum.at(leftmost, label[on], view.x[on])
    order = np.lexsort((np.arange(len(good)), leftmost, extent.nearest))
    order = order[good[order]]
    number = np.full(len(good) + 1, -1)
    number[order] = np.arange(len(order))
    return number[label]
