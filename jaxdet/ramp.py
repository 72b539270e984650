"""A ramp ahead: where the floor begins to rise or fall, and how steeply.

Beside the floor's plane, hinged planes are tried that bend at some distance ahead; the one that
most points lie on while few lie below it is refined by weighted least squares.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from jaxdet.plane import forward_vector

STARTS_M = np.arange(0.4, 3.6, 0.2)
"""Distances at which a ramp is tried to begin."""
SLOPES = np.tan(np.radians(np.arange(-12.0, 12.01, 0.5)))
"""Slopes tried, rise over run: what robots on wheels drive."""
MIN_GAIN = 0.02
"""A ramp must explain so many more of the points, as a share."""
MIN_SHARE = 0.1
"""Of the points that tell the ramp from the plane, it must explain at least this part anew."""
NEAR_M, SPREAD_M = 0.5, 0.3
"""It must be seen this near to where it can be told from the plane, and over such a distance; a
hinge through an obstacle's top or face is seen in one place."""
MAX_TURN = np.radians(10.0)
"""A plane refined on the points before a ramp may turn so far."""
MAX_TRIED = 4000
"""Points that ramps are tried on; all are used to refine the best."""


class Floor(NamedTuple):
    """A plane and the ramp that ends it."""

    down: np.ndarray
    """``(3,)`` float64, unit vector."""
    height: float
    """Camera above the plane [m]."""
    start: float = np.inf
    """As :attr:`jaxdet.types.GroundPlane.ramp_start`."""
    slope: float = 0.0
    """As :attr:`jaxdet.types.GroundPlane.ramp_slope`."""

    def below(self, points: np.ndarray) -> np.ndarray:
        """How far the points ``(n, 3)`` [m] lie below the floor, ``(n,)`` [m]."""
        depth = points @ self.down - self.height
        if not np.isfinite(self.start):
            return depth
        return depth + self.slope * np.maximum(self.distance(points) - self.start, 0.0)

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Distance forward of the camera on the floor, ``(n,)`` [m]."""
        return points @ forward_vector(self.down[None])[0]


def tolerance(floor: Floor, points: np.ndarray) -> np.ndarray:
    """How far from the floor a measured floor point may lie, ``(n,)`` [m].

    8 mm for its roughness, and the stereo noise: 0.004 z^2 along a ray that meets the floor at the
    angle whose sine is about height / z.
    """
    return 0.008 + 0.004 * floor.height * points[:, 2]


def refine(
    floor: Floor,
    points: np.ndarray,
    within: Callable[[Floor, np.ndarray], np.ndarray] = tolerance,
    rounds: int = 6,
) -> Floor:
    """Weighted total least squares on the points near a floor without a ramp.

    Args:
        floor: Where to begin.
        points: ``(n, 3)`` float64 in the camera optical frame [m].
        within: Points one and a half times so far away count as near.
        rounds: How often.
    """
    for _ in range(rounds):
        allowed = within(floor, points)
        near = np.abs(floor.below(points)) < 1.5 * allowed
        if near.sum() < 20:
            break
        weight = allowed[near] ** -2
        weight /= weight.sum()
        center = weight @ points[near]
        offset = points[near] - center
        normal = np.linalg.eigh((offset * weight[:, None]).T @ offset)[1][:, 0]
        down = normal if normal[1] > 0 else -normal
        floor = Floor(down, float(down @ center))
    return floor


def find_ramp(floor: Floor, points: np.ndarray, *, fixed: bool) -> Floor:
    """The floor with the ramp that the points show, or the same floor.

    Args:
        floor: Without a ramp.
        points: ``(n, 3)`` float64 in the camera optical frame [m].
        fixed: Whether the plane is known; else it is refined on the points before each ramp.
    """
    tried = points[:: -(-len(points) // MAX_TRIED)]
    distance = floor.distance(tried)
    flat = best = score(floor.below(tried), tolerance(floor, tried))
    found = floor
    for start in STARTS_M:
        near = distance < start
        if min(near.sum(), (~near).sum()) < 0.03 * len(tried):
            continue
        level = floor if fixed else refine(floor, tried[near])
        if level.down @ floor.down < np.cos(MAX_TURN):
            continue
        run = np.maximum(level.distance(tried) - start, 0.0)
        below = level.below(tried) + SLOPES[:, None] * run
        scores = score(below, tolerance(level, tried))
        which = int(np.argmax(scores))
        if scores[which] > best:
            best = scores[which]
            found = level._replace(start=float(start), slope=float(SLOPES[which]))
    if best - flat <= MIN_GAIN * len(tried):
        return floor
    refined = _refine_ramp(found, points)
    better = abs(refined.slope) <= SLOPES[-1] and _total(refined, tried) >= best
    found = refined if better else found
    return found if _is_seen(found, tried) else floor


def _is_seen(floor: Floor, points: np.ndarray) -> bool:
    """Whether the ramp shows itself from near its start on, over some distance."""
    allowed, level = tolerance(floor, points), floor._replace(start=np.inf)
    run = floor.distance(points) - floor.start
    telling = abs(floor.slope) * run > allowed
    on = telling & (np.abs(floor.below(points)) < allowed)
    anew = run[on & (np.abs(level.below(points)) >= allowed)]
    if len(anew) < MIN_SHARE * telling.sum() or not len(anew):
        return False
    first, last = np.quantile(anew, [0.1, 0.9])
    return bool(first < run[telling].min() + NEAR_M and last - first > SPREAD_M)


def _total(floor: Floor, points: np.ndarray) -> float:
    return float(score(floor.below(points), tolerance(floor, points)))


def score(below: np.ndarray, allowed: np.ndarray) -> np.ndarray:
    """Points on the floor, less twice those clearly below it; over the last axis.

    Args:
        below: ``(..., n)`` how far points lie below a floor [m].
        allowed: ``(n,)`` how far from it they may lie [m].
    """
    on, under = np.abs(below) < allowed, below > 4 * allowed
    return on.sum(axis=-1) - 2.0 * under.sum(axis=-1)


def _refine_ramp(floor: Floor, points: np.ndarray) -> Floor:
    """Weighted least squares for start and slope on the points near the ramp, five times."""
    level = floor._replace(start=np.inf)
    run, rise = floor.distance(points), -level.below(points)
    allowed, refined = tolerance(floor, points), floor
    for _ in range(5):
        on = (run > refined.start) & (np.abs(refined.below(points)) < 1.5 * allowed)
        if on.sum() < 20:
            return floor
        # rise = slope run - slope start
        lines = np.stack([run[on], -np.ones(on.sum())], axis=1) / allowed[on, None]
        slope, drop = np.linalg.lstsq(lines, rise[on] / allowed[on], rcond=None)[0].tolist()
        if abs(slope) < 1e-3 or not 0 < drop / slope < STARTS_M[-1]:
            return floor
        refined = level._replace(start=drop / slope, slope=slope)
    return refined
