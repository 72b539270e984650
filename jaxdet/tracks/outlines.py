"""Rectangles on the floor: overlap, gap and displacement of pairs."""

from typing import NamedTuple

import numpy as np

from jaxdet.elementary import dot, hypot


class Outlines(NamedTuple):
    """``N`` rectangles on the floor, in the world or the camera's ground frame."""

    center: np.ndarray
    """Centres ``(N, 2)`` float64 [m]."""
    axis: np.ndarray
    """Unit vectors along the first side, ``(N, 2)`` float64."""
    half: np.ndarray
    """Half lengths of the first and the second side, ``(N, 2)`` float64 [m]."""

    def take(self, rows: np.ndarray) -> "Outlines":
        """Return the outlines selected by indices or a mask."""
        return Outlines(*(part[rows] for part in self))

    @classmethod
    def of_corners(cls, corners: np.ndarray) -> "Outlines":
        """Build outlines from corners ``(N, 8)``: x, y of each corner in order [m]."""
        corner = corners.reshape(-1, 4, 2).astype(np.float64)
        first, second = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 1]
        length, width = hypot(*first.T), hypot(*second.T)
        across = np.stack([second[:, 1], -second[:, 0]], 1) / np.maximum(width, 1e-9)[:, None]
        axis = np.where(length[:, None] > 1e-9, first / np.maximum(length, 1e-9)[:, None], across)
        axis[(length <= 1e-9) & (width <= 1e-9)] = 1.0, 0.0
        middle = (corner[:, 0] + corner[:, 1] + corner[:, 2] + corner[:, 3]) / 4
        return cls(middle, axis, np.stack([length, width], 1) / 2)

    @property
    def area(self) -> np.ndarray:
        """Areas ``(N,)`` [m²]."""
        return 4 * self.half[:, 0] * self.half[:, 1]

    def reach(self, direction: np.ndarray) -> np.ndarray:
        """Return half the extents ``(N,)`` [m] along unit vectors ``(N, 2)``."""
        along = np.abs(dot(self.axis, direction))
        across = np.abs(self.axis[:, 0] * direction[:, 1] - self.axis[:, 1] * direction[:, 0])
        return self.half[:, 0] * along + self.half[:, 1] * across


def overlap(a: Outlines, b: Outlines) -> np.ndarray:
    """Compute the overlap of rectangle pairs by the separating axis test.

    The overlap is the minimum, over the sides of both, of the shared length divided by the smaller
    extent: 1 if one rectangle contains the other, negative if a line separates them.

    Args:
        a: ``N`` rectangles.
        b: ``N`` rectangles.

    Returns:
        Overlaps ``(N,)`` float64, at most 1.
    """
    shift, least = b.center - a.center, np.full(len(a.center), 1.0)
    for axis in (a.axis, perpendicular(a.axis), b.axis, perpendicular(b.axis)):
        one, other = a.reach(axis), b.reach(axis)
        shared = one + other - np.abs(dot(shift, axis))
        least = np.minimum(least, shared / np.maximum(2 * np.minimum(one, other), 1e-9))
    return least


def gap(a: Outlines, b: Outlines) -> np.ndarray:
    """Compute the maximum gap along any side of two rectangles; negative if they overlap.

    Returns:
        Gaps ``(N,)`` float64 [m]; less than the distance if two corners face each other.
    """
    shift, most = b.center - a.center, np.full(len(a.center), -np.inf)
    for axis in (a.axis, perpendicular(a.axis), b.axis, perpendicular(b.axis)):
        apart = np.abs(dot(shift, axis)) - a.reach(axis) - b.reach(axis)
        most = np.maximum(most, apart)
    return most


def displacement(a: Outlines, b: Outlines) -> np.ndarray:
    """Compute the motion from ``a`` to ``b``, robust against changes of the visible part.

    Along each side of ``a`` the displacement is the minimum over both ends and the centre: a change
    of visibility moves one end and the centre, while motion moves all three.

    Returns:
        Larger one of the displacements along both sides, ``(N,)`` float64 [m].
    """
    shift, most = b.center - a.center, np.zeros(len(a.center))
    for axis in (a.axis, perpendicular(a.axis)):
        middle, grown = dot(shift, axis), b.reach(axis) - a.reach(axis)
        # The ends moved by middle + grown and middle - grown.
        end = np.abs(np.abs(middle) - np.abs(grown))
        most = np.maximum(most, np.minimum(end, np.abs(middle)))
    return most


def perpendicular(axis: np.ndarray) -> np.ndarray:
    """Rotate unit vectors ``(N, 2)`` by 90 degrees to the left."""
    return np.stack([-axis[:, 1], axis[:, 0]], axis=1)
