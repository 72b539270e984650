"""A step ahead of a plane, down or up, by votes on the floor's profile."""

import numpy as np

from jaxdet.floor.units import DROP_SPACING_M, SPREAD_M
from jaxdet.reference._floor_profile import Ahead, Profile, spread

DROPS, RISES = 28, 10  # steps tried: down to 1.1 m, and up to 0.4 m
OWN = 4  # of the cells on both floors, one of so many must be on the nearer one
NONE = -(1 << 40)  # fewer votes than any step has


def best_step(
    seen: Profile, coarse: np.ndarray, fine: np.ndarray, deeper: int, unit: float
) -> tuple[int, Ahead]:
    """The step with most votes.

    The floor before it is the plane, the one beyond is parallel. The other floor must lie clear of
    the plane and be seen over some distance, which a wall is not; and enough of the cells must be
    before the step: else all of the floor is lower or higher.

    Args:
        seen: The profile over a plane.
        coarse: ``(T,)`` tolerance of the other floor at each distance [depth units].
        fine: The same of the plane.
        deeper: A step down is deeper than this [depth units].
        unit: Metres in one depth unit.

    Returns:
        Its votes, and the step; :data:`NONE` where there is none.
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
    start = int(seen.run[k] - seen.run[0])  # where that distance begins
    return int(votes[i, k]) if is_seen else NONE, Ahead(start, drop=int(drops[i, 0]))


def _sums_before(values: np.ndarray) -> np.ndarray:
    """For each distance the sum of the values at nearer ones."""
    return np.cumsum(values, axis=-1) - values


def _sums_from(values: np.ndarray) -> np.ndarray:
    """For each distance the sum of the values from it on."""
    return np.cumsum(values[..., ::-1], axis=-1)[..., ::-1]
