"""Obstacles from surfaces: what goes on behind nearer things, and the paper's gaps on the floor."""

from typing import NamedTuple

import numpy as np

from jaxdet.config import ObstacleConfig
from jaxdet.plane import SLOPE_BITS
from jaxdet.reference._components import components
from jaxdet.reference._outlines import contours, straight_parts
from jaxdet.reference._surfaces import renumbered

PERCENT = 100
TRIM = 20
"""Such a part of a surface's cells is passed over at each side when it is measured."""


class View(NamedTuple):
    """The cells of one frame, each ``(R, C)`` int64 [depth units]."""

    x: np.ndarray
    """To the right in the camera."""
    y: np.ndarray
    """Down in the camera."""
    z: np.ndarray
    """Forward in the camera, 0 = no measurement."""
    right: np.ndarray
    """On the floor."""
    forward: np.ndarray
    """On the floor."""
    height: np.ndarray
    """Above the floor."""
    in_view: np.ndarray
    """bool, at least partly in the colour image."""


class Extents(NamedTuple):
    """What is known of each surface, each ``(S,)`` int64: cells, or depth units."""

    cells: np.ndarray
    rows: np.ndarray
    """From the first to the last, both counted."""
    columns: np.ndarray
    left: np.ndarray
    """Smallest ``right``, but for a twentieth of the cells: silhouettes are smeared."""
    right: np.ndarray
    """Largest, likewise."""
    near: np.ndarray
    """Smallest ``forward``, likewise."""
    far: np.ndarray
    """Largest, likewise."""
    bottom: np.ndarray
    """Smallest height above the floor."""
    top: np.ndarray
    nearest: np.ndarray
    """Smallest z."""

    @property
    def width(self) -> np.ndarray:
        """Sideways."""
        return self.right - self.left

    @property
    def depth(self) -> np.ndarray:
        """Forward."""
        return self.far - self.near


def obstacles(
    label: np.ndarray,
    keep: np.ndarray,
    view: View,
    farthest: int,
    unit: float,
    config: ObstacleConfig,
) -> np.ndarray:
    """Groups the surfaces of a frame into obstacles.

    In this order, each step on what the one before has joined:

    1. parts of one surface on both sides of a nearer thing or of a hole (:func:`continued`);
    2. pieces too small to be an obstacle, with the surface they touch (:func:`_fragments`);
    3. narrow surfaces and what is at most a gap away on the floor, the paper's Eq. 6 on both axes
       at once (:func:`_across_gaps`);
    4. what hangs in the air, with what stands nearest to it (:func:`_hanging`).

    Last, what bends around free floor is split where it does (:func:`straight_parts`).

    Large surfaces stand on their own: a gap that one sees through parts them, however narrow.
    What is smaller than ``min_size_m``, shows fewer than ``min_cells`` cells in the colour image or
    begins beyond the range is no obstacle. Depth images often see more than the colour image: what
    is beside or above it helps to tell what belongs together.

    Args:
        label: ``(R, C)`` surfaces, -1 = none.
        keep: ``(R, C)`` bool, cells above the floor.
        view: Where the cells are.
        farthest: End of the range [depth units].
        unit: Metres in one depth unit.
        config: The gaps and sizes.

    Returns:
        ``(R, C)`` int64 obstacles in the order of their nearest z, then of their leftmost point,
        then of their first cell; -1 = none.
    """
    label = _joined(label, continued(label, keep, view, unit, config))
    for _ in range(2):
        label = _joined(label, _fragments(label, view, unit, config))
    label = _joined(label, _across_gaps(label, view, unit, config))
    label = _joined(label, _hanging(label, view, unit, config))
    label = _straightened(label, view, unit, config)
    return _ordered(label, view, farthest, unit, config)


