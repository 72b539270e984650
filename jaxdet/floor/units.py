"""Integer units of the floor estimation: lengths in depth units, angles in steps, tolerances.

Both backends use them, see ``jaxdet/reference/_floor.py``.
"""

import math
from typing import NamedTuple, TypeVar

import numpy as np

from jaxdet.config import FloorConfig
from jaxdet.elementary import sin
from jaxdet.floor.plane import SLOPE_BITS, flat_plane
from jaxdet.types import GroundPlane, Refusal

Angle = TypeVar("Angle", int, np.ndarray)
ANGLES = 32  # angle steps per degree: 0.03 degrees are 2 mm at 4 m
FARTHEST = 1 << 20  # maximum height, and start of a ramp [depth units]
SINE_BITS = 15  # fraction bits of sines; the product of two fits in 32 bits
_TURN = np.radians(np.arange(-360 * ANGLES, 370 * ANGLES + 1) / ANGLES)
SINES = np.rint(sin(_TURN) * (1 << SINE_BITS)).astype(np.int64)  # from -360 degrees on
STEEPEST = 85 * ANGLES  # maximum pitch, up or down; beyond it roll is meaningless
TOLERANCE_BITS = 26  # fraction bits of the terms of a tolerance that grow with depth
ROUGH_M, FINE_M, FINE_PER_Z = 0.012, 0.008, 0.003
"""Inlier tolerances: roughness of the floor during the search and near a known plane [m], and
bowing of floors and depth images per metre of depth."""
SHARP_M, SHARP_PER_Z = 0.005, 0.0015
"""Inlier tolerances in the last steps of the search: roughness [m], and bowing per metre of depth.
They are small, so that a book on a table has no influence."""
PROFILE_M = 0.02  # roughness on the first lattice of ramps, and beyond a step [m]
ROUGH_DEG = 0.5  # error of direction that a rough tolerance covers
LEVER_M = 0.008  # unit of distances on the floor, so that their squares fit in integers [m]
HEIGHTS_M = (0.05, 3.0)  # minimum and maximum height of a robot's or a hand-held camera [m]
STEP_DEG = 3  # first spacing of directions without a prior [degree]; the next one is a degree
BIN_M = 0.008  # spacing of heights [m], rounded to a power of two depth units
NEAR_M, STEEP_M = 0.10, 0.20
"""Search range of a plane's height [m]: for a rocking robot and errors of the mount; and for frames
that show only a ramp."""
RINGS_M = (0.6, 0.8, 1.1, 1.5, 2.0, 2.7)
"""Maximum distances of the cells used for the plane in front of a ramp [m]."""
STARTS_M = np.arange(0.4, 3.5, 0.2)  # candidate distances at which a ramp begins [m]
FINE_START_M = 0.05  # spacing of these distances on the finer lattice [m]
DROP_SPACING_M = 0.04  # spacing of candidate distances of a step [m]
ALIKE_M = 0.004  # if the heights of planes differ by less, only one is searched for steps [m]
RUN_M, RISE_M = 0.064, 0.004
"""Length and height of a bin of the profile [m], rounded to powers of two depth units."""
FARTHEST_M, HIGHEST_M = 6.0, 1.3
"""Maximum distance of the profile, and maximum height above and below the plane [m]; lower cells
are counted in the lowest bin."""
RAMP_NEAR_M, SPREAD_M = 0.5, 0.4
"""Maximum distance from the start of a ramp at which it must be visible, and minimum length over
which it must be visible [m]; the same holds for the floor beyond a step. The top or the face of an
obstacle is visible only in one place."""
RAMP_M = 3.6  # maximum distance at which a ramp far from the prior crosses the prior [m]
STEP_M, TABLE_M = 0.05, 0.10
"""Height above a plane from which cells are obstacles, and depth below the plane from which cells
show that the plane is not the floor [m]."""
DEEP_M = 0.25  # TABLE_M for a plane that ends at a step, if there is no prior
OVER_TABLE_M = 2.0
"""Maximum height of a camera above the floor on which a table stands; where the floor beyond a step
is farther below the camera, the step is a drop and not the edge of a table."""


class Tolerance(NamedTuple):
    """Maximum distance of inliers from a plane of height h: ``base + per_z z + noise z h``."""

    base: int  # roughness of a floor [depth units]
    per_z: int  # errors of direction and bowed floors, TOLERANCE_BITS fraction bits
    noise: int
    """Stereo noise ``c z^2`` along a ray that meets the floor at an angle with the sine h / z;
    ``TOLERANCE_BITS`` fraction bits."""

    def of(self, z: np.ndarray, height: int) -> np.ndarray:
        """Return the tolerance at each depth, ``(K,)`` int64 [depth units], at least ``base``."""
        return self.base + ((z * (self.per_z + self.noise * max(height, 0))) >> TOLERANCE_BITS)


