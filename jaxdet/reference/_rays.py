"""Rays: how far the floor is free along fixed bearings from the camera's foot."""

from typing import NamedTuple

import numpy as np

from jaxdet.floor.rays import (
    RATIO_BITS,
    RAY_BITS,
    TURN,
    TURN_BITS,
    UNITS,
    bearing_table,
    half_turn,
    ray_directions,
)
from jaxdet.types import RAYS, FreeEnd

END_BITS = 2  # of a range that what ends it is packed with
MOST_WIDER = 8  # times that a column is wider at its end than at its neighbour's
NONE = np.iinfo(np.int32).max  # no range


class Blocks(NamedTuple):
    """Measured points above the step, which no ray passes; each ``(N,)`` int64."""

    right: np.ndarray  # ground frame [depth units]
    forward: np.ndarray  # ground frame [depth units]
    depth: np.ndarray  # in the camera [depth units]


def rays(
    line: np.ndarray, end: np.ndarray, blocks: Blocks, obstacles: Blocks, half: int
) -> tuple[np.ndarray, np.ndarray]:
    """Free floor by column of cells and what stands on it, as a polar scan.

    A ray stands for the sector of bearings nearer to it than to its neighbours, and ends at the
    least range at which the floor ends anywhere in the sector. A column of a pitched camera is no
    ray: its bearing changes with range. So floor is free in the polygon between the near ends and
    the far ends of neighbouring columns that show floor, a ray goes as far as it stays in there,
    and nothing that is measured above the step is passed.

    A column is half as wide as it is far from its neighbours; between two, floor is as long as the
    shorter one as far as that is wide. Next to one that shows no floor it is half a cell wide.

    Args:
        line: ``(C, 2, 2)`` int32, of :func:`jaxdet.reference._free.free_floor`.
        end: ``(C,)`` int32, of the same.
        blocks: Points that no ray passes.
        obstacles: Of these, the nearest of an obstacle in each column that has one. Rays on which
            no floor is seen end at them.
        half: Half of a cell's angle in bearing units, with four fraction bits; the points are as
            wide as their cells.

    Returns:
        ``(RAYS, 2)`` int32, where free floor begins and ends [depth units], both the same where
        only something above the step is seen and zero where nothing is; and ``(RAYS,)`` int32,
        what ends it (:class:`jaxdet.types.FreeEnd`).
    """
    near, far = line.astype(np.int64).transpose(1, 0, 2)
    alone = (near == far).all(axis=1) & (end == FreeEnd.OBSTACLE)
    seen = line.any(axis=(1, 2)) & ~alone
    inside = _foot_inside(near, far, seen)

    start, (stop, block, only) = np.full(RAYS, -1), np.full((3, RAYS), NONE)
    turned = half_turn(half)
    for first, last, why in _far_edges(near, far, end, seen, turned):
        (sector, segment), length = _swept(first, last, least=True)
        np.minimum.at(stop, sector, _packed(length, why[segment]))
    for first, last in _near_edges(near, seen, turned):
        (sector, _), length = _swept(first, last, least=inside)
        if inside:
            np.minimum.at(stop, sector, _packed(length, int(FreeEnd.UNKNOWN)))
        else:
            np.maximum.at(start, sector, length)
    start = np.zeros_like(start) if inside else start

    for points, nearest in ((blocks, block), (obstacles, only)):
        sector, length = _covered(points, half)
        np.minimum.at(nearest, sector, length)
    block[block >= np.where((start >= 0) & (stop < NONE), stop >> END_BITS, 0)] = NONE
    stop = np.minimum(stop, np.where(block < NONE, _packed(block, int(FreeEnd.OBSTACLE)), NONE))
    length, block = stop >> END_BITS, np.minimum(block, only)
    free = (start >= 0) & (stop < NONE) & (start < length)
    only = ~free & (block < NONE)
    found = np.where(free[:, None], np.stack([start, length], axis=1), 0)
    found = np.where(only[:, None], block[:, None], found)
    why = np.where(free, (stop + 1) & 3, np.where(only, int(FreeEnd.OBSTACLE), 0))
    return found.astype(np.int32), why.astype(np.int32)


