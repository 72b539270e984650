"""Outlines: each obstacle's visible contour on the floor, and the rectangle that fits it."""

import numpy as np

from jaxdet.types import MAX_CONTOUR

DIRECTIONS = 90
"""Directions tried for a rectangle, a degree apart."""
DIRECTION_BITS = 9
"""Fraction bits of a direction, short enough for products in 32 bits."""


def contours(
    label: np.ndarray, right: np.ndarray, forward: np.ndarray, slots: int
) -> tuple[np.ndarray, np.ndarray]:
    """The visible edge of each obstacle on the floor: its nearest cell in each column of cells.

    A column of cells is a step of bearing. Nearest is the smallest distance on the floor; of equal
    ones, the cell farther up.

    Args:
        label: ``(R, C)`` obstacles, -1 = none.
        right: ``(R, C)`` int64, ground frame [depth units].
        forward: ``(R, C)`` int64, ground frame [depth units].
        slots: ``M``, how many obstacles there is room for.

    Returns:
        ``(M, MAX_CONTOUR, 2)`` int32 right and forward, from left to right, and ``(M,)`` int32, how
        many points of each are used.

    Example:
        >>> label = np.array([[0, 0], [0, -1]])
        >>> right, forward = np.array([[-5, 5], [-4, 4]]), np.array([[90, 80], [70, 60]])
        >>> points, count = contours(label, right, forward, 1)
        >>> points[0, : count[0]].tolist()
        [[-4, 70], [5, 80]]
    """
    points = np.zeros((slots, MAX_CONTOUR, 2), np.int32)
    count = np.zeros(slots, np.int32)
    distance = right * right + forward * forward
    for number in range(min(slots, int(label.max(initial=-1)) + 1)):
        own = np.where(label == number, distance, 1 << 60)
        column = np.flatnonzero((label == number).any(axis=0))[:MAX_CONTOUR]
        row = np.argmin(own[:, column], axis=0)
        count[number] = len(column)
        points[number, : len(column)] = np.stack([right[row, column], forward[row, column]], -1)
    return points, count


def fitted_direction(contour: np.ndarray) -> np.ndarray:
    """The direction of the rectangle that fits a contour best.

    Of 90 directions, the one whose bounding rectangle has the contour nearest to its edges: the
    smallest sum of the points' distances to the nearest edge. A wall gives its own direction, the
    corner of a box that of its sides. Of equal ones, the rectangle with the smaller area, then the
    smaller angle. Zhang et al., *Efficient L-shape fitting for vehicle detection using laser
    scanners*, IEEE Intelligent Vehicles 2017 (the closeness criterion, with a sum).

    Args:
        contour: ``(n, 2)`` integer [depth units].

    Returns:
        ``(2,)`` int64 with ``DIRECTION_BITS`` fraction bits, the right part positive, the forward
        part not negative; (1, 0) for a single point.

    Example:
        >>> line = np.stack([np.arange(100), 2 * np.arange(100)], axis=-1)
        >>> fitted_direction(line).tolist()
        [232, 456]
    """
    along, across, table = _project(contour.astype(np.int64))
    low, high = along.min(axis=1, keepdims=True), along.max(axis=1, keepdims=True)
    near, far = across.min(axis=1, keepdims=True), across.max(axis=1, keepdims=True)
    edges = np.minimum(
        np.minimum(along - low, high - along), np.minimum(across - near, far - across)
    )
    cost = edges.sum(axis=1) >> DIRECTION_BITS
    area = ((high - low)[:, 0] >> DIRECTION_BITS) * ((far - near)[:, 0] >> DIRECTION_BITS)
    return table[np.lexsort((area, cost))[0]]


def _project(points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points ``(n, 2)`` along and across each direction, ``(D, n)``, and the directions."""
    angle = np.radians(np.arange(DIRECTIONS) * 90.0 / DIRECTIONS)
    table = np.rint(np.stack([np.cos(angle), np.sin(angle)], -1) * (1 << DIRECTION_BITS))
    table = table.astype(np.int64)
    x, y = points.T
    along = table[:, :1] * x + table[:, 1:] * y
    return along, table[:, :1] * y - table[:, 1:] * x, table


def fitted_span(points: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """The extremes of an obstacle's cells along and across a direction.

    Args:
        points: ``(n, 2)`` integer, right and forward [depth units].
        direction: ``(2,)`` integer.

    Returns:
        ``(4,)`` int64: least and largest along (dot product), least and largest across (cross
        product with the direction).
    """
    x, y = points.astype(np.int64).T
    along, across = direction[0] * x + direction[1] * y, direction[0] * y - direction[1] * x
    return np.array([along.min(), along.max(), across.min(), across.max()])
