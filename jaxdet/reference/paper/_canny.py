"""Grey conversion and Canny's edge detector, written out as OpenCV computes them."""

import numpy as np


def grey(color: np.ndarray) -> np.ndarray:
    """Compute the luma of an RGB image, rounded as in ``cv2.cvtColor(color, cv2.COLOR_RGB2GRAY)``.

    ``(9798 R + 19235 G + 3735 B + 2^14) >> 15``; holds for all 2^24 colours.

    Args:
        color: Image ``(H, W, 3)`` uint8, RGB.

    Returns:
        Grey image ``(H, W)`` uint8.

    Example:
        >>> grey(np.array([[[255, 0, 0], [10, 10, 10]]], np.uint8)).tolist()
        [[76, 10]]
    """
    r, g, b = (color[..., c].astype(np.int32) for c in range(3))
    return ((9798 * r + 19235 * g + 3735 * b + (1 << 14)) >> 15).astype(np.uint8)


def canny(image: np.ndarray, low: float, high: float) -> np.ndarray:
    """Detect Canny edges with a 3x3 Sobel and the L1 norm, as ``cv2.Canny(image, low, high)``.

    All arithmetic is integer, and the image is not blurred. Pixels whose gradient magnitude
    ``|dx| + |dy|`` is above ``low`` and a maximum across the edge are candidates; edges are the
    8-connected groups of candidates with at least one magnitude above ``high`` (hysteresis).

    Args:
        image: Grey image ``(H, W)`` uint8.
        low: Lower threshold; the thresholds are swapped if reversed, and rounded down.
        high: Upper threshold.

    Returns:
        Image ``(H, W)`` uint8, 255 on edges and 0 elsewhere.
    """
    low, high = np.floor(min(low, high)), np.floor(max(low, high))
    dx, dy = _sobel(image)
    magnitude = np.abs(dx) + np.abs(dy)
    candidate = (magnitude > low) & _is_ridge(dx, dy, magnitude)
    strong = candidate & (magnitude > high)
    return np.where(_connected_to(strong, candidate), np.uint8(255), np.uint8(0))


def _sobel(image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute the 3x3 Sobel derivatives with replicated borders; ``(H, W)`` int32 each."""
    p = np.pad(image.astype(np.int32), 1, mode="edge")
    smooth_rows = p[:-2] + 2 * p[1:-1] + p[2:]
    smooth_columns = p[:, :-2] + 2 * p[:, 1:-1] + p[:, 2:]
    return smooth_rows[:, 2:] - smooth_rows[:, :-2], smooth_columns[2:] - smooth_columns[:-2]


def _is_ridge(dx: np.ndarray, dy: np.ndarray, magnitude: np.ndarray) -> np.ndarray:
    """Suppress non-maxima, in three sectors bounded by 22.5 and 67.5 degrees.

    The tangents are fixed point with 15 bits (13573 = tan 22.5); ties go to the left or upper
    pixel, except on diagonals, where both neighbours must be strictly smaller.
    """
    x, y = np.abs(dx), np.abs(dy) << 15
    tan22 = x * 13573
    tan67 = tan22 + (x << 16)
    m = np.pad(magnitude, 1)
    height, width = magnitude.shape

    def at(rows: int, columns: int) -> np.ndarray:
        return m[1 + rows : 1 + rows + height, 1 + columns : 1 + columns + width]

    horizontal = (magnitude > at(0, -1)) & (magnitude >= at(0, 1))
    vertical = (magnitude > at(-1, 0)) & (magnitude >= at(1, 0))
    falling = (magnitude > at(-1, -1)) & (magnitude > at(1, 1))
    rising = (magnitude > at(-1, 1)) & (magnitude > at(1, -1))
    diagonal = np.where((dx ^ dy) < 0, rising, falling)
    return np.where(y < tan22, horizontal, np.where(y > tan67, vertical, diagonal))


def _connected_to(seeds: np.ndarray, allowed: np.ndarray) -> np.ndarray:
    """Return the ``allowed`` pixels 8-connected to a seed (hysteresis), by breadth-first search."""
    width = allowed.shape[1] + 2
    free = np.pad(allowed & ~seeds, 1).reshape(-1)
    reached = np.pad(seeds, 1).reshape(-1)
    around = np.array([-width - 1, -width, -width + 1, -1, 1, width - 1, width, width + 1])
    front = np.flatnonzero(reached)
    while front.size:
        neighbours = (front[:, None] + around).reshape(-1)
        front = np.unique(neighbours[free[neighbours]])
        free[front] = False
        reached[front] = True
    return reached.reshape(-1, width)[1:-1, 1:-1]
