"""Shape of the floor ahead of its plane: flat, a ramp, or a step."""

import numpy as np

from jaxdet.floor.units import ALIKE_M, FINE_PER_Z, PROFILE_M, ROUGH_M, Scale, wrapped
from jaxdet.reference._floor_planes import Plane, Sample
from jaxdet.reference._floor_profile import Ahead, profile
from jaxdet.reference._floor_ramp import best_ramp, is_seen
from jaxdet.reference._floor_step import best_step

MIN_GAIN = 5
"""Minimum gain of votes of a ramp or step over the best plane [percent of that plane's votes, not
of the frame, which walls may fill]."""
OVER_RAMP = 2
"""Minimum gain of votes of a step over a ramp [percent], as a step may fit a part of a ramp."""
ALIKE = 3
"""Planes that differ by at most this angle [angle steps], and in height by at most ``ALIKE_M``, are
alike: only the first is tried with steps."""


def find_ahead(
    flat: Plane, planes: list[Plane], cells: Sample, scale: Scale, farthest: int | None
) -> tuple[Plane, Ahead | None]:
    """Select the plane, and a ramp or step if it gets clearly more votes than any plane alone.

    Args:
        flat: Plane that is returned if there is no ramp or step.
        planes: Planes that may end in a ramp or a step.
        cells: Cells; those in the margins of the image are not used.
        scale: Depth unit.
        farthest: Maximum height of the camera above the floor on which it stands [depth units], or
            None without a prior. Floor beyond a step down must be farther below the camera than
            this; otherwise a wide, low object on the floor would be taken for the floor before a
            step.
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
    apart = max(abs(plane.pitch - other.pitch), abs(wrapped(plane.roll - other.roll)))
    return apart <= ALIKE and abs(plane.height - other.height) <= scale.length(ALIKE_M)