class Scale(NamedTuple):
    """Conversion of lengths and tolerances to depth units."""

    unit: float  # metres per depth unit
    noise_per_m: float  # standard deviation of depth divided by depth squared [1/m]

    def length(self, metres: float) -> int:
        """Return a length rounded to depth units, at least one."""
        return max(round(metres / self.unit), 1)

    def bits(self, metres: float) -> int:
        """Return the exponent of the power of two nearest to a length in depth units."""
        fraction, exponent = math.frexp(metres / self.unit)  # from 1/2 to 1
        return max(exponent - (fraction < math.sqrt(0.5)), 0)

    def tolerance(self, base_m: float, per_z: float) -> Tolerance:
        """Return a tolerance of ``base_m``, plus ``per_z`` per metre of depth."""
        one = 1 << TOLERANCE_BITS
        noise = round(self.noise_per_m * self.unit * one)
        return Tolerance(self.length(base_m), round(per_z * one), noise)

    def rough(self, turn_deg: float) -> Tolerance:
        """Return the tolerance for a plane with an error of direction of ``turn_deg``."""
        return self.tolerance(ROUGH_M, float(np.radians(turn_deg)))

    def coarse(self, z: np.ndarray, step_deg: float) -> np.ndarray:
        """Return the tolerance ``(K,)`` of votes for planes whose directions are a step apart.

        The tolerance holds for planes of any height.
        """
        tolerance = self.rough(step_deg / 2)
        return tolerance.of(z, 0) + ((z * z * tolerance.noise) >> TOLERANCE_BITS)

    @property
    def fine(self) -> Tolerance:
        """Tolerance of floor cells from their own plane."""
        return self.tolerance(FINE_M, FINE_PER_Z)

    @property
    def sharp(self) -> Tolerance:
        """Tolerance in the last steps of the search."""
        return self.tolerance(SHARP_M, SHARP_PER_Z)


class FloorFit(NamedTuple):
    """Floor of each frame."""

    plane: GroundPlane
    """Planes of ``B`` frames: the frame's own floor, or the prior if the own floor was refused."""
    own: np.ndarray
    """Whether the frame's own depth determined the plane, ``(B,)`` bool."""
    share: np.ndarray
    """Inlier fraction of the frame's own best floor, ``(B,)`` float64."""
    refused: np.ndarray
    """Reason of refusal, ``(B,)`` int32, a :class:`Refusal`."""
    found: np.ndarray
    """Integers ``(B, 8)`` int32 from which the other fields are computed, see :func:`floor_fit`."""


def sine(angle: np.ndarray | int) -> np.ndarray:
    """Return sines of angle steps within ±270 degrees, ``SINE_BITS`` fraction bits."""
    return SINES[np.asarray(angle) + 360 * ANGLES]


def cosine(angle: np.ndarray | int) -> np.ndarray:
    """Return cosines of angle steps within ±270 degrees, ``SINE_BITS`` fraction bits."""
    return SINES[np.asarray(angle) + 450 * ANGLES]


def wrapped(angle: Angle) -> Angle:
    """Return angle steps wrapped to -180 degrees or more, and less than 180."""
    return (angle + 180 * ANGLES) % (360 * ANGLES) - 180 * ANGLES


def slopes(turn: np.ndarray) -> np.ndarray:
    """Return tangents of angle steps, ``SLOPE_BITS`` fraction bits."""
    return (sine(turn) << SLOPE_BITS) // cosine(turn)


def stride(cells: int, config: FloorConfig) -> int:
    """Return the subsampling stride of a frame's cells, in rows and columns."""
    return max(1, math.ceil(math.sqrt(cells / config.max_cells)))


def angle_steps(plane: GroundPlane) -> tuple[np.ndarray, np.ndarray]:
    """Return pitch and roll of each frame in angle steps, ``(B,)`` int64; 0 if unknown."""
    pitch, roll = (
        np.rint(np.degrees(np.where(plane.valid, a, 0.0)) * ANGLES).astype(np.int64)
        for a in (plane.pitch, plane.roll)
    )
    return pitch, roll


def prior_units(prior: GroundPlane, scale: Scale) -> np.ndarray:
    """Return the prior of each frame's floor in integers.

    Returns:
        Pitch and roll [angle steps], height [depth units] and valid, ``(B, 4)`` int32; zeros
        without a prior.
    """
    pitch, roll = angle_steps(prior)
    height = np.rint(np.where(prior.valid, prior.height, 0.0) / scale.unit)
    parts = np.clip(pitch, -STEEPEST, STEEPEST), wrapped(roll), np.clip(height, 1, FARTHEST)
    return np.stack([np.where(prior.valid, a, 0) for a in (*parts, 1)], axis=1).astype(np.int32)


def floor_fit(found: np.ndarray, prior: GroundPlane, unit: float) -> FloorFit:
    """Convert the floor of each frame to metres and radians.

    Args:
        found: Result of the search, ``(B, 8)`` int32: pitch and roll [angle steps] and height
            [depth units] of the best plane; distance at which its ramp starts [depth units] and
            angle of the ramp to the plane [angle steps], 0 = no ramp; number of inliers; number of
            all cells; and a :class:`Refusal`.
        prior: ``B`` planes.
        unit: Metres per depth unit.
    """
    pitch, roll = np.radians(found[:, :2].astype(np.float64) / ANGLES).T
    start, turn = found[:, 3].astype(np.float64), found[:, 4]
    mine = flat_plane(found[:, 2].astype(np.float64) * unit, pitch, roll)._replace(
        ramp_start=np.where(turn != 0, start * unit, np.inf),
        ramp_slope=np.where(turn != 0, slopes(turn) / (1 << SLOPE_BITS), 0.0),
    )
    own = found[:, 7] == Refusal.NONE
    plane = GroundPlane(*(np.where(own, a, b) for a, b in zip(mine, prior, strict=True)))
    share = found[:, 5].astype(np.float64) / np.maximum(found[:, 6], 1)
    return FloorFit(plane, own, share, found[:, 7].astype(np.int32), found)
