"""Detection of a step ahead of a plane, down or up, by votes on the profile of the floor."""

import numpy as np

from jaxdet.floor.units import DROP_SPACING_M, SPREAD_M
from jaxdet.reference._floor_profile import Ahead, Profile, spread

DROPS, RISES = 28, 10  # candidate steps: down to 1.1 m, and up to 0.4 m
OWN = 4  # at least one in OWN cells of both floors must be on the nearer one
NONE = -(1 << 40)  # fewer votes than any step has


def best_step(
    seen: Profile, coarse: np.ndarray, fine: np.ndarray, deeper: int, unit: float
) -> tuple[int, Ahead]:
    """Find the step with the most votes.

    The floor before the step is the plane, and the floor beyond is parallel to it. The two must be
    separated by more than the tolerances, and the floor beyond must be visible over some distance,
    which excludes walls. At least one in ``OWN`` inliers must be before the step; otherwise it
    is not a step but a floor at another height.

    Args:
        seen: Profile above a plane.
        coarse: Tolerance of the floor beyond the step at each distance, ``(T,)`` [depth units].
        fine: Tolerance of the plane at each distance, ``(T,)`` [depth units].
        deeper: Height that a step down must exceed [depth units].
        unit: Metres per depth unit.

    Returns:
        Votes, and the step; the votes are :data:`NONE` if there is no step.
    """
    drops = np.concatenate([np.arange(1, DROPS + 1), -np.arange(1, RISES + 1)])
    drops = drops[:, None] * max(round(DROP_SPACING_M / unit), 1)
    level, other = np.zeros_like(seen.run), np.broadcast_to(-drops, (len(drops), len(seen.run)))
    before = _sums_before(seen.each(level, fine))
    beyond = _sums_from(seen.each(other, coarse))
    own, others = _sums_before(seen.on(level, fine)), _sums_from(seen.on(other, coarse))
    allowed = (abs(drops) > 2 * coarse) & ((drops > deeper) | (drops < 0))
    votes = np.where(allowed & (OWN * own >= own + others), before + beyond, NONE)
    i, k = (int(n) for n in np.unravel_index(np.argmax(votes), votes.shape))
    first, last = spread(seen.run[k:], seen.on(other[i], coarse)[k:])
    is_seen = last - first > round(SPREAD_M / unit)
    start = int(seen.run[k] - seen.run[0])  # start of that distance bin
    return int(votes[i, k]) if is_seen else NONE, Ahead(start, drop=int(drops[i, 0]))


def _sums_before(values: np.ndarray) -> np.ndarray:
    """Return the sum of the values at nearer distances, for each distance."""
    return np.cumsum(values, axis=-1) - values


def _sums_from(values: np.ndarray) -> np.ndarray:
    """Return the sum of the values at this and farther distances, for each distance."""
    return np.cumsum(values[..., ::-1], axis=-1)[..., ::-1]
