"""Rays: free floor along fixed bearings from the ground projection of the camera (its foot)."""

from typing import NamedTuple

import numpy as np

from jaxdet.camera import RAY_BITS as CELL_BITS
from jaxdet.config import GroundConfig
from jaxdet.floor.frame import CAMERA_HEIGHT, FRAME_BITS, IS_KNOWN, UNKNOWN_HEIGHT
from jaxdet.floor.plane import depth_range, max_height
from jaxdet.floor.rays import (
    RATIO_BITS,
    RAY_BITS,
    TILE,
    TURN,
    TURN_BITS,
    UNITS,
    bearing_table,
    block_settings,
    ray_directions,
    tile_corners,
)
from jaxdet.types import RAYS, FreeEnd

END_BITS = 2  # number of bits of the reason of an end, packed below its range
MOST_WIDER = 8  # maximum ratio of a column's width at its end and at its neighbour's end
NONE = np.iinfo(np.int32).max  # no range
CORNER_BITS = 12  # fraction bits of the positions of tiles' corners, for their bearings
# maximum range of bearings of a tile; a wider tile may contain the foot, and blocks all rays
WIDEST = TURN // 4
RAMP_START, RAMP_SLOPE = 11, 12  # indices of a floor frame
F32 = np.float32


class Standing(NamedTuple):
    """Cells and pixels of a frame that may end rays; each ``(R, C)``."""

    pixel: np.ndarray
    """Nearest pixel of each cell [depth units], 0 = none."""
    z: np.ndarray
    """Depth of each cell [depth units], 0 = none."""
    is_cell: np.ndarray
    """Whether the cell belongs to an obstacle or is above the step height, bool."""


def rays(
    line: np.ndarray, end: np.ndarray, block: np.ndarray, turned: int
) -> tuple[np.ndarray, np.ndarray]:
    """Compute the free floor as a polar scan, from columns of cells and from obstacles.

    A ray represents the sector of bearings nearer to it than to its neighbours, and ends at the
    smallest range at which the floor ends anywhere in the sector. A column of a pitched camera is
    not a ray: its bearing changes with range. So the free floor is the polygon between the near
    ends and the far ends of neighbouring columns that show floor; a ray extends as far as it stays
    inside the polygon, but not beyond anything measured above the step height.

    A column extends sideways halfway to its neighbours, so the floor between two columns ends with
    the shorter one on that column's half, and with the longer one on the other half. Next to a
    column without floor, a column extends by half a cell.

    Args:
        line: Start and end of the floor in each column, ``(C, 2, 2)`` int32, from
            :func:`jaxdet.reference._free.free_floor`.
        end: Kind of end of each column, ``(C,)`` int32.
        block: Range of the nearest obstacle on each ray, from :func:`blocks`.
        turned: Half of a cell's angle, from :func:`jaxdet.floor.rays.half_turn`.

    Returns:
        Ranges at which free floor begins and ends, ``(RAYS, 2)`` int32 [depth units], and the kind
        of its end, ``(RAYS,)`` int32 (:class:`jaxdet.types.FreeEnd`). If no floor but an obstacle
        is visible, both ranges are that of the nearest obstacle; if nothing is visible, they are 0.
    """
    near, far = line.astype(np.int64).transpose(1, 0, 2)
    alone = (near == far).all(axis=1) & (end == FreeEnd.OBSTACLE)
    seen = line.any(axis=(1, 2)) & ~alone
    inside = _foot_inside(near, far, seen)

    start, stop = np.full(RAYS, -1), np.full(RAYS, NONE)
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

    blocks_floor = block < np.where((start >= 0) & (stop < NONE), stop >> END_BITS, 0)
    stop = np.where(blocks_floor, np.minimum(stop, _packed(block, int(FreeEnd.OBSTACLE))), stop)
    length = stop >> END_BITS
    free = (start >= 0) & (stop < NONE) & (start < length)
    stands = ~free & (block < NONE)
    found = np.where(free[:, None], np.stack([start, length], axis=1), 0)
    found = np.where(stands[:, None], block[:, None], found)
    why = np.where(free, (stop + 1) & 3, np.where(stands, int(FreeEnd.OBSTACLE), 0))
    return found.astype(np.int32), why.astype(np.int32)