def extents(label: np.ndarray, view: View) -> Extents:
    """The extents of the surfaces ``0 .. S - 1`` of a frame."""
    count = int(label.max(initial=-1)) + 1
    on = label >= 0
    index = label[on]
    rows, columns = np.nonzero(on)

    size = np.bincount(index, minlength=count)
    start = np.cumsum(size) - size

    def least(values: np.ndarray, trim: int = 0) -> np.ndarray:
        ordered = values[np.lexsort((values, index))]
        return ordered[start + (size // trim if trim else 0)]

    def most(values: np.ndarray, trim: int = 0) -> np.ndarray:
        return -least(-values, trim)

    return Extents(
        size,
        most(rows) - least(rows) + 1,
        most(columns) - least(columns) + 1,
        least(view.right[on], TRIM),
        most(view.right[on], TRIM),
        least(view.forward[on], TRIM),
        most(view.forward[on], TRIM),
        least(view.height[on]),
        most(view.height[on]),
        least(view.z[on]),
    )


def continued(
    label: np.ndarray, keep: np.ndarray, view: View, unit: float, config: ObstacleConfig
) -> np.ndarray:
    """Pairs of surfaces that go on in each other behind a nearer thing or across a hole.

    From the end of a surface in a row, the next surface that is not nearer by more than the gap is
    looked for. The two go on in each other there when their depths agree within ``depth_gap_m`` and
    the slope; between them may lie nearer surfaces (together at most ``hidden_m``) or cells without
    depth (at most ``hole_m``). Where floor or something farther is seen between them, one sees
    through: that row speaks against the pair. Columns are looked through in the same way, but only
    across holes: below a nearer thing stands another. A pair is joined when at least as many
    lines speak for it as against, and at least ``hidden_share`` of the smaller one's lines.

    Returns:
        ``(2, L)`` numbers of surfaces.
    """
    known = extents(label, view)
    pairs = []
    for across, aside, lines in ((True, view.x, known.rows), (False, view.y, known.columns)):
        flat = [a if across else a.T for a in (label, keep, view.z, aside)]
        found = _lines(*flat, hidden=across, unit=unit, config=config)
        for (one, two), (good, bad) in sorted(found.items()):
            least = round(PERCENT * config.hidden_share) * min(lines[one], lines[two])
            if good and good >= bad and PERCENT * good >= least:
                pairs.append((one, two))
    return np.array(pairs, np.int64).reshape(-1, 2).T


def _lines(
    label: np.ndarray,
    keep: np.ndarray,
    z: np.ndarray,
    aside: np.ndarray,
    *,
    hidden: bool,
    unit: float,
    config: ObstacleConfig,
) -> dict[tuple[int, int], list[int]]:
    """For each pair of surfaces, how many rows speak for and how many against their being one."""
    gap, slope = round(config.depth_gap_m / unit), round(config.depth_slope * (1 << SLOPE_BITS))
    reach, hole = (round(a / unit) for a in (config.hidden_m, config.hole_m))
    votes: dict[tuple[int, int], list[int]] = {}
    following = np.concatenate([label[:, 1:], np.full((len(label), 1), -1)], axis=1)
    for row, start in np.argwhere((label >= 0) & (label != following)).tolist():
        own, nearer, through = label[row, start], False, False
        for column in range(start + 1, label.shape[1]):
            there = label[row, column]
            if there == own:
                break
            if there < 0:
                through |= z[row, column] > 0 and not keep[row, column]
                continue
            away = abs(int(aside[row, column]) - int(aside[row, start]))
            slack = gap + (slope * away >> SLOPE_BITS)
            behind = int(z[row, column]) - int(z[row, start])
            if behind < -slack:
                nearer = True
            elif behind > slack:
                through = True
            else:
                near = away <= (reach if nearer else hole) and (hidden or not nearer)
                if column > start + 1 and (near or through):
                    pair = (min(own, there), max(own, there))
                    votes.setdefault(pair, [0, 0])[1 if through else 0] += 1
                break
    return votes


def _fragments(label: np.ndarray, view: View, unit: float, config: ObstacleConfig) -> np.ndarray:
    """Pieces smaller than ``min_size_m`` or thinner than three cells, each with a surface.

    It is the one that most of the piece's cells touch (the next cell or the one after it, in row
    or column) over a step of at most ``contact_m``.
    """
    known = extents(label, view)
    size = np.maximum(known.width, known.top - known.bottom)
    small = (size < round(config.min_size_m / unit)) | (np.minimum(known.rows, known.columns) < 3)
    pair, count = _contacts(label, view, round(config.contact_m / unit))
    both = np.concatenate([pair, pair[::-1]], axis=1)
    order = np.lexsort((both[1], -np.concatenate([count, count]), both[0]))
    piece, first = np.unique(both[0, order], return_index=True)
    return np.stack([piece, both[1, order][first]])[:, small[piece]]


def _contacts(label: np.ndarray, view: View, step: int) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of surfaces that touch over at most a step in depth, and in how many places."""
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


def _gaps(known: Extents) -> tuple[np.ndarray, np.ndarray]:
    """How far the surfaces are apart on the floor, sideways and forward, ``(S, S)``; 0: overlap."""
    aside = np.maximum(known.left, known.left[:, None]) - np.minimum(
        known.right, known.right[:, None]
    )
    ahead = np.maximum(known.near, known.near[:, None]) - np.minimum(known.far, known.far[:, None])
    return np.maximum(aside, 0), np.maximum(ahead, 0)


def _across_gaps(label: np.ndarray, view: View, unit: float, config: ObstacleConfig) -> np.ndarray:
    """Compact surfaces a gap apart on the floor, one of them narrow.

    The gap is at most ``lateral_gap_m`` sideways and ``forward_gap_m`` forward (Eq. 6), or
    ``overlap_gap_m`` in depth where the two touch in the image.
    """
    known = extents(label, view)
    narrow, compact, lateral, forward, touching = (
        round(a / unit)
        for a in (
            config.narrow_m,
            config.compact_m,
            config.lateral_gap_m,
            config.forward_gap_m,
            config.overlap_gap_m,
        )
    )
    aside, ahead = _gaps(known)
    near = (aside <= lateral) & (ahead <= forward)
    if touching:
        (one, two), count = _contacts(label, view, touching)
        near[one[count >= 3], two[count >= 3]] = True
    fits = (known.width <= compact) & (known.depth <= compact)
    near &= fits & fits[:, None]
    near &= np.minimum(known.width, known.width[:, None]) < narrow
    return np.stack(np.nonzero(np.triu(near, 1)))


def _hanging(label: np.ndarray, view: View, unit: float, config: ObstacleConfig) -> np.ndarray:
    """Compact surfaces that end in the air, each with the nearest one that reaches lower."""
    known = extents(label, view)
    high, compact, reach = (
        round(a / unit) for a in (config.hanging_m, config.compact_m, config.hanging_reach_m)
    )
    if not high:
        return np.zeros((2, 0), np.int64)
    aside, ahead = _gaps(known)
    distance = aside * aside + ahead * ahead
    distance[known.bottom >= known.bottom[:, None]] = 1 << 40
    hangs = (known.bottom >= high) & (2 * known.width <= compact)
    nearest = np.argmin(distance, axis=1) if len(distance) else np.zeros(0, np.int64)
    hangs &= distance.min(axis=1, initial=1 << 40) <= reach * reach
    return np.stack([np.flatnonzero(hangs), nearest[hangs]])


def _straightened(label: np.ndarray, view: View, unit: float, config: ObstacleConfig) -> np.ndarray:
    """Obstacles that bend around free floor, split between columns of cells."""
    bend, shortest = (round(a / unit) for a in (config.bend_m, config.side_m))
    if not bend:
        return label
    count = int(label.max(initial=-1)) + 1
    lines, used = contours(label, view.right, view.forward, count)
    out, free = label.copy(), count
    for number in range(count):
        own = label == number
        column = np.flatnonzero(own.any(axis=0))[: used[number]]
        line = lines[number, : used[number]]
        for start in straight_parts(line, bend, shortest, shortest)[1:]:
            out[own & (np.arange(label.shape[1]) >= column[start])] = free
            free += 1
    return renumbered(out)


def _joined(label: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """Surfaces with these pairs made one, numbered anew."""
    group = components(int(label.max(initial=-1)) + 1, *pairs)
    return renumbered(np.where(label >= 0, np.append(group, -1)[label], -1))


def _ordered(
    label: np.ndarray, view: View, farthest: int, unit: float, config: ObstacleConfig
) -> np.ndarray:
    """Obstacles by distance; what is too small or too far becomes -1."""
    known = extents(label, view)
    size = np.maximum(known.width, known.top - known.bottom)
    shown = np.bincount(label[(label >= 0) & view.in_view], minlength=len(size))
    good = (size >= round(config.min_size_m / unit)) & (shown >= config.min_cells)
    good &= known.nearest <= farthest
    leftmost = np.full(len(good), 1 << 40)
    on = label >= 0
    np.minimum.at(leftmost, label[on], view.x[on])
    order = np.lexsort((np.arange(len(good)), leftmost, known.nearest))
    order = order[good[order]]
    number = np.full(len(good) + 1, -1)
    number[order] = np.arange(len(order))
    return number[label]
