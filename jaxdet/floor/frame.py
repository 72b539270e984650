"""Floor frames in integers: position of points on the floor, and height above it.

Angles are integer steps, :data:`jaxdet.floor.units.ANGLES` per degree, and sines come from a table,
so that all further operations are sums, products and shifts of integers.
"""

import numpy as np

from jaxdet.floor.units import FARTHEST, SINE_BITS, angle_steps, cosine, sine, wrapped
from jaxdet.types import GroundPlane

FRAME_BITS = 13  # fraction bits of the axes of a floor frame
FLOOR_VALUES = 13
"""Number of integers of a floor frame: right, forward and down in the camera frame (three each,
``FRAME_BITS`` fraction bits), height of the optical centre [depth units], whether the floor is
known, start of a ramp [depth units], and its slope (``FRAME_BITS`` fraction bits)."""
DOWN, CAMERA_HEIGHT, IS_KNOWN = slice(6, 9), 9, 10
"""Indices of the down vector, the height, and whether the floor is known."""
UNKNOWN_HEIGHT = 1 << 20  # height of every point if the floor is unknown [depth units]
STEEPEST_SLOPE = 8  # maximum slope of a ramp, rise over run


def floor_frames(plane: GroundPlane, depth_unit: float) -> np.ndarray:
    """Return the floor of each frame as integers.

    With pitch p and roll r rounded to whole steps, right is ``(cos r, -sin r, 0)``, forward
    ``(-sin r sin p, -cos r sin p, cos p)`` and down ``(sin r cos p, cos r cos p, sin p)``.

    Args:
        plane: ``B`` planes; if a plane is unknown, a level camera is assumed.
        depth_unit: Metres per depth unit.

    Returns:
        Floor frames ``(B, FLOOR_VALUES)`` int32.

    Example:
        >>> from jaxdet.floor.plane import flat_plane
        >>> level = flat_plane(np.array([0.5]), np.zeros(1), np.zeros(1))
        >>> floor_frames(level, 0.001)[0].tolist()
        [8192, 0, 0, 0, 0, 8192, 0, 8192, 0, 500, 1, 0, 0]
    """
    valid, (pitch, roll) = np.asarray(plane.valid, bool), angle_steps(plane)
    ramps = valid & np.isfinite(plane.ramp_start)
    start, slope = (np.where(ramps, a, 0.0) for a in (plane.ramp_start, plane.ramp_slope))
    slope = np.clip(slope, -STEEPEST_SLOPE, STEEPEST_SLOPE)
    lengths = (np.where(valid, plane.height, 0.0), start)
    height, start = (
        np.clip(np.rint(a / depth_unit), -FARTHEST, FARTHEST).astype(np.int64) for a in lengths
    )
    slope = np.floor(slope * (1 << FRAME_BITS) + 0.5).astype(np.int64)
    values = [*axes(pitch, roll), height, valid, start, slope]
    return np.stack(np.broadcast_arrays(*values), axis=1).astype(np.int32)


def axes(pitch: np.ndarray, roll: np.ndarray) -> list[np.ndarray | int]:
    """Return right, forward and down in the camera frame, with ``FRAME_BITS`` fraction bits.

    Args:
        pitch: Pitch ``(B,)`` integer [angle steps].
        roll: Roll ``(B,)`` integer [angle steps].

    Returns:
        Nine components, each ``(B,)`` or 0.
    """
    sin_p, cos_p, sin_r, cos_r = (
        function(wrapped(angle)) for angle in (pitch, roll) for function in (sine, cosine)
    )

    def product(a: np.ndarray, b: np.ndarray | int = 1 << SINE_BITS) -> np.ndarray:
        bits = 2 * SINE_BITS - FRAME_BITS
        return (a * b + (1 << (bits - 1))) >> bits

    right = [product(cos_r), product(-sin_r), 0]
    forward = [product(-sin_r, sin_p), product(-cos_r, sin_p), product(cos_p)]
    return [*right, *forward, product(sin_r, cos_p), product(cos_r, cos_p), product(sin_p)]


def on_floor(frame: np.ndarray, xyz: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Project points onto the floor, and compute their height above it.

    A ramp raises the floor by its slope times the distance of a point beyond the ramp's start.

    Args:
        frame: Floor frame ``(FLOOR_VALUES,)`` int32, from :func:`floor_frames`.
        xyz: Points ``(3, ...)`` int64, camera optical frame [depth units].

    Returns:
        Right, forward and height, each ``(...)`` int64, rounded to depth units; the height is
        ``UNKNOWN_HEIGHT`` if the floor is unknown.
    """
    values = frame.astype(np.int64)
    along = np.tensordot(values[:9].reshape(3, 3), xyz, axes=1)
    right, forward, drop = (along + (1 << (FRAME_BITS - 1))) >> FRAME_BITS
    height, valid, start, slope = values[9:].tolist()
    if not valid:
        return right, forward, np.full_like(drop, UNKNOWN_HEIGHT)
    rise = (np.maximum(forward - start, 0) * slope) >> FRAME_BITS
    return right, forward, height - drop - rise
