"""Free floor: how far the floor is seen in each direction, and what ends it."""

from typing import NamedTuple

import numpy as np

from jaxdet.types import FreeEnd

RUN = 3  # so many measured cells one after the other, all a drop lower than the last floor

BESIDE = 14  # columns on both sides of one that drops, more than half of which must drop too
SHARE = 5  # no floor farther up may be nearer than what lies lower by more than this part of it


class FloorView(NamedTuple):
    """One frame's cells as the search for free floor sees them, each ``(R, C)``."""

    label: np.ndarray  # obstacles, -1 = none
    low: np.ndarray  # bool, measured, in range or beyond, and no higher than the step
    floor: np.ndarray  # bool, of these, those near enough to the plane to be floor
    right: np.ndarray  # ground frame [depth units]
    forward: np.ndarray  # ground frame [depth units]
    height: np.ndarray  # above the plane [depth units]
    drop: np.ndarray
    """How much lower than the floor before it the floor behind an edge lies [depth units]."""


def floor_ahead(
    view: FloorView, down: np.ndarray, far: int, longest_gap: int
) -> tuple[np.ndarray, np.ndarray]:
    """:func:`free_floor` of a camera that is mounted in any way.

    Of one that is upside down (rolled by 135 degrees or more) the cells are turned by half, so that
    columns go from left to right and outward is up; of one on its side (45 degrees or more)
    columns don't lead away from it, and nothing is said.

    Args:
        view: The cells.
        down: ``(3,)`` int, down in the colour camera, of :func:`jaxdet.floor.frame.floor_frames`.
        far: As for :func:`free_floor`.
        longest_gap: Likewise.
    """
    if abs(int(down[0])) > abs(int(down[1])):
        columns = view.label.shape[1]
        return np.zeros((columns, 2, 2), np.int32), np.zeros(columns, np.int32)
    if is_upside_down(down):
        view = FloorView(*(a[::-1, ::-1] for a in view))
    return free_floor(view, far, longest_gap)


def is_upside_down(down: np.ndarray) -> bool:
    """Whether the image's columns go from right to left, ``(3,)`` int as :func:`floor_ahead`'s."""
    return int(down[1]) < 0


def free_floor(view: FloorView, far: int, longest_gap: int) -> tuple[np.ndarray, np.ndarray]:
    """Follows the floor in each column of cells, from the robot outward.

    From the nearest floor cell on, the floor goes on while the next one is at most ``longest_gap``
    farther and no obstacle of the column is nearer. It is ended by

    - a drop, where ``RUN`` measured cells one after the other lie lower than the last floor cell by
      a drop at once, and flat, and no floor goes on at its level. Stereo cameras bow far floor
      down, but slowly; reflections in a glossy floor lie below it too, but floor goes on beyond
      them, nearer than they seem to be (through floor nothing is seen), or they stand upright, and
      they are narrow: of a column and its ``BESIDE`` neighbours on both sides more than half must
      drop;
    - an obstacle, where the column's nearest one is at most ``longest_gap`` farther;
    - the end of the range, at most ``longest_gap`` farther;
    - else by what is not known.

    Args:
        view: The cells.
        far: End of the range [depth units].
        longest_gap: [depth units].

    Returns:
        ``(C, 2, 2)`` int32, where the floor begins and where it ends, right and forward in the
        ground frame [depth units], both the same where only an obstacle is seen and zero where
        nothing is; and ``(C,)`` int32, what ends it (:class:`jaxdet.types.FreeEnd`). Distances are
        compared forward.
    """
    columns = view.label.shape[1]
    line, end = np.zeros((columns, 2, 2), np.int32), np.zeros(columns, np.int32)
    place = np.stack([view.right, view.forward], axis=-1)
    for column in range(columns):
        blocked = np.flatnonzero(view.label[:, column] >= 0)
        nearest = blocked[np.argmin(view.forward[blocked, column])] if len(blocked) else -1
        limit = view.forward[nearest, column] if len(blocked) else far
        floor = np.flatnonzero(view.floor[:, column] & (view.forward[:, column] < limit))[::-1]
        if not len(floor):
            if len(blocked):
                line[column] = place[nearest, column]
                end[column] = FreeEnd.OBSTACLE
            continue
        last, drops = _followed(view, column, floor, longest_gap)
        line[column] = place[floor[0], column], place[last, column]
        close = limit - view.forward[last, column] <= longest_gap
        if drops:
            end[column] = FreeEnd.DROP
        elif close and len(blocked):
            end[column] = FreeEnd.OBSTACLE
            line[column, 1] = place[nearest, column]
        elif close:
            end[column] = FreeEnd.RANGE
    drops = (end == FreeEnd.DROP).astype(np.int64)
    beside = np.convolve(drops, np.ones(2 * BESIDE + 1, np.int64))[BESIDE : BESIDE + columns]
    end[(drops > 0) & (beside <= BESIDE)] = FreeEnd.UNKNOWN
    return line, end


def _followed(view: FloorView, column: int, floor: np.ndarray, gap: int) -> tuple[int, bool]:
    """The last row of the floor that begins at ``floor[0]``, and whether it drops there."""
    last = int(floor[0])
    for row in floor[1:].tolist():
        if view.forward[row, column] - view.forward[last, column] > gap:
            break
        if view.height[last, column] - view.height[row, column] <= view.drop[row, column]:
            last = row
        elif _drops(view, column, last):
            break
    return last, _drops(view, column, last)


def _drops(view: FloorView, column: int, last: int) -> bool:
    """Whether the next ``RUN`` measured cells up a column are a drop lower, and lie flat.

    They don't where floor farther up is clearly nearer than they are.
    """
    height, forward, drop, low, label = (
        a[:last, column][::-1] for a in (view.height, view.forward, view.drop, view.low, view.label)
    )
    row = np.flatnonzero(low | (label >= 0))[:RUN]
    if len(row) < RUN or (label[row] >= 0).any():
        return False
    deep = view.height[last, column] - height > drop
    flat = np.abs(np.diff(height[row])) < np.abs(np.diff(forward[row]))
    if not (deep[row].all() and flat.all()):
        return False
    beyond = slice(row[-1] + 1, None)
    floor = forward[beyond][low[beyond] & ~deep[beyond]]
    return not (SHARE * floor < (SHARE - 1) * forward[row].min()).any()
