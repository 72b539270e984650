"""Histogram of cells by distance and height above a plane."""

from typing import NamedTuple

import numpy as np

from jaxdet.floor.units import FARTHEST_M, HIGHEST_M, RISE_M, RUN_M, SLOPE_BITS, Scale, slopes
from jaxdet.reference._floor_planes import BELOW, BELOW_COST, Plane, Sample, along, floor_axes


class Ahead(NamedTuple):
    """Shape of the floor ahead of its plane: a ramp, or a step down or up."""

    start: int  # distance forward at which it begins [depth units]
    # pitch of the ramp relative to the plane, uphill positive, 0 = none [angle steps]
    turn: int = 0
    drop: int = 0  # height of the step, down positive, 0 = none [depth units]

    def rise(self, run: np.ndarray) -> np.ndarray:
        """Return the height of the floor above the plane at distances, ``(T,)`` [depth units]."""
        ramp = rises(np.array(self.start), np.array(self.turn), run)
        return ramp - np.where(run >= self.start, self.drop, 0)


def rises(starts: np.ndarray, turns: np.ndarray, run: np.ndarray) -> np.ndarray:
    """Return the heights of ramps above the plane, ``(..., T)`` [depth units].

    Args:
        starts: Distance at which each ramp begins, ``(...)`` [depth units].
        turns: Pitch of each ramp relative to the plane, ``(...)`` [angle steps].
        run: Distances ``(T,)`` [depth units].
    """
    beyond = np.maximum(run - starts[..., None], 0)
    return (slopes(turns)[..., None] * beyond + (1 << (SLOPE_BITS - 1))) >> SLOPE_BITS


class Profile(NamedTuple):
    """Cumulative counts of cells over height, by distance forward of the camera."""

    counts: np.ndarray  # (T, rises + 1) int64, number of cells below each edge of the height bins
    run: np.ndarray  # (T,) int64, centres of the distance bins [depth units]
    bits: int  # height bins are 2**bits depth units high

    def under(self, height: np.ndarray) -> np.ndarray:
        """Count the cells below heights over the plane ``(..., T)`` [depth units], by distance."""
        last = self.counts.shape[1] - 1
        index = np.clip((height >> self.bits) + last // 2, 0, last)
        return self.counts[np.arange(len(self.run)), index]

    def on(self, rise: np.ndarray, slack: np.ndarray) -> np.ndarray:
        """Count the inliers of a floor at height ``rise`` above the plane, by distance."""
        return self.under(rise + slack) - self.under(rise - slack)

    def each(self, rise: np.ndarray, slack: np.ndarray) -> np.ndarray:
        """Count inliers minus ``BELOW_COST`` times the cells clearly below, by distance."""
        return self.on(rise, slack) - BELOW_COST * self.under(rise - BELOW * slack)

    def votes(self, rise: np.ndarray, slack: np.ndarray) -> np.ndarray:
        """Sum :meth:`each` over all distances, ``(...)``."""
        return self.each(rise, slack).sum(axis=-1)


def profile(plane: Plane, cells: Sample, scale: Scale) -> Profile:
    """Compute the profile of cells above a plane."""
    run_bits, rise_bits, unit = scale.bits(RUN_M), scale.bits(RISE_M), scale.unit
    runs, half = round(FARTHEST_M / unit) >> run_bits, round(HIGHEST_M / unit) >> rise_bits
    _, down, forward = floor_axes(plane)
    run = along(forward, cells) >> run_bits
    rise = ((plane.height - along(down, cells)) >> rise_bits) + half
    inside = (run >= 0) & (run < runs) & (rise < 2 * half)
    place = run[inside] * 2 * half + np.maximum(rise[inside], 0)
    counts = np.bincount(place, minlength=runs * 2 * half).reshape(runs, 2 * half)
    middles = (np.arange(runs) << run_bits) + (1 << run_bits >> 1)
    return Profile(np.pad(np.cumsum(counts, axis=1), ((0, 0), (1, 0))), middles, rise_bits)


def spread(run: np.ndarray, counts: np.ndarray) -> tuple[int, int]:
    """Return the range of distances without the nearest and the farthest tenth of the cells.

    Args:
        run: Distances in ascending order, ``(T,)`` [depth units].
        counts: Number of cells at each distance, ``(T,)``.
    """
    running = np.cumsum(counts)
    first, last = (int(run[np.argmax(10 * running >= n * running[-1])]) for n in (1, 9))
    return first, last


def distance(plane: Plane, cells: Sample) -> np.ndarray:
    """Return the distance of cells forward of the camera, ``(K,)`` int64 [depth units]."""
    return along(floor_axes(plane)[2], cells)
