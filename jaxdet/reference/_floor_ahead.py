"""How a floor goes on ahead: flat, as a ramp, or lower after a step."""

import numpy as np

from jaxdet.floor.units import FINE_PER_Z, PROFILE_M, ROUGH_M, Scale
from jaxdet.reference._floor_planes import Plane, Sample
from jaxdet.reference._floor_profile import Ahead, profile
from jaxdet.reference._floor_ramp import best_ramp, is_seen
from jaxdet.reference._floor_step import NONE, best_step

MIN_GAIN = 5
"""A ramp or step must explain so many percent more cells than the best plane alone does: of the
floor, not of the frame, which walls may fill."""


def find_ahead(
    flat: Plane, planes: list[Plane], cells: Sample, scale: Scale, farthest: int | None
) -> tuple[Plane, Ahead | None]:
    """The plane, with a ramp or a step where clearly more cells speak for that than for any plane.

    Args:
        flat: The plane where there is neither.
        planes: Those that may end in one.
        cells: Their inner ones are used.
        scale: The depth unit.
        farthest: How far below the camera its floor may be [depth units]. Beyond a step the floor
            is lower: else what stands on it, wide and low, would be the floor before a step. None:
            nothing is known, and no step is tried, for the top of a table is as a floor before one.
    """
    inner = cells.take(cells.inner)
    alone, ramps, lower = [], [], []
    for plane in dict.fromkeys([flat, *planes]):
        seen = profile(plane, inner, scale)
        coarse, fine = (
            scale.slack(base, FINE_PER_Z).of(seen.run, plane.height)
            for base in (PROFILE_M, ROUGH_M)
        )
        alone.append(int(seen.votes(np.zeros_like(seen.run), fine)))
        votes, ramp = best_ramp(seen, coarse, fine, scale.unit)
        if is_seen(seen, ramp, fine, scale.unit):
            ramps.append((votes, plane, ramp))
        if farthest is not None:
            votes, step = best_step(seen, coarse, fine, farthest - plane.height, scale.unit)
            lower.append((votes, plane, step))
    found = [*ramps, *lower]  # of as many votes the first wins
    votes, plane, ahead = max(found, key=lambda one: one[0], default=(NONE, flat, None))
    if 100 * (votes - max(alone)) <= MIN_GAIN * max(*alone, 0):
        return flat, None
    return plane, ahead
