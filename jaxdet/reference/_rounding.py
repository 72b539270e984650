"""Rounded quotients and products of integers."""

from typing import Any

import numpy as np

from jaxdet.camera import RAY_BITS


def rounded(a: Any, b: Any) -> Any:
    """Return ``a / b`` rounded, halves up, for integers or arrays of them; b positive."""
    return (2 * a + b) // (2 * b)


def lateral(ray: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Return ``ray * z`` rounded to depth units, halves up.

    Args:
        ray: Rays with ``RAY_BITS`` fraction bits, int32, any shape.
        z: Depth [depth units], int32, same shape.

    Returns:
        int32, same shape.

    Example:
        >>> half = np.array([1 << 19, -(1 << 19)], np.int32)
        >>> lateral(half, np.array([1001, 1001], np.int32)).tolist()
        [501, -500]
    """
    product = ray.astype(np.int64) * z
    return ((product + (1 << (RAY_BITS - 1))) >> RAY_BITS).astype(np.int32)
