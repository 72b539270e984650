"""Low obstacles that appear as notches in the outline of the free floor."""

import numpy as np

from jaxdet.types import FreeEnd


def notches(end: np.ndarray, ahead: np.ndarray, length: int) -> np.ndarray:
    """Find the notches in the outline of the free floor.

    A notch is a run of columns whose floor ends for an unknown reason, between two columns whose
    floor continues for more than ``length`` beyond all ends of the run.

    Args:
        end: Kind of end of each column, ``(C,)`` int32 (:class:`jaxdet.types.FreeEnd`).
        ahead: Distance forward at which the floor of each column ends, ``(C,)`` int64 [depth
            units]; not positive if no floor is visible.
        length: Minimum depth of a notch [depth units].

    Returns:
        Number of the notch of each column, from 0, left to right, ``(C,)`` int64; -1 = none.

    Example:
        >>> end, ahead = np.zeros(5, np.int32), np.array([900, 500, 550, 950, 940])
        >>> notches(end, ahead, 300).tolist()
        [-1, 0, 0, -1, -1]
    """
    short = (end == FreeEnd.UNKNOWN) & (ahead > 0)
    out, number, column = np.full(len(end), -1), 0, 1
    while column < len(end):
        last = column
        while last < len(end) and short[last] and ahead[column - 1] - ahead[last] > length:
            last += 1
        if column < last < len(end) and ahead[last] - ahead[column:last].max() > length:
            out[column:last] = number
            number, column = number + 1, last
        else:
            column += 1
    return out


def with_notches(
    label: np.ndarray,
    notch: np.ndarray,
    ahead: np.ndarray,
    forward: np.ndarray,
    high: np.ndarray,
    length: int,
    least: int,
) -> np.ndarray:
    """Add obstacles in the notches of the free floor to the obstacles.

    A low, dark or blurred object has too few cells above the step height for an obstacle, but the
    floor is interrupted by it. Its cells are those above half of the step height, from the end of
    the floor to ``length`` beyond it, that belong to no other obstacle.

    Args:
        label: Obstacles ``(R, C)``, -1 = none.
        notch: Notch of each column, ``(C,)``, from :func:`notches`.
        ahead: Distance forward at which the floor of each column ends, ``(C,)`` [depth units].
        forward: Distance forward of the cells, ``(R, C)`` int64 [depth units].
        high: Whether a cell is in range and above half of the step height, ``(R, C)`` bool.
        length: Maximum distance of an obstacle's cells behind the end of the floor [depth units].
        least: Minimum number of cells of an obstacle.

    Returns:
        Obstacles ``(R, C)``; those in notches are numbered last, from left to right.
    """
    inside = high & (label < 0) & (notch >= 0)
    inside &= (forward >= ahead) & (forward <= ahead + length)
    of_cell = np.broadcast_to(notch, label.shape)
    size = np.bincount(of_cell[inside], minlength=int(notch.max(initial=-1)) + 1)
    number = np.where(size >= least, np.cumsum(size >= least) - 1, -1)
    inside &= np.append(size, 0)[of_cell] >= least
    first = int(label.max(initial=-1)) + 1
    return np.where(inside, first + np.append(number, -1)[of_cell], label)
