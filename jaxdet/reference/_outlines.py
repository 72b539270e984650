"""Outlines: visible contour of each obstacle on the floor, and the rectangle that fits it."""

from math import isqrt

import numpy as np

from jaxdet.floor.plane import DIRECTION_BITS, direction_table

LONG_TRIM = 20  # one in LONG_TRIM cells of a long obstacle is trimmed at each of its long sides
FAR_BEHIND = 4
"""Where the contour jumps, a corner must be this many times ``bend`` behind the chord."""
FAR = 1 << 40  # farther than any edge


def contours(
    label: np.ndarray, right: np.ndarray, forward: np.ndarray, slots: int
) -> tuple[np.ndarray, np.ndarray]:
    """Find the contour of each obstacle on the floor: its nearest cell in each column of cells.

    The nearest cell is that with the smallest distance on the floor; of equally near cells it is
    the one farther up. Columns of cells correspond to steps of bearing.

    Args:
        label: Obstacles ``(R, C)``, -1 = none.
        right: Positions to the right in the ground frame, ``(R, C)`` int64 [depth units].
        forward: Positions forward in the ground frame, ``(R, C)`` int64 [depth units].
        slots: ``M``, maximum number of obstacles.

    Returns:
        Right and forward, from left to right, ``(M, C, 2)`` int32, and the number of points of each
        contour, ``(M,)`` int32.

    Example:
        >>> label = np.array([[0, 0], [0, -1]])
        >>> right, forward = np.array([[-5, 5], [-4, 4]]), np.array([[90, 80], [70, 60]])
        >>> points, count = contours(label, right, forward, 1)
        >>> points[0, : count[0]].tolist()
        [[-4, 70], [5, 80]]
    """
    points = np.zeros((slots, label.shape[1], 2), np.int32)
    count = np.zeros(slots, np.int32)
    distance = right * right + forward * forward
    for number in range(min(slots, int(label.max(initial=-1)) + 1)):
        own = np.where(label == number, distance, 1 << 60)
        column = np.flatnonzero((label == number).any(axis=0))
        row = np.argmin(own[:, column], axis=0)
        count[number] = len(column)
        points[number, : len(column)] = np.stack([right[row, column], forward[row, column]], -1)
    return points, count


def straight_parts(contour: np.ndarray, bend: int, shortest: int, jump: int) -> list[int]:
    """Split a contour where it bends around free floor, by split and merge.

    A contour whose ends are nearer to the camera than its middle encloses floor, as the walls of a
    room or a corridor do, and a single rectangle would cover that floor. The contour is split at
    the point farthest behind the chord of its ends, if that is more than ``bend`` behind it (four
    times that where the contour jumps, as between the legs of a table) and at least ``shortest``
    from both ends; the parts are split recursively. Neighbouring parts that together do not bend
    are merged. All arithmetic is in integers: squared lengths, and cross products against a chord
    whose length is rounded down. Duda and Hart, *Pattern Classification and Scene Analysis* (1973),
    338-339; Pavlidis and Horowitz, IEEE Transactions on Computers C-23 (1974).

    Args:
        contour: Right and forward, from left to right, ``(n, 2)`` integer [depth units].
        bend: Minimum distance of a corner behind the chord [depth units].
        shortest: Minimum length of a side [depth units].
        jump: Maximum distance between neighbouring points at a corner [depth units].

    Returns:
        First point of each part, beginning with 0.

    Example:
        >>> left = [(-600, y) for y in range(1000, 3000, 100)]
        >>> across = [(x, 3000) for x in range(-600, 600, 100)]
        >>> straight_parts(np.array(left + across), 200, 300, 200)
        [0, 20]
    """
    points = contour.astype(np.int64)
    near = _squared(np.diff(points, axis=0)) <= jump * jump

    def corner(first: int, last: int) -> int | None:
        """Return the point at which to split ``first .. last``, or None."""
        area, chord = _behind_chord(points[first : last + 1])
        at = first + int(np.argmax(area))
        smooth = near[max(at - 2, 0) : at + 2].all()
        bends = area.max() > (bend if smooth else FAR_BEHIND * bend) * chord
        sides = _squared(points[[first, last]] - points[at])
        return at if bends and sides.min() >= shortest * shortest else None

    def split(first: int, last: int) -> list[int]:
        at = corner(first, last) if last - first >= 4 else None
        return [first] if at is None else [*split(first, at), *split(at, last)]

    if len(points) < 5:
        return [0]
    parts = [*split(0, len(points) - 1), len(points) - 1]
    merged = parts[:1]
    for place in range(1, len(parts) - 1):
        area, chord = _behind_chord(points[merged[-1] : parts[place + 1] + 1])
        if area.max() > bend * chord:
            merged.append(parts[place])
    return merged