def blocks(
    standing: Standing,
    frame: np.ndarray,
    cells: np.ndarray,
    ground: GroundConfig,
    depth_unit: float,
) -> np.ndarray:
    """Compute the range of the nearest obstacle on each ray, from the nearest pixels of cells.

    A cell of an obstacle or above the step height contributes its nearest pixel, or its own depth
    if that pixel is nearer than the depth range. Another cell contributes its nearest pixel if that
    is above the step height of a single pixel, which has more noise than a cell. A tile consists of
    some cells of a column; its nearest point blocks all sectors that the tile covers. The
    arithmetic is float32, and each operation is rounded separately.

    Args:
        standing: Cells of a frame.
        frame: Floor frame ``(13,)`` int32, from :func:`jaxdet.floor.frame.floor_frames`.
        cells: Rays through the centres of cells, ``(2, R, C)``, from
            :func:`jaxdet.camera.cell_rays`.
        ground: Depth range, step height and maximum height.
        depth_unit: Metres per depth unit.

    Returns:
        Ranges ``(RAYS,)`` int64 [depth units], ``NONE`` without an obstacle.
    """
    least = _least_in_tiles(_squares(standing, frame, cells, ground, depth_unit))
    right, forward, _ = _directions(frame, tile_corners(cells)) * F32(1 << CORNER_BITS)
    corner = bearings(right.astype(np.int64), forward.astype(np.int64))
    around = np.stack([corner[:-1, :-1], corner[:-1, 1:], corner[1:, :-1], corner[1:, 1:]])
    turn = (around - around[0] + TURN // 2) % TURN - TURN // 2
    left, right = turn.min(axis=0), turn.max(axis=0)
    wide = right - left > WIDEST
    begin = np.where(wide, 0, _sector(around[0] + left))
    count = np.where(wide, RAYS, _sector(around[0] + right) - begin + 1)[np.isfinite(least)]
    tile, sector = _counted(count)
    nearest = np.full(RAYS, np.inf, F32)
    at = (sector + begin[np.isfinite(least)][tile]) % RAYS
    np.minimum.at(nearest, at, least[np.isfinite(least)][tile])
    stands = np.isfinite(nearest)
    length = np.sqrt(np.where(stands, nearest, F32(0))).astype(np.int64)
    return np.where(stands, np.maximum(length, 1), NONE)


def _directions(frame: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Return right, forward and down ``(3, ...)`` float32 of rays whose depth is 1."""
    x, y = cells.astype(F32) * F32(2.0**-CELL_BITS)
    axes = frame[:9].astype(F32).reshape(3, 3) * F32(2.0**-FRAME_BITS)
    return np.stack([a * x + b * y + c for a, b, c in axes])


def _squares(
    standing: Standing,
    frame: np.ndarray,
    cells: np.ndarray,
    ground: GroundConfig,
    depth_unit: float,
) -> np.ndarray:
    """Return the squared range of the obstacle in each cell, ``(R, C)``, inf if there is none."""
    pixel, z, is_cell = standing
    nearest, farthest = depth_range(ground.min_depth_m, ground.max_depth_m, depth_unit)
    depth = np.where(is_cell & (pixel < nearest), z, pixel).astype(F32)
    right, forward, down = _directions(frame, cells)
    height, start = F32(frame[CAMERA_HEIGHT]), F32(frame[RAMP_START])
    slope = F32(frame[RAMP_SLOPE]) * F32(2.0**-FRAME_BITS)
    above = height - down * depth - np.maximum(forward * depth - start, F32(0)) * slope
    top = F32(max_height(ground, depth_unit))
    if not frame[IS_KNOWN]:
        above, top = np.full_like(above, UNKNOWN_HEIGHT), F32(UNKNOWN_HEIGHT)
    step, growth, noise = block_settings(ground, depth_unit)
    rise = np.maximum(step + growth * depth, noise * max(height, F32(0)) * depth)
    in_range = (pixel >= nearest) & (pixel <= farthest)
    stands = is_cell | (in_range & (above > rise) & (above <= top))
    return np.where(stands, (right * right + forward * forward) * (depth * depth), F32(np.inf))


def _least_in_tiles(squares: np.ndarray) -> np.ndarray:
    """Return the smallest squared range in each tile, ``(T, C)``."""
    rows, columns = squares.shape
    padded = np.pad(squares, ((0, -rows % TILE), (0, 0)), constant_values=np.inf)
    return padded.reshape(-1, TILE, columns).min(axis=1)


def bearings(right: np.ndarray, forward: np.ndarray) -> np.ndarray:
    """Compute the bearings of points on the floor, clockwise from above, 0 ahead.

    Args:
        right: Position to the right, integer [depth units], below 2^19.
        forward: Position forward, as ``right``.

    Returns:
        Bearings, int64, in sixteenths of the spacing of rays; greater than -``TURN`` / 2, and at
        most ``TURN`` / 2.

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
    """Pack ranges with kinds of end; of equal ranges an obstacle is smallest, then a drop."""
    return (length << END_BITS) | ((why - 1) & 3)


def _sector(bearing: np.ndarray) -> np.ndarray:
    """Return the sector of a bearing, from 0, not wrapped."""
    return (bearing + TURN // 2 + UNITS // 2) >> (UNITS.bit_length() - 1)


def _counted(count: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return each index repeated by its count, and numbers from 0 for each index.

    Example:
        >>> [a.tolist() for a in _counted(np.array([2, 0, 3]))]
        [[0, 0, 2, 2, 2], [0, 1, 0, 1, 2]]
    """
    which = np.repeat(np.arange(len(count)), count)
    return which, np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)


def _ranges(points: np.ndarray, bearing: np.ndarray) -> np.ndarray:
    """Return the distance of points ``(n, 2)`` from the foot, along the ray of their sector.

    The foot is the ground projection of the camera.
    """
    way = ray_directions()[0][_sector(bearing) % RAYS]
    return np.abs((points * way).sum(axis=-1) + (1 << (RAY_BITS - 1))) >> RAY_BITS


def _foot_inside(near: np.ndarray, far: np.ndarray, seen: np.ndarray) -> bool:
    """Return whether the camera sees floor on both sides of its foot."""
    passes = seen & (near[:, 1] <= 0) & (far[:, 1] >= 0) & (far[:, 1] > near[:, 1])
    run = np.maximum(far[:, 1] - near[:, 1], 1)
    crossing = near[:, 0] + (far[:, 0] - near[:, 0]) * -near[:, 1] // run
    both = passes[:-1] & passes[1:]
    return bool((both & (np.minimum(crossing[:-1], crossing[1:]) <= 0)
                 & (np.maximum(crossing[:-1], crossing[1:]) >= 0)).any())  # fmt: skip


def _turned(points: np.ndarray, turn: int) -> np.ndarray:
    """Rotate points ``(n, 2)`` clockwise about the foot by a small angle.

    Args:
        points: Points on the floor.
        turn: Angle [rad] with ``TURN_BITS`` fraction bits.
    """
    return points + (points[:, ::-1] * np.array([turn, -turn]) >> TURN_BITS)


def _sides(seen: np.ndarray, turn: int) -> list[tuple[np.ndarray, int]]:
    """Return the columns at the left ends and those at the right ends of visible floor.

    Both come with the angle from the middle of a column to its outer side, as in :func:`_turned`.
    """
    before, after = np.append(False, seen[:-1]), np.append(seen[1:], False)
    return [(np.flatnonzero(seen & ~before), -turn), (np.flatnonzero(seen & ~after), turn)]


def _near_edges(
    near: np.ndarray, seen: np.ndarray, turn: int
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the segments where floor begins, as arrays of their two ends, ``(n, 2)`` each."""
    both = np.flatnonzero(seen[:-1] & seen[1:])
    ends = [(near[c], _turned(near[c], by)) for c, by in _sides(seen, turn)]
    return [(near[both], near[both + 1]), *ends]


def _far_edges(
    near: np.ndarray, far: np.ndarray, end: np.ndarray, seen: np.ndarray, turn: int
) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Return the segments where floor ends, and the reason for each.

    There are three segments between the ends of two neighbouring columns. The first leads from the
    end of the shorter column halfway to the longer one, at the same forward distance. The second
    follows the longer column to its end, still halfway between the two. The third leads to the end
    of the longer column. If the shorter column ends at an obstacle, the obstacle hides the floor
    next to the second segment, so its reason is unknown.

    Returns:
        Groups of segments: their two ends, ``(n, 2)`` each, and their reasons, ``(n,)``.
    """
    left = np.flatnonzero(seen[:-1] & seen[1:])
    nearer = far[left, 1] <= far[left + 1, 1]
    short, long = np.where(nearer, left, left + 1), np.where(nearer, left + 1, left)
    run = far[long, 1] - near[long, 1]
    part = np.clip(far[short, 1] - near[long, 1], 0, np.maximum(run, 0))
    abreast = near[long] + (far[long] - near[long]) * part[:, None] // np.maximum(run, 1)[:, None]
    middle = (far[short] + abreast) >> 1
    ahead, behind = abreast[:, 1], far[long, 1]
    wider = (ahead > 0) & (behind > ahead)
    times = np.where(wider, np.minimum(behind, MOST_WIDER * ahead), 1)[:, None]
    last = far[long] + (middle - abreast) * times // np.where(wider, ahead, 1)[:, None]
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
    """Return the sectors that segments cross, and the range of each segment in each of them.

    Args:
        first: First end of each segment, ``(n, 2)``.
        last: Other end, ``(n, 2)``.
        least: Whether the smallest range is returned, otherwise the largest.

    Returns:
        Indices of sector and segment, ``(k,)`` each; and the smallest or the largest range ``(k,)``
        of the points where the segment crosses the edges of the sector or ends in it.
    """
    at, to = (bearings(p[:, 0], p[:, 1]) for p in (first, last))
    turn = (to - at + TURN // 2) % TURN - TURN // 2
    back = turn < 0
    low = np.where(back, to, at)
    range_first, range_last = _ranges(first, at), _ranges(last, to)
    ends = np.where(back, [range_last, range_first], [range_first, range_last])
    begin, stop = _sector(low), _sector(low + np.abs(turn))
    count = stop - begin + 1
    segment, number = _counted(count)
    sector = number + begin[segment]

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
