"""Stage 2, ground: which pixels are in range and above the floor (Section 3.3)."""

import numpy as np

from jaxdet.config import Config
from jaxdet.plane import depth_range, floor_limits
from jaxdet.types import AlignedDepth, Calibration, GroundPlane, Keep


def ground(
    aligned: AlignedDepth, plane: GroundPlane, calibration: Calibration, config: Config
) -> Keep:
    """Keeps pixels whose depth is in range and whose height is above the step height.

    A pixel is floor when its image row lies below the row of the plane at height
    ``h_0 = h - step``: for a level camera ``v - c_y >= f h_0 / z`` (Eq. 5), and for any tilt
    and roll when its height above the plane is less than the step height
    (:func:`jaxdet.plane.floor_limits`). A frame whose plane is unknown loses no floor.

    With a ``contour_radius`` r, a pixel within r rows and columns of a kept one is kept too and
    gets the nearest kept depth of that square.

    Args:
        aligned: Depth at the colour pixels; ``z`` is used.
        plane: The floor of each of the ``B`` frames.
        calibration: For the colour camera and the depth unit.
        config: Range, step height and contour radius of its ground part.

    Returns:
        The mask, True where the pixel may belong to an obstacle, the depth that a feature there
        gets, and whether a frame has any depth in range.
    """
    settings, unit = config.ground, calibration.depth_unit
    nearest, farthest = depth_range(settings.min_depth_m, settings.max_depth_m, unit)
    limits, which = floor_limits(calibration.color, plane, settings, unit)
    in_range = (aligned.z >= nearest) & (aligned.z <= farthest)
    mask, z = in_range & (aligned.z <= limits[which]), aligned.z
    if settings.contour_radius:
        nearest_kept = _window_minimum(np.where(mask, z, 65535), settings.contour_radius)
        mask = nearest_kept < 65535
        z = np.where(mask, nearest_kept, z)
    return Keep(mask, z.astype(np.uint16), in_range.any(axis=(1, 2)))


def _window_minimum(values: np.ndarray, radius: int) -> np.ndarray:
    """The least of ``values`` ``(B, H, W)`` in the square of ``radius`` around each pixel."""
    for axis in (1, 2):
        padding = [(0, 0)] * 3
        padding[axis] = (radius, radius)
        padded = np.pad(values, padding, constant_values=65535)
        shifted = [np.roll(padded, -d, axis) for d in range(2 * radius + 1)]
        least = np.minimum.reduce(shifted)
        values = np.take(least, np.arange(values.shape[axis]), axis)
    return values
