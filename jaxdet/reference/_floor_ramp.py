"""Detection of a ramp ahead of a plane, by votes on the profile of the floor."""

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
"""Candidate slopes [angle steps]. Smaller slopes can't be distinguished from a wavy floor, and
wheeled robots do not drive on steeper slopes."""
FINE_TURN = ANGLES // 4  # spacing of the fine lattice
MIN_SHARE = 40
"""Minimum fraction of cells that only the ramp explains, among the cells near the floor where ramp
and plane differ [percent]."""


def best_ramp(
    seen: Profile, coarse: np.ndarray, fine: np.ndarray, unit: float
) -> tuple[int, Ahead]:
    """Find the ramp with the most votes, on a coarse and then a fine lattice.

    Args:
        seen: Profile above a plane.
        coarse: Tolerance at each distance for the coarse lattice, ``(T,)`` [depth units].
        fine: Tolerance for the fine lattice.
        unit: Metres per depth unit.

    Returns:
        Votes, and the ramp.
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
    """Return the votes and the best ramp of a lattice of starts and slopes."""
    votes = seen.votes(rises(starts[:, None], turns[None], seen.run), slack)
    i, j = (int(n) for n in np.unravel_index(np.argmax(votes), votes.shape))
    return int(votes[i, j]), Ahead(int(starts[i]), int(turns[j]))


def crossing(level: Plane, steep: Plane) -> Ahead | None:
    """Return a steeper plane as a ramp ahead of a level plane; None if it is not a ramp.

    At distance t along the level plane, the steeper one is ``a + b t`` above it: b is the tangent
    of their difference in pitch, a the difference of their heights along the level plane's normal.
    """
    turn = steep.pitch - level.pitch
    if not LEAST_TURN <= abs(turn) <= MOST_TURN:
        return None
    over = (steep.height << SINE_BITS) // int(cosine(turn)) - level.height
    return Ahead((over << SLOPE_BITS) // int(slopes(np.array(turn))), turn)


def ramp_plane(level: Plane, ramp: Ahead) -> Plane:
    """Return the plane of a ramp, with its pitch limited; the inverse of :func:`crossing`."""
    height = level.height + (ramp.start * int(slopes(np.array(ramp.turn))) >> SLOPE_BITS)
    height = height * int(cosine(ramp.turn)) >> SINE_BITS
    pitch = min(max(level.pitch + ramp.turn, -STEEPEST), STEEPEST)
    return Plane(pitch, level.roll, height)


def is_seen(seen: Profile, ramp: Ahead, slack: np.ndarray, unit: float) -> bool:
    """Return whether enough of the ramp is visible: cells that begin near its start and go on."""
    rise = rises(np.array(ramp.start), np.array(ramp.turn), seen.run)
    distinct = np.abs(rise) > slack
    # If the tolerances of ramp and plane overlap, a cell belongs to the plane.
    low = np.maximum(rise - slack, slack) if ramp.turn > 0 else rise - slack
    high = rise + slack if ramp.turn > 0 else np.minimum(rise + slack, -slack)
    ramp_cells = np.where(distinct, seen.under(high) - seen.under(low), 0)
    all_cells = np.where(distinct, seen.under(np.maximum(rise, 0) + BELOW * slack), 0)
    total = int(ramp_cells.sum())
    if 100 * total < MIN_SHARE * int(all_cells.sum()) or not total:
        return False
    first, last = spread(seen.run, ramp_cells)
    begin = int(seen.run[np.argmax(distinct)])
    return first < begin + round(RAMP_NEAR_M / unit) and last - first > round(SPREAD_M / unit)
