"""A step down ahead of a plane, by votes on the floor's profile."""

import numpy as np

from jaxdet.floor.units import DROP_M
from jaxdet.reference._floor_profile import Ahead, Profile

DROPS = 28  # steps down tried, up to 1.1 m
OWN = 4  # of the cells on both floors, one of so many must be on the nearer one
NONE = -(1 << 40)  # fewer votes than any step has


def best_step(
    seen: Profile, coarse: np.ndarray, fine: np.ndarray, deeper: int, unit: float
) -> tuple[int, Ahead]:
    """The step down with most votes.

    The floor before it is the plane, the one beyond is parallel. The lower one must lie clear of
    the plane, and enough of the cells before the step: else all of the floor is lower.

    Args:
        seen: The profile over a plane.
        coarse: ``(T,)`` tolerance of the lower floor at each distance [depth units].
        fine: The same of the plane.
        deeper: The step is deeper than this [depth units].
        unit: Metres in one depth unit.

    Returns:
        Its votes, and the step; :data:`NONE` where there is none.
    """
    drops = np.arange(1, DROPS + 1) * max(round(DROP_M / unit), 1)
    level = np.zeros_like(seen.run)
    low = np.broadcast_to(-drops[:, None], (DROPS, len(seen.run)))
    before = _sums_before(seen.each(level, fine))
    beyond = _sums_from(seen.each(low, coarse))
    own, lower = _sums_before(seen.on(level, fine)), _sums_from(seen.on(low, coarse))
    allowed = (drops[:, None] > np.maximum(2 * coarse, deeper)) & (OWN * own >= own + lower)
    votes = np.where(allowed, before + beyond, NONE)
    i, k = (int(n) for n in np.unravel_index(np.argmax(votes), votes.shape))
    start = int(seen.run[k] - seen.run[0])  # where that distance begins
    return int(votes[i, k]), Ahead(start, drop=int(drops[i]))


def _sums_before(values: np.ndarray) -> np.ndarray:
    """For each distance the sum of the values at nearer ones."""
    return np.cumsum(values, axis=-1) - values


def _sums_from(values: np.ndarray) -> np.ndarray:
    """For each distance the sum of the values from it on."""
    return np.cumsum(values[..., ::-1], axis=-1)[..., ::-1]
