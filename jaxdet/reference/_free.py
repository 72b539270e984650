"""Free floor: visible extent of the floor in each column of cells, and what ends it."""

from typing import NamedTuple

import numpy as np

from jaxdet.types import FreeEnd

RUN = 3  # number of cells behind the edge of a drop that must be measured and lower
NEIGHBOURS = 14  # columns on each side of a column; more than half of all these must drop
SHARE = 5
"""Cells are no drop if floor farther up the column is nearer than they are by more than 1/SHARE of
their distance."""


class FloorView(NamedTuple):
    """Cells of one frame for the search for free floor, each ``(R, C)``."""

    label: np.ndarray  # obstacles, -1 = none
    low: np.ndarray  # bool, measured, in range or beyond, and not above the step height
    floor: np.ndarray  # bool, ``low`` and close enough to the plane to be floor
    right: np.ndarray  # ground frame [depth units]
    forward: np.ndarray  # ground frame [depth units]
    height: np.ndarray  # above the plane [depth units]
    drop: np.ndarray
    """Minimum height of a step down to floor behind an edge [depth units]."""


def floor_ahead(
    view: FloorView, down: np.ndarray, far: int, longest_gap: int
) -> tuple[np.ndarray, np.ndarray]:
    """Compute :func:`free_floor` for any mounting of the camera.

    If the camera is upside down (rolled by 135 degrees or more), the cells are rotated by half a
    turn, so that columns go from left to right and outward is up. If it is on its side (45 degrees
    or more), columns do not lead away from it, and the result is unknown.

    Args:
        view: The cells.
        down: Down vector ``(3,)`` int in the colour camera, from
            :func:`jaxdet.floor.frame.floor_frames`.
        far: As for :func:`free_floor`.
        longest_gap: As for :func:`free_floor`.
    """
    if is_on_side(down):
        columns = view.label.shape[1]
        return np.zeros((columns, 2, 2), np.int32), np.zeros(columns, np.int32)
    if is_upside_down(down):
        view = FloorView(*(a[::-1, ::-1] for a in view))
    return free_floor(view, far, longest_gap)


def is_on_side(down: np.ndarray) -> bool:
    """Return whether a camera is on its side, from ``(3,)`` int as for :func:`floor_ahead`."""
    return abs(int(down[0])) > abs(int(down[1]))


def is_upside_down(down: np.ndarray) -> bool:
    """Return whether a camera is upside down, from ``(3,)`` int as for :func:`floor_ahead`."""
    return int(down[1]) < 0


def free_floor(view: FloorView, far: int, longest_gap: int) -> tuple[np.ndarray, np.ndarray]:
    """Follow the floor in each column of cells, from the robot outward.

    From the nearest floor cell on, the floor continues while the next floor cell is at most
    ``longest_gap`` farther and no obstacle of the column is nearer. It is ended by

    - a drop, if the next ``RUN`` measured cells are all lower than the last floor cell by more than
      the minimum height of a drop and lie flat, and if no floor continues at its level. Stereo
      cameras bow far floor down too, but gradually. Reflections in a glossy floor are below it too,
      but they stand upright, or floor continues beyond them and is nearer than they seem to be,
      since nothing is visible through a floor. Reflections are also narrow, so of a column and its
      ``NEIGHBOURS`` columns on each side, more than half must drop;
    - an obstacle, if the nearest one of the column is at most ``longest_gap`` farther;
    - the end of the range, if that is at most ``longest_gap`` farther;
    - otherwise for an unknown reason.

    Args:
        view: The cells.
        far: End of the range [depth units].
        longest_gap: Maximum gap between floor cells [depth units].

    Returns:
        Start and end of the floor, ``(C, 2, 2)`` int32, right and forward in the ground frame
        [depth units], and the kind of its end, ``(C,)`` int32 (:class:`jaxdet.types.FreeEnd`). If
        only an obstacle is visible and no floor, both points are on the nearest obstacle; if
        nothing is visible, they are 0. All distances are components forward.
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
    window = np.ones(2 * NEIGHBOURS + 1, np.int64)
    dropping = np.convolve(drops, window)[NEIGHBOURS : NEIGHBOURS + columns]
    end[(drops > 0) & (dropping <= NEIGHBOURS)] = FreeEnd.UNKNOWN
    return line, end


def _followed(view: FloorView, column: int, floor: np.ndarray, gap: int) -> tuple[int, bool]:
    """Return the last row of the floor that begins at ``floor[0]``, and whether it drops there."""
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
    """Return whether the next ``RUN`` measured cells up a column are lower by a drop and lie flat.

    It is not a drop if floor farther up is clearly nearer than these cells.
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
