"""Floor planes, and their refinement by least squares, in integers.

Angles are integer multiples of 1/:data:`ANGLES` degree and directions have ``DOWN_BITS`` fraction
bits, both from tables of sines. Each operation is a sum, product, shift or division of integers.
"""

from typing import NamedTuple

import numpy as np

from jaxdet.floor.units import (
    ANGLES,
    LEVER_M,
    ROUGH_DEG,
    SINE_BITS,
    STEEPEST,
    Scale,
    Tolerance,
    cosine,
    sine,
    wrapped,
)
from jaxdet.reference._rounding import rounded

DOWN_BITS = 12  # fraction bits of a direction; products with positions fit in 32 bits
RADIAN = round(180 * ANGLES / np.pi)  # angle steps in a radian
LARGEST_TURN = 8 * ANGLES  # maximum rotation of a plane per round of refinement
BELOW = 4  # cells this many tolerances below a plane are clearly below it
BELOW_COST = 2  # votes that such a cell costs: nothing is visible through a floor
TURN_BITS = 24
"""Maximum number of bits of the sums that the refinement multiplies, so that the sum of two
products times an angle fits in 64 bits."""
RIDGE = 14
"""Ridge of the least squares per unit of weight, 3 cm squared in levers of 8 mm: floor that extends
only over a few centimetres must not determine the tilt."""


class Sample(NamedTuple):
    """Measured cells, at most some thousands."""

    xyz: np.ndarray  # (K, 3) int64, camera optical frame [depth units]
    inner: np.ndarray  # (K,) bool, between the left and the right margin of the image

    @property
    def z(self) -> np.ndarray:
        """Depth ``(K,)`` int64 [depth units]."""
        return self.xyz[:, 2]

    def take(self, which: np.ndarray) -> "Sample":
        """Return the cells of a mask ``(K,)``."""
        return Sample(self.xyz[which], self.inner[which])


class Plane(NamedTuple):
    """Plane in integer angle steps and depth units."""

    pitch: int
    roll: int
    height: int


def down_units(pitch: np.ndarray | int, roll: np.ndarray | int) -> np.ndarray:
    """Return down vectors ``(..., 3)`` int64 with ``DOWN_BITS`` fraction bits."""
    level = cosine(pitch)
    parts = sine(roll) * level, cosine(roll) * level, sine(pitch) << SINE_BITS
    bits = 2 * SINE_BITS - DOWN_BITS
    return (np.stack(np.broadcast_arrays(*parts), axis=-1) + (1 << (bits - 1))) >> bits


def floor_axes(plane: Plane) -> np.ndarray:
    """Return right, down and forward of a plane with ``DOWN_BITS`` fraction bits, ``(3, 3)`` int64.

    Forward is the derivative of down with respect to pitch; right times the cosine of pitch is the
    derivative of down with respect to roll.
    """
    quarter = 90 * ANGLES
    pitch = np.array([0, plane.pitch, plane.pitch + quarter])
    return down_units(pitch, np.array([plane.roll + quarter, plane.roll, plane.roll]))


def along(directions: np.ndarray, cells: Sample) -> np.ndarray:
    """Return positions along directions ``(..., 3)``, rounded, ``(..., K)`` int64 [depth units]."""
    return (directions @ cells.xyz.T + (1 << (DOWN_BITS - 1))) >> DOWN_BITS


def below(plane: Plane, cells: Sample) -> np.ndarray:
    """Return the distance of cells below a plane, ``(K,)`` int64 [depth units]."""
    return along(down_units(plane.pitch, plane.roll), cells) - plane.height


def score(below: np.ndarray, slack: np.ndarray) -> np.ndarray:
    """Count inliers minus ``BELOW_COST`` times the cells clearly below, over the last axis."""
    on = np.count_nonzero(np.abs(below) <= slack, axis=-1)
    return on - BELOW_COST * np.count_nonzero(below > BELOW * slack, axis=-1)


def refined(
    plane: Plane, cells: Sample, rounds: tuple[int, int, int], prior: Plane | None, scale: Scale
) -> Plane:
    """Apply :func:`refine` with a rough, a fine and a sharp tolerance.

    Args:
        plane: Initial plane.
        cells: ``K`` cells.
        rounds: Number of rounds with each tolerance.
        prior: Prior of the angles, or None.
        scale: Depth unit and noise of depth.
    """
    for slack, count in zip((scale.rough(ROUGH_DEG), scale.fine, scale.sharp), rounds, strict=True):
        plane = refine(plane, cells, slack, count, prior, scale.bits(LEVER_M))
    return plane