def bearings(right: np.ndarray, forward: np.ndarray) -> np.ndarray:
    """Bearings of places on the floor, clockwise from above, 0 ahead.

    Args:
        right: Integer [depth units], below 2^19.
        forward: The same.

    Returns:
        int64, sixteenths of the spacing of rays, above -``TURN`` / 2 to ``TURN`` / 2.

    Example:
        >>> bearings(np.array([0, 5, 5, -5]), np.array([7, 5, 0, 0])).tolist()
        [0, 2880, 5760, -5760]
    """
    aside, ahead = np.abs(right), np.abs(forward)
    low, high = np.minimum(aside, ahead), np.maximum(aside, ahead)
    angle = bearing_table()[(low << RATIO_BITS) // np.maximum(high, 1)]
    angle = np.where(aside <= ahead, angle, TURN // 4 - angle)
    angle = np.where(forward < 0, TURN // 2 - angle, angle)
    return np.where(right < 0, -angle, angle)


def _packed(length: np.ndarray, why: np.ndarray | int) -> np.ndarray:
    """Ranges with what ends them; of equal ranges an obstacle is least, then a drop."""
    return (length << END_BITS) | ((why - 1) & 3)


def _sector(bearing: np.ndarray) -> np.ndarray:
    """The sector of a bearing, counted on from 0 without an end."""
    return (bearing + TURN // 2 + UNITS // 2) >> (UNITS.bit_length() - 1)


def _ranges(points: np.ndarray, bearing: np.ndarray) -> np.ndarray:
    """The distance of points ``(n, 2)`` from the foot, along the ray of their sector."""
    way = ray_directions()[0][_sector(bearing) % RAYS]
    return np.abs((points * way).sum(axis=-1) + (1 << (RAY_BITS - 1))) >> RAY_BITS


def _foot_inside(near: np.ndarray, far: np.ndarray, seen: np.ndarray) -> bool:
    """Whether the camera sees floor on both sides of its own foot."""
    passes = seen & (near[:, 1] <= 0) & (far[:, 1] >= 0) & (far[:, 1] > near[:, 1])
    run = np.maximum(far[:, 1] - near[:, 1], 1)
    beside = near[:, 0] + (far[:, 0] - near[:, 0]) * -near[:, 1] // run
    both = passes[:-1] & passes[1:]
    return bool((both & (np.minimum(beside[:-1], beside[1:]) <= 0)
                 & (np.maximum(beside[:-1], beside[1:]) >= 0)).any())  # fmt: skip


def _turned(points: np.ndarray, turn: int) -> np.ndarray:
    """Points ``(n, 2)`` turned clockwise about the foot by a small angle, with ``TURN_BITS``."""
    return points + (points[:, ::-1] * np.array([turn, -turn]) >> TURN_BITS)


def _sides(seen: np.ndarray, turn: int) -> list[tuple[np.ndarray, int]]:
    """Columns next to one that shows no floor on their left, and on their right; and the turn."""
    before, after = np.append(False, seen[:-1]), np.append(seen[1:], False)
    return [(np.flatnonzero(seen & ~before), -turn), (np.flatnonzero(seen & ~after), turn)]


def _near_edges(
    near: np.ndarray, seen: np.ndarray, turn: int
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Where floor begins: segments from one point to another, ``(n, 2)`` each."""
    both = np.flatnonzero(seen[:-1] & seen[1:])
    ends = [(near[c], _turned(near[c], by)) for c, by in _sides(seen, turn)]
    return [(near[both], near[both + 1]), *ends]


def _far_edges(
    near: np.ndarray, far: np.ndarray, end: np.ndarray, seen: np.ndarray, turn: int
) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Where floor ends: segments from one point to another ``(n, 2)``, and why ``(n,)``.

    From the end of the shorter of two columns halfway to the longer one, along there, and on to the
    end of the longer one. What is hidden by an obstacle is not known.
    """
    left = np.flatnonzero(seen[:-1] & seen[1:])
    nearer = far[left, 1] <= far[left + 1, 1]
    short, long = np.where(nearer, left, left + 1), np.where(nearer, left + 1, left)
    run = far[long, 1] - near[long, 1]
    part = np.clip(far[short, 1] - near[long, 1], 0, np.maximum(run, 0))
    beside = near[long] + (far[long] - near[long]) * part[:, None] // np.maximum(run, 1)[:, None]
    middle = (far[short] + beside) >> 1
    ahead, behind = beside[:, 1], far[long, 1]
    wider = (ahead > 0) & (behind > ahead)
    times = np.where(wider, np.minimum(behind, MOST_WIDER * ahead), 1)[:, None]
    last = far[long] + (middle - beside) * times // np.where(wider, ahead, 1)[:, None]
    why = end.astype(np.int64)
    hidden = np.where(why == FreeEnd.OBSTACLE, int(FreeEnd.UNKNOWN), why)
    edges = [
        (far[short], middle, why[short]),
        (middle, last, hidden[short]),
        (last, far[long], why[long]),
    ]
    for c, by in _sides(seen, turn):
        begin, stop = _turned(near[c], by), _turned(far[c], by)
        edges += [(far[c], stop, why[c]), (stop, begin, np.full(len(c), int(FreeEnd.UNKNOWN)))]
    return edges


def _swept(
    first: np.ndarray, last: np.ndarray, least: bool
) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray]:
    """The sectors that segments pass, and their least or largest range in each.

    Args:
        first: ``(n, 2)`` one end of each segment.
        last: ``(n, 2)`` the other.
        least: Whether the least is returned.

    Returns:
        Sector and segment, ``(k,)`` each, and the range ``(k,)``, where a segment crosses the
        sector's edges or has its ends.
    """
    at, to = (bearings(p[:, 0], p[:, 1]) for p in (first, last))
    turn = (to - at + TURN // 2) % TURN - TURN // 2
    back = turn < 0
    low = np.where(back, to, at)
    range_first, range_last = _ranges(first, at), _ranges(last, to)
    ends = np.where(back, [range_last, range_first], [range_first, range_last])
    begin, stop = _sector(low), _sector(low + np.abs(turn))
    count = stop - begin + 1
    segment = np.repeat(np.arange(len(first)), count)
    sector = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count) + begin[segment]

    way = last - first
    area = np.abs(first[:, 0] * way[:, 1] - first[:, 1] * way[:, 0])[segment]
    lowest, highest = (f(range_first, range_last)[segment] for f in (np.minimum, np.maximum))

    def crossing(edge: np.ndarray) -> np.ndarray:
        across = ray_directions()[1][edge % RAYS]
        over = np.abs(across[:, 0] * way[segment, 1] - across[:, 1] * way[segment, 0])
        return np.clip((area << RAY_BITS) // np.maximum(over, 1), lowest, highest)

    left = np.where(sector == begin[segment], ends[0][segment], crossing(sector))
    right = np.where(sector == stop[segment], ends[1][segment], crossing(sector + 1))
    length = np.minimum(left, right) if least else np.maximum(left, right)
    return (sector % RAYS, segment), length


def _covered(blocks: Blocks, half: int) -> tuple[np.ndarray, np.ndarray]:
    """The sectors that points as wide as a cell are in, and their range, ``(k,)`` each."""
    bearing = bearings(blocks.right, blocks.forward)
    place = np.stack([blocks.right, blocks.forward], axis=-1)
    length = np.maximum(_ranges(place, bearing), 1)
    wide = np.minimum(blocks.depth * half // (length << 4) + 1, TURN // 2 - UNITS)
    begin = _sector(bearing - wide)
    count = _sector(bearing + wide) - begin + 1
    point = np.repeat(np.arange(len(count)), count)
    sector = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count) + begin[point]
    return sector % RAYS, length[point]
