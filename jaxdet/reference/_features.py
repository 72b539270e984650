"""Stage 3, features: corners of the edge image, with depth (Section 3.2)."""

import numpy as np

from jaxdet.camera import RAY_BITS, fixed_rays
from jaxdet.config import FeaturesConfig
from jaxdet.reference._canny import canny, grey
from jaxdet.reference._corners import corner_strength, strongest_corners
from jaxdet.types import Calibration, Features, Keep


def features(
    color: np.ndarray,
    keep: Keep,
    calibration: Calibration,
    config: FeaturesConfig,
) -> Features:
    """Finds the strongest Shi-Tomasi corners of the Canny edge image and looks up their depth.

    With ``config.use_mask`` corners are taken only where ``keep`` allows, so that floor texture
    and far clutter don't use up the slots; else (the paper's order) points are dropped after
    the selection. ``x = (u - c_x) z / f_x`` and y likewise, undistorted, rounded to whole depth
    units (:func:`lateral`).

    Args:
        color: ``(B, H, W, 3)`` uint8, RGB.
        keep: Where corners may be, and the depth there, from the ground stage.
        calibration: For the colour camera.
        config: Canny's bounds and the corner selection.

    Returns:
        ``N = config.max_corners`` slots a frame; empty slots are zero.
    """
    slots = [
        _corners(image, mask if config.use_mask else None, config)
        for image, mask in zip(color, keep.mask, strict=True)
    ]
    batch, n = len(color), config.max_corners
    u, v = np.zeros((batch, n), np.int32), np.zeros((batch, n), np.int32)
    valid = np.zeros((batch, n), bool)
    overflow = np.array([len(corners) > n for corners in slots], bool)
    for b, corners in enumerate(slots):
        count = min(len(corners), n)
        u[b, :count], v[b, :count] = corners[:count].T
        valid[b, :count] = True
    frame = np.arange(batch)[:, None]
    z = np.where(valid, keep.z[frame, v, u], 0).astype(np.int32)
    ray_x, ray_y = fixed_rays(calibration.image)
    return Features(
        u=u,
        v=v,
        x=lateral(ray_x[v, u], z),
        y=lateral(ray_y[v, u], z),
        z=z,
        valid=valid,
        kept=valid & keep.mask[frame, v, u],
        overflow=overflow,
    )


def _corners(image: np.ndarray, mask: np.ndarray | None, config: FeaturesConfig) -> np.ndarray:
    """The corners of one frame, one more than there are slots; ``(n, 2)`` int32 column, row."""
    edges = canny(grey(image), config.canny_low, config.canny_high)
    return strongest_corners(
        corner_strength(edges),
        mask,
        config.max_corners + 1,
        config.quality_level,
        config.min_distance,
    )


def lateral(ray: np.ndarray, z: np.ndarray) -> np.ndarray:
    """``ray * z`` in whole depth units, halves up.

    Args:
        ray: int32 with ``RAY_BITS`` fraction bits, any shape.
        z: int32, depth units, same shape.

    Returns:
        int32, same shape.

    Example:
        >>> half = np.array([1 << 19, -(1 << 19)], np.int32)
        >>> lateral(half, np.array([1001, 1001], np.int32)).tolist()
        [501, -500]
    """
    product = ray.astype(np.int64) * z
    return ((product + (1 << (RAY_BITS - 1))) >> RAY_BITS).astype(np.int32)