def _behind_chord(points: np.ndarray) -> tuple[np.ndarray, int]:
    """Compute how far points lie behind the chord of the first and the last, seen from the camera.

    Returns:
        Twice the areas of the triangles over the chord, positive behind it, ``(n,)`` int64, and the
        length of the chord, rounded down but at least 1: the distance is their quotient.
    """
    first, chord = points[0], points[-1] - points[0]
    away = points - first
    area = chord[0] * away[:, 1] - chord[1] * away[:, 0]
    faces = chord[0] * first[1] - chord[1] * first[0] >= 0
    return (area if faces else -area), max(isqrt(int(_squared(chord))), 1)


def _squared(points: np.ndarray) -> np.ndarray:
    """Return the squared length of points ``(..., 2)``."""
    return (points * points).sum(axis=-1)


def fitted_direction(contour: np.ndarray) -> np.ndarray:
    """Find the direction of the rectangle that fits a contour best.

    The result is the one of 90 directions whose bounding rectangle minimises the sum of the
    distances of the points to the nearer of its one or two edges that face the camera. The other
    edges are not visible, so no contour lies on them. A wall determines its own direction, the
    corner of a box that of its sides. Ties go to the rectangle with the smaller area, then to the
    smaller angle. Zhang et al., *Efficient L-shape fitting for vehicle detection using laser
    scanners*, IEEE Intelligent Vehicles 2017 (closeness criterion, as a sum, and with the facing
    edges instead of all four).

    Args:
        contour: Right and forward of the camera, ``(n, 2)`` integer [depth units].

    Returns:
        Direction ``(2,)`` int64 with ``DIRECTION_BITS`` fraction bits, the right part positive, the
        forward part not negative; (1, 0) for a single point.

    Example:
        >>> line = np.stack([np.arange(100), 500 + 2 * np.arange(100)], axis=-1)
        >>> fitted_direction(line).tolist()
        [232, 456]
    """
    along, across, table = _project(contour.astype(np.int64))
    edges = np.minimum(_to_near_edge(along), _to_near_edge(across))
    cost = edges.sum(axis=1) >> DIRECTION_BITS
    wide, deep = (np.ptp(a, axis=1) >> DIRECTION_BITS for a in (along, across))
    return table[np.lexsort((wide * deep, cost))[0]]


def _to_near_edge(places: np.ndarray) -> np.ndarray:
    """Return distances of positions ``(D, n)`` on axes from the end nearest to the camera.

    The camera is at 0. Distances are ``FAR`` on an axis whose positions are on both sides of it.
    """
    low, high = places.min(axis=1, keepdims=True), places.max(axis=1, keepdims=True)
    return np.where(low > 0, places - low, np.where(high < 0, high - places, FAR))


def _project(points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return coordinates of points ``(n, 2)`` along and across each direction, and the directions.

    The coordinates are ``(D, n)`` each.
    """
    table = direction_table()
    x, y = points.T
    along = table[:, :1] * x + table[:, 1:] * y
    return along, table[:, :1] * y - table[:, 1:] * x, table


def inner(at_margin: np.ndarray) -> np.ndarray:
    """Return which cells of an obstacle are reliable: those outside the margins of the image.

    Stereo depth is bent toward the camera in the margins (:func:`jaxdet.reference._cells.margins`).
    If more than half of the cells are in the margins, all cells count as reliable.

    Args:
        at_margin: Whether each cell is in a margin, ``(n,)`` bool.

    Returns:
        Mask ``(n,)`` bool.

    Example:
        >>> inner(np.array([True, False, False])).tolist()
        [False, True, True]
        >>> inner(np.array([True, True, False])).tolist()
        [True, True, True]
    """
    return ~at_margin | (2 * int(at_margin.sum()) > len(at_margin))


def fitted_span(
    points: np.ndarray, direction: np.ndarray, long: int, relied: np.ndarray
) -> np.ndarray:
    """Compute the extremes of an obstacle's cells along and across a direction.

    The longer side of the rectangle contains all cells, the shorter one only the reliable cells:
    the depth of a wall does not grow if its ends are bent toward the camera in the margins of the
    image. Walls and other obstacles longer than ``long`` are smeared and bowed over more floor than
    they stand on: a twentieth of their cells is trimmed at each of the two long sides.

    Args:
        points: Right and forward ``(n, 2)`` integer [depth units].
        direction: Direction ``(2,)`` integer.
        long: Length from which the long sides are trimmed [depth units].
        relied: Whether each cell is reliable, ``(n,)`` bool, at least one, see :func:`inner`.

    Returns:
        Smallest and largest coordinate along (dot product), and across the direction (cross
        product), ``(4,)`` int64.
    """
    x, y = points.astype(np.int64).T
    sides = [direction[0] * x + direction[1] * y, direction[0] * y - direction[1] * x]
    lengths = [int(a.max() - a.min()) >> DIRECTION_BITS for a in sides]
    short = int(np.argmin(lengths))
    ordered = [np.sort(a[relied] if side == short else a) for side, a in enumerate(sides)]
    over = [0, 0]
    if max(lengths) > long:
        over[short] = len(ordered[short]) // LONG_TRIM
    ends = [(a[skip], a[-1 - skip]) for a, skip in zip(ordered, over, strict=True)]
    return np.array([*ends[0], *ends[1]])
