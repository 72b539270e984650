"""How a floor goes on ahead: flat, as a ramp, or after a step."""

import numpy as np

from jaxdet.floor.units import ALIKE_M, FINE_PER_Z, PROFILE_M, ROUGH_M, Scale
from jaxdet.reference._floor_planes import Plane, Sample
from jaxdet.reference._floor_profile import Ahead, profile
from jaxdet.reference._floor_ramp import best_ramp, is_seen
from jaxdet.reference._floor_step import best_step

MIN_GAIN = 5
"""A ramp or step must explain so many percent more cells than the best plane alone does: of the
floor, not of the frame, which walls may fill."""
OVER_RAMP = 2
"""And a step so many percent more than a ramp, of which it may be a part."""
ALIKE = 3
"""Of planes turned by so much at most [angle steps], whose heights differ by no more than
``ALIKE_M``, the first is tried with steps."""


def find_ahead(
    flat: Plane, planes: list[Plane], cells: Sample, scale: Scale, farthest: int | None
) -> tuple[Plane, Ahead | None]:
    """The plane, with a ramp or a step where clearly more cells speak for that than for any plane.

    Args:
        flat: The plane where there is neither.
        planes: Those that may end in one.
        cells: Their inner ones are used.
        scale: The depth unit.
        farthest: How far below the camera its floor may be [depth units]. Beyond a step down the
            floor is lower: else what stands on it, wide and low, would be the floor before a step.
            None: nothing is known.
    """
    inner = cells.take(cells.inner)
    alone, ramps, steps, stepped = [], [], [], []
    for plane in dict.fromkeys([flat, *planes]):
        seen = profile(plane, inner, scale)
        coarse, fine = (
            scale.tolerance(base, FINE_PER_Z).of(seen.run, plane.height)
            for base in (PROFILE_M, ROUGH_M)
        )
        alone.append(int(seen.votes(np.zeros_like(seen.run), fine)))
        votes, ramp = best_ramp(seen, coarse, fine, scale.unit)
        if is_seen(seen, ramp, fine, scale.unit):
            ramps.append((votes, plane, ramp))
        if not any(_alike(plane, one, scale) for one in stepped):
            stepped.append(plane)
            deeper = 0 if farthest is None else farthest - plane.height
            votes, step = best_step(seen, coarse, fine, deeper, scale.unit)
            steps.append((votes, plane, step))
    best = max(alone), flat, None
    for found in (ramps, steps):
        one = max(found, key=lambda ahead: ahead[0], default=best)
        gain = OVER_RAMP if best[2] else MIN_GAIN
        if 100 * (one[0] - best[0]) > gain * max(best[0], 0):
            best = one
    return best[1:]


def _alike(plane: Plane, other: Plane, scale: Scale) -> bool:
    apart = max(abs(plane.pitch - other.pitch), abs(plane.roll - other.roll))
    return apart <= ALIKE and abs(plane.height - other.height) <= scale.length(ALIKE_M)
