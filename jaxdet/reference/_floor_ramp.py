"""A ramp ahead of a plane, by votes on the floor's profile."""

import numpy as np

from jaxdet.floor.units import (
    ANGLES,
    FINE_START_M,
    RAMP_NEAR_M,
    SINE_BITS,
    SLOPE_BITS,
    SPREAD_M,
    STARTS_M,
    STEEPEST,
    cosine,
    slopes,
)
from jaxdet.reference._floor_planes import BELOW, Plane
from jaxdet.reference._floor_profile import Ahead, Profile, rises, spread

LEAST_TURN, MOST_TURN = 3 * ANGLES, 12 * ANGLES
TURNS = np.arange(LEAST_TURN, MOST_TURN + 1, ANGLES // 2)
"""Slopes tried: a smaller one is no more than a floor's own waves, and robots on wheels drive no
larger one."""
FINE_TURN = ANGLES // 4  # step of the finer lattice
MIN_SHARE = 40
"""Of the cells near the floor that tell the ramp from the plane, it must explain at least so many
percent anew."""


def best_ramp(
    seen: Profile, coarse: np.ndarray, fine: np.ndarray, unit: float
) -> tuple[int, Ahead]:
    """The ramp with most votes, looked for on a lattice and then on a finer one.

    Args:
        seen: The profile over a plane.
        coarse: ``(T,)`` tolerance at each distance for the lattice [depth units].
        fine: The same for the finer one.
        unit: Metres in one depth unit.

    Returns:
        Its votes, and the ramp.
    """
    starts = np.rint(STARTS_M / unit).astype(np.int64)
    first = _best(seen, starts, np.concatenate([-TURNS[::-1], TURNS]), coarse)[1]
    starts = first.start + np.arange(-4, 5) * max(round(FINE_START_M / unit), 1)
    turns = abs(first.turn) + np.arange(-4, 5) * FINE_TURN
    turns = np.sign(first.turn) * np.clip(turns, LEAST_TURN, MOST_TURN)
    return _best(seen, starts, turns, fine)


def _best(
    seen: Profile, starts: np.ndarray, turns: np.ndarray, slack: np.ndarray
) -> tuple[int, Ahead]:
    """The best ramp of a lattice of starts and slopes, and its votes."""
    votes = seen.votes(rises(starts[:, None], turns[None], seen.run), slack)
    i, j = (int(n) for n in np.unravel_index(np.argmax(votes), votes.shape))
    return int(votes[i, j]), Ahead(int(starts[i]), int(turns[j]))


def crossing(level: Plane, steep: Plane) -> Ahead | None:
    """The ramp that a steeper plane is, ahead of a level one; None where it is none.

    Along the level floor the plane rises by ``a + b t``: b is the tangent of their difference in
    pitch, a the difference of their heights along the level floor's normal.
    """
    turn = steep.pitch - level.pitch
    if not LEAST_TURN <= abs(turn) <= MOST_TURN:
        return None
    over = (steep.height << SINE_BITS) // int(cosine(turn)) - level.height
    return Ahead((over << SLOPE_BITS) // int(slopes(np.array(turn))), turn)


def ramp_plane(level: Plane, ramp: Ahead) -> Plane:
    """The plane of a ramp, no steeper than planes are; :func:`crossing` gives the ramp back."""
    height = level.height + (ramp.start * int(slopes(np.array(ramp.turn))) >> SLOPE_BITS)
    height = height * int(cosine(ramp.turn)) >> SINE_BITS
    pitch = min(max(level.pitch + ramp.turn, -STEEPEST), STEEPEST)
    return Plane(pitch, level.roll, height)


def is_seen(seen: Profile, ramp: Ahead, slack: np.ndarray, unit: float) -> bool:
    """Whether the ramp shows itself from near its start on, over some distance."""
    rise = rises(np.array(ramp.start), np.array(ramp.turn), seen.run)
    telling = np.abs(rise) > slack
    # Where the tolerances of ramp and plane overlap, a cell is the plane's.
    low = np.maximum(rise - slack, slack) if ramp.turn > 0 else rise - slack
    high = rise + slack if ramp.turn > 0 else np.minimum(rise + slack, -slack)
    anew = np.where(telling, seen.under(high) - seen.under(low), 0)
    there = np.where(telling, seen.under(np.maximum(rise, 0) + BELOW * slack), 0)
    total = int(anew.sum())
    if 100 * total < MIN_SHARE * int(there.sum()) or not total:
        return False
    first, last = spread(seen.run, anew)
    begin = int(seen.run[np.argmax(telling)])
    return first < begin + round(RAMP_NEAR_M / unit) and last - first > round(SPREAD_M / unit)
