"""Positions of the cells of a frame, and extents of surfaces."""

from typing import NamedTuple

import numpy as np

TRIM = 20  # one in TRIM cells of a surface is trimmed at each side when it is measured


class View(NamedTuple):
    """Positions of the cells of one frame, each ``(R, C)`` int64 [depth units]."""

    x: np.ndarray  # to the right in the camera
    y: np.ndarray  # down in the camera
    z: np.ndarray  # forward in the camera, 0 = no measurement
    right: np.ndarray  # on the floor, to the right
    forward: np.ndarray  # on the floor, forward
    height: np.ndarray  # above the floor


class Extents(NamedTuple):
    """Extents of each surface, each ``(S,)`` int64 [cells or depth units]."""

    cells: np.ndarray
    rows: np.ndarray  # number of rows from the first to the last
    columns: np.ndarray
    # smallest ``View.right`` after a twentieth of the cells is trimmed, as silhouettes are smeared
    left: np.ndarray
    right: np.ndarray  # largest ``View.right``, trimmed
    near: np.ndarray  # smallest ``View.forward``, trimmed
    far: np.ndarray  # largest ``View.forward``, trimmed
    bottom: np.ndarray  # smallest height above the floor
    top: np.ndarray  # largest height above the floor
    nearest: np.ndarray  # smallest ``View.z``

    @property
    def width(self) -> np.ndarray:
        """Trimmed extent sideways, ``(S,)`` int64 [depth units]."""
        return self.right - self.left

    @property
    def depth(self) -> np.ndarray:
        """Trimmed extent forward, ``(S,)`` int64 [depth units]."""
        return self.far - self.near


def extents(label: np.ndarray, view: View) -> Extents:
    """Measure the extents of the surfaces ``0 .. S - 1`` of a frame."""
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
