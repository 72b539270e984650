"""Spatially correlated random images: smooth noise and patches."""

import cv2
import numpy as np


def smooth_noise(shape: tuple[int, ...], size_px: float, rng: np.random.Generator) -> np.ndarray:
    """Return normal noise ``shape`` float32 with unit variance, blurred by ``size_px`` [pixel]."""
    white = rng.standard_normal(shape, np.float32)
    if size_px <= 0:
        return white
    # A Gaussian divides the variance by about 4 pi size^2; the taps give the exact divisor.
    taps = cv2.getGaussianKernel(2 * int(3 * size_px + 0.5) + 1, size_px)
    return cv2.sepFilter2D(white, -1, taps, taps) / np.float32((taps**2).sum())


def patches(shape: tuple[int, ...], size_px: int, rng: np.random.Generator) -> np.ndarray:
    """Return normal noise ``shape`` float32 in patches slightly larger than ``size_px`` [pixel]."""
    small = smooth_noise((shape[0] // size_px + 1, shape[1] // size_px + 1), 0.7, rng)
    return cv2.resize(small, shape[::-1], interpolation=cv2.INTER_LINEAR)


def chosen(share: np.ndarray | float, values: np.ndarray) -> np.ndarray:
    """Draw a bool mask with the spatial correlation of ``values``.

    Args:
        share: Probability that a pixel is True, a number or an array of the shape of ``values``.
        values: Normal noise, as from :func:`patches`. Its cumulative distribution is approximated
            within 0.01 by a logistic function.
    """
    standard = (values - values.mean()) / max(float(values.std()), 1e-6)
    return 1 / (1 + np.exp(-1.702 * standard)) < share
