"""Rectangles on the floor: how two of them overlap, and how far one's edges are from another's."""

from typing import NamedTuple

import numpy as np

from jaxdet.elementary import dot, hypot


class Outlines(NamedTuple):
    """``N`` rectangles on the floor, in the world or the camera's ground frame."""

    center: np.ndarray
    """``(N, 2)`` float64 [m]."""
    axis: np.ndarray
    """``(N, 2)`` float64, unit vector along the first side."""
    half: np.ndarray
    """``(N, 2)`` float64, half of the first side and of the one across it [m]."""

    def take(self, rows: np.ndarray) -> "Outlines":
        """Those of some rows, or of a mask."""
        return Outlines(*(part[rows] for part in self))

    @classmethod
    def of_corners(cls, corners: np.ndarray) -> "Outlines":
        """From corners ``(N, 8)``, x and y in turn around each [m]."""
        corner = corners.reshape(-1, 4, 2).astype(np.float64)
        first, second = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 1]
        length, width = hypot(*first.T), hypot(*second.T)
        turned = np.stack([second[:, 1], -second[:, 0]], 1) / np.maximum(width, 1e-9)[:, None]
        axis = np.where(length[:, None] > 1e-9, first / np.maximum(length, 1e-9)[:, None], turned)
        axis[(length <= 1e-9) & (width <= 1e-9)] = 1.0, 0.0
        middle = (corner[:, 0] + corner[:, 1] + corner[:, 2] + corner[:, 3]) / 4
        return cls(middle, axis, np.stack([length, width], 1) / 2)

    @property
    def area(self) -> np.ndarray:
        """``(N,)`` [m²]."""
        return 4 * self.half[:, 0] * self.half[:, 1]

    def reach(self, direction: np.ndarray) -> np.ndarray:
        """``(N,)``, half of their extent along unit vectors ``(N, 2)`` [m]."""
        along = np.abs(dot(self.axis, direction))
        across = np.abs(self.axis[:, 0] * direction[:, 1] - self.axis[:, 1] * direction[:, 0])
        return self.half[:, 0] * along + self.half[:, 1] * across


def overlap(a: Outlines, b: Outlines) -> np.ndarray:
    """How much of the smaller extent the two share, along the side on which that is least.

    Along each side of both (the separating axes): the shared length over the smaller extent; 1
    where one holds the other, negative where a line between them separates them.

    Args:
        a: ``N`` rectangles.
        b: As many.

    Returns:
        ``(N,)`` float64, at most 1.
    """
    shift, least = b.center - a.center, np.full(len(a.center), 1.0)
    for axis in (a.axis, turned(a.axis), b.axis, turned(b.axis)):
        one, other = a.reach(axis), b.reach(axis)
        shared = one + other - np.abs(dot(shift, axis))
        least = np.minimum(least, shared / np.maximum(2 * np.minimum(one, other), 1e-9))
    return least


def gap(a: Outlines, b: Outlines) -> np.ndarray:
    """How far apart the two are, along the side on which that is most; negative if they overlap.

    Returns:
        ``(N,)`` float64 [m]; of two corners that face each other, less than their distance.
    """
    shift, most = b.center - a.center, np.full(len(a.center), -np.inf)
    for axis in (a.axis, turned(a.axis), b.axis, turned(b.axis)):
        apart = np.abs(dot(shift, axis)) - a.reach(axis) - b.reach(axis)
        most = np.maximum(most, apart)
    return most


def displacement(a: Outlines, b: Outlines) -> np.ndarray:
    """How far ``b`` has moved from ``a``, whose visible part may have grown or shrunk.

    Along each side of ``a``, the least of what its two ends and its middle moved: what comes into
    sight moves one end and the middle, motion moves all three.

    Returns:
        ``(N,)`` float64, the greater of both sides [m].
    """
    shift, most = b.center - a.center, np.zeros(len(a.center))
    for axis in (a.axis, turned(a.axis)):
        middle, grown = dot(shift, axis), b.reach(axis) - a.reach(axis)
        # Its ends moved by middle + grown and middle - grown.
        end = np.abs(np.abs(middle) - np.abs(grown))
        most = np.maximum(most, np.minimum(end, np.abs(middle)))
    return most


def turned(axis: np.ndarray) -> np.ndarray:
    """Unit vectors ``(N, 2)`` turned to the left by a right angle."""
    return np.stack([-axis[:, 1], axis[:, 0]], axis=1)
