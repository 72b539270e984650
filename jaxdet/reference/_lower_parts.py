"""Lower parts of obstacles, below the step height."""

import numpy as np

from jaxdet.floor.frame import DOWN, IS_KNOWN
from jaxdet.reference._free import is_on_side, is_upside_down
from jaxdet.reference._view import View


def with_lower_parts(
    label: np.ndarray, half: np.ndarray, view: View, floor: np.ndarray
) -> np.ndarray:
    """Extend obstacles downward to half of the step height, where their sides are steep.

    Cells up to the step height are floor, so only the upper part of an object is an obstacle, of a
    low one only its top. A cell below a cell of an obstacle, in the same column, belongs to it too
    if it is above half of the step height, and lower than that cell by at least as much as it is
    nearer or farther. If the floor is unknown or the camera is on its side, nothing changes.

    Args:
        label: Obstacles ``(R, C)``, -1 = none.
        half: Whether a cell is measured and above half of the step height, ``(R, C)`` bool.
        view: Positions of the cells.
        floor: Floor frame ``(13,)`` int32, from :func:`jaxdet.floor.frame.floor_frames`.

    Returns:
        Obstacles ``(R, C)`` int64 with their lower parts.
    """
    if not floor[IS_KNOWN] or is_on_side(floor[DOWN]):
        return label
    downward = slice(None, None, -1 if is_upside_down(floor[DOWN]) else 1)
    arrays = label.copy(), half, view.height, view.forward
    out, half, height, forward = (array[downward] for array in arrays)
    for row in range(1, len(out)):
        falls = height[row - 1] - height[row]
        steep = (falls >= 0) & (np.abs(forward[row - 1] - forward[row]) <= falls)
        joins = (out[row - 1] >= 0) & (out[row] < 0) & half[row] & steep
        out[row] = np.where(joins, out[row - 1], out[row])
    return out[downward]
