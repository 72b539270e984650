"""The floor of a frame in integers: lengths in depth units, angles in steps, tolerances.

Both backends look for it in these, see ``jaxdet/reference/_floor.py``.
"""

import math
from typing import NamedTuple

import numpy as np

from jaxdet.config import FloorConfig
from jaxdet.elementary import sin
from jaxdet.floor.plane import SLOPE_BITS, flat_plane
from jaxdet.types import GroundPlane, Refusal

ANGLES = 32  # steps of an angle in a degree: 0.03 degrees are 2 mm at 4 m
FARTHEST = 1 << 20  # heights and starts of ramps are at most so large [depth units]
SINE_BITS = 15  # fraction bits of sines; the product of two has 32 bits with its sign
_TURN = np.radians(np.arange(-360 * ANGLES, 370 * ANGLES + 1) / ANGLES)
SINES = np.rint(sin(_TURN) * (1 << SINE_BITS)).astype(np.int64)  # from -360 degrees on
STEEPEST = 85 * ANGLES  # largest pitch, up or down: beyond it roll means nothing
SLACK_BITS = 26  # fraction bits of what a tolerance has in proportion to depth
ROUGH_M, FINE_M, FINE_PER_Z = 0.012, 0.008, 0.003
"""Tolerances: roughness [m] where a plane is looked for and where it is known; and how much floors
and depth images are bowed, for each metre."""
SHARP_M, SHARP_PER_Z = 0.005, 0.0015
"""The same for the last steps, so that a book on a table moves nothing."""
PROFILE_M = 0.02  # the same for the first lattice of ramps, and beyond a step [m]
ROUGH_DEG = 0.5  # turns that a rough tolerance allows
LEVER_M = 0.008  # distances on the floor are measured so, to hold their squares
HEIGHTS_M = (0.05, 3.0)  # heights of a robot's or a hand-held camera
STEP_DEG = 3  # without a prior directions are tried so far apart at first, then a degree
BIN_M = 0.008  # heights are tried so far apart, a power of two of the depth unit
NEAR_M, STEEP_M = 0.10, 0.20
"""A plane is looked for so far from a guess: a robot rocks and mounts are wrong by less. And one
so far: where all that is seen is a ramp, it is that plane."""
RINGS_M = (0.6, 0.8, 1.1, 1.5, 2.0, 2.7)
"""Before a ramp, only the cells up to some distance tell the plane."""
STARTS_M = np.arange(0.4, 3.5, 0.2)  # distances at which a ramp is tried to begin
FINE_START_M = 0.05  # steps of the finer lattice
DROP_SPACING_M = 0.04  # steps are tried so far apart
ALIKE_M = 0.004  # planes whose heights differ by less are not both tried with steps
RUN_M, RISE_M = 0.064, 0.004
"""A cell of the profile; both are rounded to powers of two of the depth unit."""
FARTHEST_M, HIGHEST_M = 6.0, 1.3
"""Where the profile ends; what is lower is counted at its lower edge."""
RAMP_NEAR_M, SPREAD_M = 0.5, 0.4
"""A ramp must be seen this near to where it can be told from the plane, and over such a distance,
as the floor beyond a step; an obstacle's top or face is seen in one place."""
RAMP_M = 3.6  # a plane far from the prior is a ramp where it crosses the prior so near
STEP_M, TABLE_M = 0.05, 0.10
"""Cells so far above a plane are an obstacle's, cells so far below it show that it is no floor."""


class Slack(NamedTuple):
    """How far from a plane of height h its cells may lie: ``base + per_z z + noise z h``."""

    base: int  # roughness of a floor [depth units]
    per_z: int  # errors of direction and bowed floors, SLACK_BITS fraction bits
    noise: int
    """Stereo noise ``c z^2`` along a ray that meets the floor at the angle whose sine is h / z,
    ``SLACK_BITS`` fraction bits."""

    def of(self, z: np.ndarray, height: int) -> np.ndarray:
        """The tolerance at each depth, ``(K,)`` int64 [depth units], at least ``base``."""
        return self.base + ((z * (self.per_z + self.noise * max(height, 0))) >> SLACK_BITS)


