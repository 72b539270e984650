"""Free floor: how far the floor is seen in each direction, and what ends it."""

from typing import NamedTuple

import numpy as np

from jaxdet.types import FreeEnd

RUN = 2
"""So many measured cells one after the other below the floor make a drop."""


class FloorView(NamedTuple):
    """One frame's cells as the search for free floor sees them, each ``(R, C)``."""

    label: np.ndarray
    """Obstacles, -1 = none."""
    floor: np.ndarray
    """bool, measured on the floor."""
    below: np.ndarray
    """bool, measured clearly below the floor."""
    right: np.ndarray
    """Ground frame [depth units]."""
    forward: np.ndarray
    """Ground frame [depth units]."""


def free_floor(view: FloorView, far: int, longest_gap: int) -> tuple[np.ndarray, np.ndarray]:
    """Follows the floor in each column of cells, from the robot outward.

    From the nearest floor cell on, the floor goes on while the next one is at most ``longest_gap``
    farther and no obstacle of the column is nearer. It is ended by

    - an obstacle, where the column's nearest one is at most ``longest_gap`` farther;
    - a drop, where the next ``RUN`` measured cells are clearly below the floor; a reflection in a
      glossy floor is too, but beyond it floor is seen, or the thing that it mirrors;
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
        steps = np.flatnonzero(np.diff(view.forward[floor, column]) > longest_gap)
        last = floor[steps[0]] if len(steps) else floor[-1]
        line[column] = place[floor[0], column], place[last, column]
        close = limit - view.forward[last, column] <= longest_gap
        if _drops(view, column, int(last)):
            end[column] = FreeEnd.DROP
        elif close and len(blocked):
            end[column] = FreeEnd.OBSTACLE
            line[column, 1] = place[nearest, column]
        elif close:
            end[column] = FreeEnd.RANGE
    return line, end


def _drops(view: FloorView, column: int, last: int) -> bool:
    """Whether the next measured cells up a column are below the floor, and nothing stands there."""
    above = slice(0, last)
    below, thing = view.below[above, column][::-1], view.label[above, column][::-1] >= 0
    measured = below | thing | view.floor[above, column][::-1]
    below, thing = below[measured], thing[measured]
    run = int(np.argmin(np.append(below, False)))
    return run >= RUN and not (run < len(thing) and thing[run])
