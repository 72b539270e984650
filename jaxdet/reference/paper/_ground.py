"""Stage 3, ground: selection of features in range and above the floor (Section 3.3)."""

import numpy as np

from jaxdet.config import Config
from jaxdet.floor.plane import depth_range, floor_limits
from jaxdet.types import Calibration, Features, GroundPlane


def ground(
    features: Features, plane: GroundPlane, calibration: Calibration, config: Config
) -> Features:
    """Keep features whose depth is in range and that are above the floor.

    Args:
        features: Features ``(B, N)``.
        plane: Floor of each of the ``B`` frames.
        calibration: Calibration with the colour camera and the depth unit.
        config: Configuration with the range and the step height.

    Returns:
        The features with ``kept`` set.
    """
    limits, which = floor_limits(calibration.image, plane, config.ground, calibration.depth_unit)
    limit = limits[which[:, None], features.v, features.u]
    kept = features.valid & _is_above(features.z, limit, calibration.depth_unit, config)
    return features._replace(kept=kept)


def above_floor(
    z: np.ndarray, plane: GroundPlane, calibration: Calibration, config: Config
) -> np.ndarray:
    """Return whether each pixel has a depth in range and is above the floor.

    A pixel is floor if its image row is below the row of the plane at height ``h_0 = h - step``:
    for a level camera ``v - c_y >= f h_0 / z`` (Eq. 5), and for any pitch and roll if its height
    above the plane is less than the step height (:func:`jaxdet.floor.plane.floor_limits`). In a
    frame with an unknown plane no pixel is floor.

    Args:
        z: Depth at the pixels of the colour image, ``(B, H, W)`` uint16 [depth units].
        plane: Floor of each of the ``B`` frames.
        calibration: Calibration with the colour camera and the depth unit.
        config: Configuration with the range and the step height.

    Returns:
        Mask ``(B, H, W)`` bool.
    """
    limits, which = floor_limits(calibration.image, plane, config.ground, calibration.depth_unit)
    return _is_above(z, limits[which], calibration.depth_unit, config)


def _is_above(z: np.ndarray, limit: np.ndarray, unit: float, config: Config) -> np.ndarray:
    nearest, farthest = depth_range(config.ground.min_depth_m, config.ground.max_depth_m, unit)
    return (z >= nearest) & (z <= farthest) & (z <= limit)
