"""Stage 2, ground: which pixels are in range and above the floor (Section 3.3)."""

from jaxdet.config import Config
from jaxdet.floor.plane import depth_range, floor_limits
from jaxdet.types import AlignedDepth, Calibration, GroundPlane, Keep


def ground(
    aligned: AlignedDepth, plane: GroundPlane, calibration: Calibration, config: Config
) -> Keep:
    """Keeps pixels whose depth is in range and whose height is above the step height.

    A pixel is floor when its image row lies below the row of the plane at height
    ``h_0 = h - step``: for a level camera ``v - c_y >= f h_0 / z`` (Eq. 5), and for any tilt
    and roll when its height above the plane is less than the step height
    (:func:`jaxdet.floor.plane.floor_limits`). A frame whose plane is unknown loses no floor.

    Args:
        aligned: Depth at the colour pixels; ``z`` is used.
        plane: The floor of each of the ``B`` frames.
        calibration: For the colour camera and the depth unit.
        config: Range and step height of its ground part.

    Returns:
        The mask, True where the pixel may belong to an obstacle, the depth that a feature there
        gets, and whether a frame has any depth in range.
    """
    settings, unit = config.ground, calibration.depth_unit
    nearest, farthest = depth_range(settings.min_depth_m, settings.max_depth_m, unit)
    limits, which = floor_limits(calibration.image, plane, settings, unit)
    in_range = (aligned.z >= nearest) & (aligned.z <= farthest)
    mask = in_range & (aligned.z <= limits[which])
    return Keep(mask, aligned.z, in_range.any(axis=(1, 2)))
