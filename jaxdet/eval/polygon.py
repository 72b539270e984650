"""Polygons on the floor: area, hull, clipping, overlap, point tests."""

import numpy as np


def area(polygon: np.ndarray) -> float:
    """Compute the area ``Σ (x_i y_{i+1} - x_{i+1} y_i) / 2`` of a polygon ``(n, 2)``.

    The area is positive if the points are in counter-clockwise order.

    Example:
        >>> area(np.array([[0, 0], [2, 0], [2, 3], [0, 3]]))
        6.0
    """
    if len(polygon) < 3:
        return 0.0
    after = np.roll(polygon, -1, axis=0)
    return float(np.sum(polygon[:, 0] * after[:, 1] - after[:, 0] * polygon[:, 1]) / 2)


def hull(points: np.ndarray) -> np.ndarray:
    """Compute the convex hull of points, counter-clockwise, without points on its edges.

    Andrew, Information Processing Letters 9 (1979), 216-219.

    Args:
        points: Points ``(n, 2)``; rows with NaN are ignored.

    Returns:
        Corners ``(m, 2)`` float64, m ≤ n; fewer than 3 if the points are collinear.

    Example:
        >>> hull(np.array([[0, 0], [1, 1], [2, 0], [1, 0.2], [np.nan, 0]])).tolist()
        [[0.0, 0.0], [2.0, 0.0], [1.0, 1.0]]
    """
    points = np.asarray(points, np.float64)
    rows = np.unique(points[~np.isnan(points).any(axis=1)], axis=0)
    if len(rows) < 3:
        return rows
    halves: list[list[tuple[float, float]]] = []
    for half in (rows, rows[::-1]):
        chain: list[tuple[float, float]] = []
        for x, y in half.tolist():
            while len(chain) > 1 and _turn(chain[-2], chain[-1], (x, y)) <= 0:
                chain.pop()
            chain.append((x, y))
        halves.append(chain[:-1])
    return np.array(halves[0] + halves[1])


def _turn(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def clip(subject: np.ndarray, window: np.ndarray) -> np.ndarray:
    """Intersect two convex polygons.

    Sutherland and Hodgman, Communications of the ACM 17 (1974), 32-42.

    Args:
        subject: Convex polygon ``(n, 2)``.
        window: Convex polygon ``(m, 2)``, counter-clockwise.

    Returns:
        Intersection ``(k, 2)`` float64, empty if they are disjoint.
    """
    out = np.asarray(subject, np.float64)
    for start, end in zip(window, np.roll(window, -1, axis=0), strict=True):
        if not len(out):
            break
        edge = end - start
        side = edge[0] * (out[:, 1] - start[1]) - edge[1] * (out[:, 0] - start[0])
        pieces: list[np.ndarray] = []
        for i in range(len(out)):
            j = (i + 1) % len(out)
            if side[i] >= 0:
                pieces.append(out[i])
            if (side[i] >= 0) != (side[j] >= 0):
                pieces.append(out[i] + (out[j] - out[i]) * (side[i] / (side[i] - side[j])))
        out = np.array(pieces).reshape(-1, 2)
    return out


def overlap(a: np.ndarray, b: np.ndarray) -> float:
    """Compute the intersection over union of the convex hulls of two outlines.

    Args:
        a: Points ``(n, 2)``; rows with NaN are ignored.
        b: Points ``(m, 2)``; rows with NaN are ignored.

    Returns:
        0 to 1; NaN if neither has an area.

    Example:
        >>> square = np.array([[0, 0], [2, 0], [2, 2], [0, 2]])
        >>> round(overlap(square, square + [1, 0]), 6)
        0.333333
    """
    a, b = hull(a), hull(b)
    first, second = area(a), area(b)
    if first == 0 and second == 0:
        return float("nan")
    common = area(clip(a, b)) if first and second else 0.0
    return min(1.0, max(0.0, common / (first + second - common)))


def inside(outline: np.ndarray, points: np.ndarray, margin: float = 0.0) -> np.ndarray:
    """Return which points are in a convex outline, or outside of it by at most the margin.

    Args:
        outline: Convex polygon ``(n, 2)`` in either order; it may be a line or a point.
        points: Points ``(k, 2)``.
        margin: Margin in the units of the points.

    Returns:
        Mask ``(k,)`` bool.

    Example:
        >>> line = np.array([[0, 0], [2, 0], [2, 0], [0, 0]])
        >>> inside(line, np.array([[1, 0], [1, 0.1], [1, 0.3], [3, 0]]), 0.2).tolist()
        [True, True, False, False]
    """
    turn = -1.0 if area(outline) < 0 else 1.0
    low, high = outline.min(axis=0) - margin, outline.max(axis=0) + margin
    within = ((points >= low) & (points <= high)).all(axis=1)
    for start, end in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        edge = end - start
        length = float(np.hypot(*edge))
        if length:
            normal = turn * np.array([edge[1], -edge[0]]) / length
            within &= (points - start) @ normal <= margin
    return within


def near_side(outline: np.ndarray, step: float = 0.01) -> np.ndarray:
    """Sample points on the edges of an outline that face the origin.

    An edge of the convex hull faces the origin if its outer normal points to that side. On each
    such edge the points are evenly spaced, at most ``step`` apart, ends included.

    Args:
        outline: Points ``(n, 2)``; rows with NaN are ignored.
        step: Maximum spacing in the units of the outline.

    Returns:
        Points ``(k, 2)`` float64; none if the origin is inside.

    Example:
        >>> near_side(np.array([[-1, 2], [1, 2], [1, 4], [-1, 4]]), 1.0).tolist()
        [[-1.0, 2.0], [0.0, 2.0], [1.0, 2.0]]
    """
    corners = hull(outline)
    pieces = [np.zeros((0, 2))]
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        edge = end - start
        if edge[1] * start[0] - edge[0] * start[1] < 0:
            count = max(1, int(np.ceil(np.hypot(*edge) / step - 1e-9)))
            pieces.append(start + edge * (np.arange(count + 1)[:, None] / count))
    return np.concatenate(pieces)
