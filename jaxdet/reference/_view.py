"""The cells of a frame in space, and the extents of surfaces made of them."""

from typing import NamedTuple

import numpy as np

TRIM = 20  # one of so many cells of a surface is passed over at each side when it is measured


class View(NamedTuple):
    """The cells of one frame, each ``(R, C)`` int64 [depth units]."""

    x: np.ndarray  # to the right in the camera
    y: np.ndarray  # down in the camera
    z: np.ndarray  # forward in the camera, 0 = no measurement
    right: np.ndarray  # on the floor
    forward: np.ndarray  # on the floor
    height: np.ndarray  # above the floor


class Extents(NamedTuple):
    """What is known of each surface, each ``(S,)`` int64: cells, or depth units."""

    cells: np.ndarray
    rows: np.ndarray  # from the first to the last, both counted
    columns: np.ndarray
    left: np.ndarray  # smallest right, but for a twentieth of the cells: silhouettes are smeared
    right: np.ndarray  # largest, likewise
    near: np.ndarray  # smallest forward, likewise
    far: np.ndarray  # largest, likewise
    bottom: np.ndarray  # smallest height above the floor
    top: np.ndarray
    nearest: np.ndarray  # smallest z

    @property
    def width(self) -> np.ndarray:
        """Sideways."""
        return self.right - self.left

    @property
    def depth(self) -> np.ndarray:
        """Forward."""
        return self.far - self.near


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
