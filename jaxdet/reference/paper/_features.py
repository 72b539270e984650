"""Stage 2, features: corners of the edge image, with depth (Section 3.2)."""

import numpy as np

from jaxdet.camera import fixed_rays
from jaxdet.config import FeaturesConfig
from jaxdet.reference._rounding import lateral
from jaxdet.reference.paper._align import align
from jaxdet.reference.paper._canny import canny, grey
from jaxdet.reference.paper._corners import corner_strength, strongest_corners
from jaxdet.types import Calibration, Features


def features(
    color: np.ndarray, depth: np.ndarray, calibration: Calibration, config: FeaturesConfig
) -> Features:
    """Find the strongest Shi-Tomasi corners of the Canny edge image and look up their depth.

    ``x = (u - c_x) z / f_x`` and ``y = (v - c_y) z / f_y``, undistorted, rounded to depth units
    (:func:`lateral`).

    Args:
        color: Images ``(B, H, W, 3)`` uint8, RGB.
        depth: Depth images ``(B, Hd, Wd)`` uint16 [depth units], 0 = no measurement.
        calibration: Calibration of the log.
        config: Thresholds of Canny and the corner selection.

    Returns:
        ``N = config.max_corners`` slots per frame; empty slots are zero. All features are ``kept``.
    """
    batch, n = len(color), config.max_corners
    u, v = np.zeros((batch, n), np.int32), np.zeros((batch, n), np.int32)
    valid, overflow = np.zeros((batch, n), bool), np.zeros(batch, bool)
    for b, image in enumerate(color):
        corners = _corners(image, config)
        count = min(len(corners), n)
        u[b, :count], v[b, :count] = corners[:count].T
        valid[b, :count] = True
        overflow[b] = len(corners) > n
    z_image = align(depth, calibration).z
    z = np.where(valid, z_image[np.arange(batch)[:, None], v, u], 0).astype(np.int32)
    ray_x, ray_y = fixed_rays(calibration.image)
    x, y = lateral(ray_x[v, u], z), lateral(ray_y[v, u], z)
    return Features(u, v, x, y, z, valid=valid, kept=valid, overflow=overflow)


def _corners(image: np.ndarray, config: FeaturesConfig) -> np.ndarray:
    """Return column and row of the corners, ``(n, 2)`` int32, at most ``max_corners`` + 1."""
    edges = canny(grey(image), config.canny_low, config.canny_high)
    return strongest_corners(
        corner_strength(edges), config.max_corners + 1, config.quality_level, config.min_distance
    )
