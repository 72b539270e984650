"""Planes, and their refinement by least squares, all on integers.

Angles are whole :data:`ANGLES` of a degree and directions have ``DOWN_BITS`` fraction bits, both
from one table of sines; heights and positions are whole depth units. So every step is a sum, a
product, a shift or a division of integers.
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
)
from jaxdet.reference._rounding import rounded

DOWN_BITS = 12  # fraction bits of a direction: with the largest position its product has 32 bits
RADIAN = round(180 * ANGLES / np.pi)  # angle steps in a radian
LARGEST_TURN = 8 * ANGLES  # most that a round of refinement turns a plane
BELOW = 4  # a cell so many tolerances below a plane lies clearly below it
BELOW_COST = 2  # and counts so many times as much as one on it: nothing is seen through a floor
TURN_BITS = 24
"""Bits of the sums that the refinement multiplies: two products and an angle fit into 64."""
RIDGE = 14  # square of 3 cm in levers of 8 mm: floor seen over a few centimetres tells no tilt


class Sample(NamedTuple):
    """Cells with depth, at most some thousands."""

    xyz: np.ndarray  # (K, 3) int64, camera optical frame [depth units]
    inner: np.ndarray  # (K,) bool, not at the left or right margin of the image

    @property
    def z(self) -> np.ndarray:
        """``(K,)`` int64, depth [depth units]."""
        return self.xyz[:, 2]

    def take(self, which: np.ndarray) -> "Sample":
        """Some of them."""
        return Sample(self.xyz[which], self.inner[which])


class Plane(NamedTuple):
    """A plane in whole angle steps and depth units."""

    pitch: int
    roll: int
    height: int


def down_units(pitch: np.ndarray | int, roll: np.ndarray | int) -> np.ndarray:
    """:func:`jaxdet.floor.plane.down_vector`, ``DOWN_BITS`` fraction bits, ``(..., 3)`` int64."""
    level = cosine(pitch)
    parts = sine(roll) * level, cosine(roll) * level, sine(pitch) << SINE_BITS
    bits = 2 * SINE_BITS - DOWN_BITS
    return (np.stack(np.broadcast_arrays(*parts), axis=-1) + (1 << (bits - 1))) >> bits


def floor_axes(plane: Plane) -> np.ndarray:
    """Right, down and forward of a plane with ``DOWN_BITS`` fraction bits, ``(3, 3)`` int64.

    Forward is the derivative of down by pitch; right, times the cosine of pitch, that by roll.
    """
    quarter = 90 * ANGLES
    pitch = np.array([0, plane.pitch, plane.pitch + quarter])
    return down_units(pitch, np.array([plane.roll + quarter, plane.roll, plane.roll]))


def along(directions: np.ndarray, cells: Sample) -> np.ndarray:
    """Positions along directions ``(..., 3)``, rounded, ``(..., K)`` int64 [depth units]."""
    return (directions @ cells.xyz.T + (1 << (DOWN_BITS - 1))) >> DOWN_BITS


def below(plane: Plane, cells: Sample) -> np.ndarray:
    """How far cells lie below a plane, ``(K,)`` int64 [depth units]."""
    return along(down_units(plane.pitch, plane.roll), cells) - plane.height


def score(below: np.ndarray, slack: np.ndarray) -> np.ndarray:
    """Cells on a floor, less ``BELOW_COST`` times those clearly below it; over the last axis."""
    on = np.count_nonzero(np.abs(below) <= slack, axis=-1)
    return on - BELOW_COST * np.count_nonzero(below > BELOW * slack, axis=-1)


def refined(
    plane: Plane, cells: Sample, rounds: tuple[int, int, int], prior: Plane | None, scale: Scale
) -> Plane:
    """:func:`refine` in some rounds with a rough tolerance, a fine and a sharp one."""
    for slack, count in zip((scale.rough(ROUGH_DEG), scale.fine, scale.sharp), rounds, strict=True):
        plane = refine(plane, cells, slack, count, prior, scale.bits(LEVER_M))
    return plane


def refine(
    plane: Plane, cells: Sample, slack: Tolerance, rounds: int, prior: Plane | None, lever_bits: int
) -> Plane:
    """Weighted least squares on the cells near a plane, in fixed rounds.

    With ``e`` how far a cell lies below the plane, ``t`` its distance forward and ``s`` to the
    right, all less their means, the turns a, b that minimise ``sum w (e + a t + b s)^2`` solve two
    equations by Cramer's rule. To both squares ``RIDGE`` is added, so that a turn that the cells
    don't tell leads to the prior, or to none. The sums are exact in 64 bits and shifted to
    ``TURN_BITS`` before they are multiplied, so all products are exact too.

    Args:
        plane: Where to begin; it stays where fewer than 20 cells are near, or all of them as far
            away as that allows.
        cells: ``K`` of them.
        slack: Cells one and a half times so far away count as near. The weight is its inverse
            square times Tukey's biweight, so that the feet of walls weigh little.
        rounds: How often.
        prior: What is known of the angles; None: nothing.
        lever_bits: ``t`` and ``s`` are measured in ``2**lever_bits`` depth units.
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
        roll += rounded(turns[1] << SINE_BITS, int(cosine(plane.pitch)))
        roll = (roll + 180 * ANGLES) % (360 * ANGLES) - 180 * ANGLES
        pitch = min(max(pitch, -STEEPEST), STEEPEST)
        height = along(down_units(pitch, roll), some)
        plane = Plane(pitch, roll, rounded(int(weight @ height), int(weight.sum())))
    return plane


def _pull(plane: Plane, prior: Plane | None) -> tuple[int, int]:
    """From a plane to the prior: turns about right and forward in angle steps."""
    if prior is None:
        return 0, 0
    side = (prior.roll - plane.roll) * int(cosine(plane.pitch))
    return prior.pitch - plane.pitch, rounded(side, 1 << SINE_BITS)


def _turns(
    weight: np.ndarray,
    e: np.ndarray,
    t: np.ndarray,
    s: np.ndarray,
    pull: tuple[int, int],
    lever_bits: int,
) -> tuple[int, int]:
    """The turns about right and forward in angle steps, at most ``LARGEST_TURN``."""
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
