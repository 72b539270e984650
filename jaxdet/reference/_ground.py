"""Stage 3, ground: which features are in range and above the floor (Section 3.3)."""

import numpy as np

from jaxdet.config import Config
from jaxdet.floor.plane import depth_range, floor_limits
from jaxdet.types import Calibration, Features, GroundPlane


def ground(
    features: Features, plane: GroundPlane, calibration: Calibration, config: Config
) -> Features:
    """Keep features whose depth is in range and that are above the floor.

    Args:
        features: ``(B, N)``.
        plane: Floor of each of the ``B`` frames.
        calibration: For the colour camera and the depth unit.
        config: Range and step height of its ground part.

    Returns:
        The features, with ``kept``.
    """
    limits, which = floor_limits(calibration.image, plane, config.ground, calibration.depth_unit)
    limit = limits[which[:, None], features.v, features.u]
    kept = features.valid & _is_above(features.z, limit, calibration.depth_unit, config)
    return features._replace(kept=kept)


def above_floor(
    z: np.ndarray, plane: GroundPlane, calibration: Calibration, config: Config
) -> np.ndarray:
    """Return which pixels have a depth in range and are above the floor.

    A pixel is floor when its image row lies below the row of the plane at height
    ``h_0 = h - step``: for a level camera ``v - c_y >= f h_0 / z`` (Eq. 5), and for any tilt
    and roll when its height above the plane is less than the step height
    (:func:`jaxdet.floor.plane.floor_limits`). A frame whose plane is unknown loses no floor.

    Args:
        z: ``(B, H, W)`` uint16, z at the pixels of the colour image [depth units].
        plane: Floor of each of the ``B`` frames.
        calibration: For the colour camera and the depth unit.
        config: Range and step height of its ground part.

    Returns:
        ``(B, H, W)`` bool.
    """
    limits, which = floor_limits(calibration.image, plane, config.ground, calibration.depth_unit)
    return _is_above(z, limits[which], calibration.depth_unit, config)


def _is_above(z: np.ndarray, limit: np.ndarray, unit: float, config: Config) -> np.ndarray:
    nearest, farthest = depth_range(config.ground.min_depth_m, config.ground.max_depth_m, unit)
    return (z >= nearest) & (z <= farthest) & (z <= limit)