class Scale(NamedTuple):
    """Lengths in depth units."""

    unit: float  # metres in one depth unit
    noise_per_m: float  # standard error of depth over its square [1/m]

    def length(self, metres: float) -> int:
        """Rounded, at least one."""
        return max(round(metres / self.unit), 1)

    def bits(self, metres: float) -> int:
        """The nearest power of two."""
        fraction, exponent = math.frexp(metres / self.unit)  # from 1/2 to 1
        return max(exponent - (fraction < math.sqrt(0.5)), 0)

    def slack(self, base_m: float, per_z: float) -> Slack:
        """A tolerance of so much, and so much more for each metre of depth."""
        one = 1 << SLACK_BITS
        noise = round(self.noise_per_m * self.unit * one)
        return Slack(self.length(base_m), round(per_z * one), noise)

    def rough(self, turn_deg: float) -> Slack:
        """The tolerance where a plane may be turned by so much."""
        return self.slack(ROUGH_M, float(np.radians(turn_deg)))

    def coarse(self, z: np.ndarray, step_deg: float) -> np.ndarray:
        """The tolerance of votes for directions so far apart, whatever the height, ``(K,)``."""
        slack = self.rough(step_deg / 2)
        return slack.of(z, 0) + ((z * z * slack.noise) >> SLACK_BITS)

    @property
    def fine(self) -> Slack:
        """The tolerance of floor cells from their own plane."""
        return self.slack(FINE_M, FINE_PER_Z)

    @property
    def sharp(self) -> Slack:
        """The tolerance of the last steps."""
        return self.slack(SHARP_M, SHARP_PER_Z)


class FloorFit(NamedTuple):
    """The floor of each frame."""

    plane: GroundPlane
    """``B`` planes: the frame's own, or where that was refused the prior."""
    own: np.ndarray
    """``(B,)`` bool, the frame's own depth decided."""
    share: np.ndarray
    """``(B,)`` float64, share of the cells on the frame's own best floor."""
    refused: np.ndarray
    """``(B,)`` int32, a :class:`Refusal`."""
    found: np.ndarray
    """``(B, 8)`` int32, what they are made of, see :func:`floor_fit`."""


def sine(angle: np.ndarray | int) -> np.ndarray:
    """Sines of angle steps within three quarters of a turn, ``SINE_BITS`` fraction bits."""
    return SINES[np.asarray(angle) + 360 * ANGLES]


def cosine(angle: np.ndarray | int) -> np.ndarray:
    """Cosines likewise."""
    return SINES[np.asarray(angle) + 450 * ANGLES]


def slopes(turn: np.ndarray) -> np.ndarray:
    """The tangents of angle steps, ``SLOPE_BITS`` fraction bits."""
    return (sine(turn) << SLOPE_BITS) // cosine(turn)


def stride(cells: int, config: FloorConfig) -> int:
    """Every so many of a frame's cells are used, in rows and columns."""
    return max(1, math.ceil(math.sqrt(cells / config.max_cells)))


def angle_steps(plane: GroundPlane) -> tuple[np.ndarray, np.ndarray]:
    """Pitch and roll of each frame in whole steps, ``(B,)`` int64; 0 where the floor is unknown."""
    pitch, roll = (
        np.rint(np.degrees(np.where(plane.valid, a, 0.0)) * ANGLES).astype(np.int64)
        for a in (plane.pitch, plane.roll)
    )
    return pitch, roll


def prior_units(prior: GroundPlane, scale: Scale) -> np.ndarray:
    """What is known of each frame's floor, rounded.

    Returns:
        ``(B, 4)`` int32: pitch and roll [angle steps], height [depth units] and valid; zeros
        where nothing is known.
    """
    pitch, roll = angle_steps(prior)
    roll = (roll + 180 * ANGLES) % (360 * ANGLES) - 180 * ANGLES
    height = np.rint(np.where(prior.valid, prior.height, 0.0) / scale.unit)
    parts = np.clip(pitch, -STEEPEST, STEEPEST), roll, np.clip(height, 1, FARTHEST)
    return np.stack([np.where(prior.valid, a, 0) for a in (*parts, 1)], axis=1).astype(np.int32)


def floor_fit(found: np.ndarray, prior: GroundPlane, unit: float) -> FloorFit:
    """The floor of each frame in metres and radians.

    Args:
        found: ``(B, 8)`` int32: pitch and roll [angle steps] and height [depth units] of the best
            plane; start [depth units] and turn [angle steps] of its ramp, turn 0 = none; cells on
            it, all cells, and a :class:`Refusal`.
        prior: ``B`` planes.
        unit: Metres in one depth unit.
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