def refine(
    plane: Plane, cells: Sample, slack: Tolerance, rounds: int, prior: Plane | None, lever_bits: int
) -> Plane:
    """Refine a plane by weighted least squares on the cells near it, in a fixed number of rounds.

    Let ``e`` be the distance of a cell below the plane, ``t`` its distance forward and ``s`` to the
    right, each minus its mean. The rotations a, b that minimise ``sum w (e + a t + b s)^2`` solve
    two equations by Cramer's rule. ``RIDGE`` is added to the sums of ``t^2`` and ``s^2``, so that a
    rotation that the cells do not determine leads to the prior or, without a prior, is zero. The
    sums are exact in 64 bits and shifted to ``TURN_BITS`` before they are multiplied, so all
    products are exact too.

    Args:
        plane: Initial plane; it is returned unchanged if fewer than 20 cells are near, or if all
            near cells have weight zero.
        cells: ``K`` cells.
        slack: Tolerance; cells within one and a half times the tolerance are used. Their weight is
            the inverse square of the tolerance times Tukey's biweight, so that the feet of walls
            have little weight.
        rounds: Number of rounds.
        prior: Prior of the angles, or None.
        lever_bits: Exponent of the unit of ``t`` and ``s``, ``2**lever_bits`` depth units.
    """
    for _ in range(rounds):
        right, down, forward = floor_axes(plane)
        e = along(down, cells) - plane.height
        allowed = slack.of(cells.z, plane.height)
        near = 2 * np.abs(e) <= 3 * allowed
        if np.count_nonzero(near) < 20:
            return plane
        some = cells.take(near)
        gate = 9 * allowed[near] * allowed[near]
        taper = 64 - 64 * 4 * e[near] * e[near] // gate
        weight = taper * taper * (64 * 9 * slack.base * slack.base // gate + 1) >> 6
        if not weight.any():
            return plane
        t, s = (along(axis, some) >> lever_bits for axis in (forward, right))
        turns = _turns(weight, e[near], t, s, _pull(plane, prior), lever_bits)
        pitch, roll = plane.pitch + turns[0], plane.roll
        roll = wrapped(roll + rounded(turns[1] << SINE_BITS, int(cosine(plane.pitch))))
        pitch = min(max(pitch, -STEEPEST), STEEPEST)
        height = along(down_units(pitch, roll), some)
        plane = Plane(pitch, roll, rounded(int(weight @ height), int(weight.sum())))
    return plane


def _pull(plane: Plane, prior: Plane | None) -> tuple[int, int]:
    """Return the rotations from a plane to the prior, about right and forward [angle steps]."""
    if prior is None:
        return 0, 0
    side = wrapped(prior.roll - plane.roll) * int(cosine(plane.pitch))
    return prior.pitch - plane.pitch, rounded(side, 1 << SINE_BITS)


def _turns(
    weight: np.ndarray,
    e: np.ndarray,
    t: np.ndarray,
    s: np.ndarray,
    pull: tuple[int, int],
    lever_bits: int,
) -> tuple[int, int]:
    """Solve for the rotations about right and forward [angle steps], at most ``LARGEST_TURN``."""
    total = int(weight.sum())
    e, t, s = (a - rounded(int(weight @ a), total) for a in (e, t, s))
    tt, ts, ss, te, se = (
        int(weight @ (a * b)) for a, b in ((t, t), (t, s), (s, s), (t, e), (s, e))
    )
    ridge = total * RIDGE
    tt, ss = tt + ridge, ss + ridge
    te, se = (
        a - rounded(ridge * (p << lever_bits), RADIAN) for a, p in zip((te, se), pull, strict=True)
    )
    shift = max(max(abs(a) for a in (tt, ss, te, se)).bit_length() - TURN_BITS, 0)
    tt, ts, ss, te, se = (a >> shift for a in (tt, ts, ss, te, se))
    det = max(tt * ss - ts * ts, 1) << lever_bits
    pitch, side = (rounded(a * RADIAN, det) for a in (se * ts - te * ss, te * ts - se * tt))
    pitch, side = (min(max(a, -LARGEST_TURN), LARGEST_TURN) for a in (pitch, side))
    return pitch, side
