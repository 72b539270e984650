"""Shi-Tomasi corners of edge images, equal to OpenCV's except for the rounding of sums."""

import numpy as np

f32, f64 = np.float32, np.float64

STEP = f32(255 * f64(f32(1 / (4 * 3 * 255))))
"""Gradient at a step from 0 to 255, with OpenCV's scale of gradients, 1 / (4 * 3 * 255)."""


def corner_strength(edges: np.ndarray) -> np.ndarray:
    """Return the smaller eigenvalue of the gradient's covariance in 3x3 windows.

    The gradients are those of ``cv2.cornerMinEigenVal(edges, 3)``: 3x3 Sobel filters in float32
    with reflect-101 borders. Products of gradients of an edge image are multiples of 2^-31, so
    their sums are exact in float64, and a strength depends only on its 5x5 pixels. OpenCV's running
    sums keep residues of gradients that cancel: its strengths may differ in the last bit, depending
    on the processor and on the rows above.

    Args:
        edges: Edge image ``(H, W)`` uint8, 0 or 255.

    Returns:
        Strengths ``(H, W)`` float32.

    Example:
        >>> square = np.zeros((7, 7), np.uint8)
        >>> square[:4, :4] = 255
        >>> strength = corner_strength(square)
        >>> np.unravel_index(strength.argmax(), strength.shape)
        (np.int64(3), np.int64(3))
    """
    p = np.pad(edges != 0, 1, mode="reflect").astype(np.int32)
    across = p[:, 2:] - p[:, :-2]
    dx = (across[:-2] + 2 * across[1:-1] + across[2:]).astype(f32) * STEP
    smooth = (p[:, :-2] + 2 * p[:, 1:-1] + p[:, 2:]).astype(f32) * STEP
    dy = smooth[2:] - smooth[:-2]
    xx, xy, yy = (_window_sum(p) for p in (dx * dx, dx * dy, dy * dy))
    a, c = f32(0.5) * xx, f32(0.5) * yy
    t = a - c
    return (a + c) - np.sqrt(t * t + xy * xy)


def _window_sum(values: np.ndarray) -> np.ndarray:
    """Sum over 3x3 windows with reflect-101 borders; ``(H, W)`` float32."""
    p = np.pad(values.astype(f64), 1, mode="reflect")
    rows = p[:-2] + p[1:-1] + p[2:]
    return (rows[:, :-2] + rows[:, 1:-1] + rows[:, 2:]).astype(f32)


def strongest_corners(
    strength: np.ndarray, max_corners: int, quality_level: float, min_distance: float
) -> np.ndarray:
    """Return the strongest local maxima with a minimum distance, as ``cv2.goodFeaturesToTrack``.

    A corner is not on the image border, exceeds ``quality_level`` times the strongest pixel, and is
    a maximum of its 3x3 window (as are all pixels of a plateau). In order of decreasing strength,
    ties in reverse raster order, a corner is accepted unless an accepted one is nearer than
    ``min_distance``.

    Args:
        strength: Strengths ``(H, W)`` float32, from :func:`corner_strength`.
        max_corners: Maximum number of corners; 0 = no limit.
        quality_level: Minimum strength as a fraction of the strongest corner's.
        min_distance: Minimum distance between corners [pixel]; below 1: no minimum.

    Returns:
        Column and row ``(n, 2)`` int32, strongest first.
    """
    threshold = f32(f64(strength.max()) * quality_level)
    kept = np.where(strength > threshold, strength, f32(0))
    is_corner = (kept != 0) & (kept == _window_maximum(kept))
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
    """Suppress corners near an accepted stronger one (greedy non-maximum suppression)."""
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
