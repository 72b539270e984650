"""Shi-Tomasi corners, written out as OpenCV computes them."""

import numpy as np

f32, f64 = np.float32, np.float64


def min_eigenvalue(image: np.ndarray) -> np.ndarray:
    """Smaller eigenvalue of the gradient's covariance, as ``cv2.cornerMinEigenVal(image, 3)``.

    The bits are those of OpenCV's AVX2 path: the smoothing of both Sobel filters is a fused
    multiply-add (here: in float64, rounded once), the eigenvalue itself is not fused. OpenCV
    leaves the fusing out in the last ``W mod 32`` columns and on processors without FMA; this
    rule does not depend on either.

    Args:
        image: ``(H, W)`` uint8.

    Returns:
        ``(H, W)`` float32.
    """
    dx, dy = _scaled_sobel(image, 1.0 / (4 * 3 * 255))
    xx, xy, yy = (_box_sum(p) for p in (dx * dx, dx * dy, dy * dy))
    a, c = f32(0.5) * xx, f32(0.5) * yy
    t = a - c
    return (a + c) - np.sqrt(t * t + xy * xy)


def _scaled_sobel(image: np.ndarray, scale: float) -> tuple[np.ndarray, np.ndarray]:
    """3x3 Sobel derivatives times ``scale``, borders mirrored (101); ``(H, W)`` float32."""
    k1, k0 = f64(f32(scale)), f64(f32(2 * scale))
    p = np.pad(image.astype(f64), 1, mode="reflect")

    def fused(outer: np.ndarray, k: np.float64, inner: np.ndarray) -> np.ndarray:
        return (outer * k + inner).astype(f32)

    across = p[:, 2:] - p[:, :-2]
    above, middle, below = across[:-2], across[1:-1], across[2:]
    dx = fused(above + below, k1, (middle * k0).astype(f32).astype(f64))
    left, middle, right = p[:, :-2], p[:, 1:-1], p[:, 2:]
    smooth = fused(middle, k0, (left * k1).astype(f32).astype(f64))
    smooth = fused(right, k1, smooth.astype(f64))
    return dx, smooth[2:] - smooth[:-2]


def _box_sum(values: np.ndarray) -> np.ndarray:
    """Sum over 3x3 windows, borders mirrored (101); ``(H, W)`` float32.

    As OpenCV's box filter: float64, left to right along rows, and a running sum down each
    column, to which the next row is added and from which the oldest is then taken away. The
    running sum's rounding decides ties on edge images, so it is part of the rule.
    """
    height, width = values.shape
    p = np.pad(values.astype(f64), 1, mode="reflect")
    rows = p[:, :-2] + p[:, 1:-1] + p[:, 2:]
    running = rows[0] + rows[1]
    sums = np.empty((height, width), f32)
    for v in range(height):
        total = running + rows[v + 2]
        sums[v] = total
        running = total - rows[v]
    return sums


def strongest_corners(
    strength: np.ndarray,
    allowed: np.ndarray | None,
    max_corners: int,
    quality_level: float,
    min_distance: float,
) -> np.ndarray:
    """The strongest local maxima with a minimum distance, as ``cv2.goodFeaturesToTrack``.

    A corner is not on the image border, is stronger than ``quality_level`` times the strongest
    allowed pixel, and is the maximum of its 3x3 window (all of a plateau are). In order of
    falling strength, ties by falling raster position, a corner is taken unless one already
    taken is nearer than ``min_distance``.

    Args:
        strength: ``(H, W)`` float32, from :func:`min_eigenvalue`.
        allowed: ``(H, W)`` bool, or None for everywhere.
        max_corners: Stop after this many; 0 = no limit.
        quality_level: Share of the strongest corner's strength.
        min_distance: Least distance of two corners [pixel]; below 1: none.

    Returns:
        ``(n, 2)`` int32, column and row, strongest first.
    """
    if allowed is None:
        allowed = np.ones(strength.shape, bool)
    if not allowed.any():
        return np.zeros((0, 2), np.int32)
    threshold = f32(f64(strength[allowed].max()) * quality_level)
    kept = np.where(strength > threshold, strength, f32(0))
    is_corner = allowed & (kept != 0) & (kept == _window_maximum(kept))
    is_corner[[0, -1]] = False
    is_corner[:, [0, -1]] = False
    position = np.flatnonzero(is_corner)
    position = position[np.lexsort((-position, -kept.reshape(-1)[position]))]
    corners = np.stack([position % strength.shape[1], position // strength.shape[1]], axis=1)
    return _without_near(corners.astype(np.int32), max_corners, min_distance)


def _window_maximum(values: np.ndarray) -> np.ndarray:
    p = np.pad(values, 1, constant_values=-np.inf)
    rows = np.maximum(np.maximum(p[:-2], p[1:-1]), p[2:])
    return np.maximum(np.maximum(rows[:, :-2], rows[:, 1:-1]), rows[:, 2:])


def _without_near(corners: np.ndarray, max_corners: int, min_distance: float) -> np.ndarray:
    """Greedy non-maximum suppression: drops corners near a stronger one that was taken."""
    limit = max_corners or len(corners)
    if min_distance < 1:
        return corners[:limit]
    taken = np.zeros((min(limit, len(corners)), 2), np.int32)
    count = 0
    for corner in corners:
        if count == limit:
            break
        offset = taken[:count] - corner
        if not np.any(np.sum(offset * offset, axis=1) < min_distance * min_distance):
            taken[count] = corner
            count += 1
    return taken[:count]
