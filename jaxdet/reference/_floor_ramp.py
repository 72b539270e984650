"""A ramp ahead of a plane, by votes on the floor's profile: cells by distance and height."""

from typing import NamedTuple

import numpy as np

from jaxdet.floor.units import (
    ANGLES,
    FARTHEST_M,
    FINE_PER_Z,
    FINE_START_M,
    HIGHEST_M,
    PROFILE_M,
    RAMP_NEAR_M,
    RISE_M,
    ROUGH_M,
    RUN_M,
    SINE_BITS,
    SLOPE_BITS,
    SPREAD_M,
    STARTS_M,
    Scale,
    cosine,
    slopes,
)
from jaxdet.reference._floor_planes import BELOW, BELOW_COST, Plane, Sample, along, floor_axes

LEAST_TURN, MOST_TURN = 3 * ANGLES, 12 * ANGLES
TURNS = np.arange(LEAST_TURN, MOST_TURN + 1, ANGLES // 2)
"""Slopes tried: a smaller one is no more than a floor's own waves, and robots on wheels drive no
larger one."""
FINE_TURN = ANGLES // 4  # step of the finer lattice
MIN_GAIN = 5
"""A ramp must explain so many percent more cells than the best plane alone does: of the floor, not
of the frame, which walls may fill."""
MIN_SHARE = 40
"""Of the cells near the floor that tell the ramp from the plane, it must explain at least so many
percent anew."""


class Hinge(NamedTuple):
    """A ramp."""

    start: int  # distance forward at which it begins [depth units]
    turn: int  # its pitch against the plane, uphill positive [angle steps]

    @property
    def slope(self) -> int:
        """Rise over run, ``SLOPE_BITS`` fraction bits."""
        return int(slopes(np.array(self.turn)))


class Profile(NamedTuple):
    """Running counts of cells over their height, by distance forward of the camera."""

    counts: np.ndarray  # (T, rises + 1) int64
    run: np.ndarray  # (T,) int64, the middles of the distances [depth units]
    bits: int  # heights are 2**bits depth units apart

    def under(self, height: np.ndarray) -> np.ndarray:
        """Cells below a height over the plane ``(..., T)`` [depth units], by distance."""
        last = self.counts.shape[1] - 1
        index = np.clip((height >> self.bits) + last // 2, 0, last)
        return self.counts[np.arange(len(self.run)), index]

    def on(self, rise: np.ndarray, slack: np.ndarray) -> np.ndarray:
        """Cells within the tolerance of a floor that rises so, by distance."""
        return self.under(rise + slack) - self.under(rise - slack)

    def votes(self, rise: np.ndarray, slack: np.ndarray) -> np.ndarray:
        """Cells on a floor less ``BELOW_COST`` times those clearly below it, ``(...)``."""
        low = self.under(rise - BELOW * slack)
        return (self.on(rise, slack) - BELOW_COST * low).sum(axis=-1)


def profile(plane: Plane, cells: Sample, scale: Scale) -> Profile:
    """The profile of cells over a plane."""
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


def distance(plane: Plane, cells: Sample) -> np.ndarray:
    """How far forward of the camera cells are on a plane, ``(K,)`` int64 [depth units]."""
    return along(floor_axes(plane)[2], cells)


def rises(starts: np.ndarray, turns: np.ndarray, run: np.ndarray) -> np.ndarray:
    """Heights of ramps over the plane at distances ``(T,)``, ``(..., T)`` [depth units]."""
    beyond = np.maximum(run - starts[..., None], 0)
    return (slopes(turns)[..., None] * beyond + (1 << (SLOPE_BITS - 1))) >> SLOPE_BITS


def find_hinge(
    flat: Plane, planes: list[Plane], cells: Sample, scale: Scale
) -> tuple[Plane, Hinge | None]:
    """The plane and ramp that clearly more cells speak for than for any plane alone.

    Args:
        flat: The plane where there is no ramp.
        planes: Those that may end in a ramp.
        cells: Their inner ones are used.
        scale: The depth unit.
    """
    inner = cells.take(cells.inner)
    alone, best = [], []
    for plane in dict.fromkeys([flat, *planes]):
        seen = profile(plane, inner, scale)
        coarse, fine = (
            scale.slack(base, FINE_PER_Z).of(seen.run, plane.height)
            for base in (PROFILE_M, ROUGH_M)
        )
        alone.append(int(seen.votes(np.zeros_like(seen.run), fine)))
        votes, hinge = best_hinge(seen, coarse, fine, scale.unit)
        if _is_seen(seen, hinge, fine, scale.unit):
            best.append((votes, plane, hinge))
    if not best:
        return flat, None
    votes, plane, hinge = max(best, key=lambda found: found[0])
    if 100 * (votes - max(alone)) <= MIN_GAIN * max(*alone, 0):
        return flat, None
    return plane, hinge


def best_hinge(
    seen: Profile, coarse: np.ndarray, fine: np.ndarray, unit: float
) -> tuple[int, Hinge]:
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
    starts = first.start + np.arange(-4, 5) * round(FINE_START_M / unit)
    turns = abs(first.turn) + np.arange(-4, 5) * FINE_TURN
    turns = np.sign(first.turn) * np.clip(turns, LEAST_TURN, MOST_TURN)
    return _best(seen, starts, turns, fine)


def _best(
    seen: Profile, starts: np.ndarray, turns: np.ndarray, slack: np.ndarray
) -> tuple[int, Hinge]:
    """The best ramp of a lattice of starts and slopes, and its votes."""
    votes = seen.votes(rises(starts[:, None], turns[None], seen.run), slack)
    i, j = (int(n) for n in np.unravel_index(np.argmax(votes), votes.shape))
    return int(votes[i, j]), Hinge(int(starts[i]), int(turns[j]))


def crossing(level: Plane, steep: Plane) -> Hinge | None:
    """The ramp that a steeper plane is, ahead of a level one; None where it is none.

    Along the level floor the plane rises by ``a + b t``: b is the tangent of their difference in
    pitch, a the difference of their heights along the level floor's normal.
    """
    turn = steep.pitch - level.pitch
    if not LEAST_TURN <= abs(turn) <= MOST_TURN:
        return None
    over = (steep.height << SINE_BITS) // int(cosine(turn)) - level.height
    return Hinge((over << SLOPE_BITS) // int(slopes(np.array(turn))), turn)


def ramp_plane(level: Plane, hinge: Hinge) -> Plane:
    """The plane of a ramp; :func:`crossing` gives the ramp back."""
    height = level.height + (hinge.start * hinge.slope >> SLOPE_BITS)
    height = height * int(cosine(hinge.turn)) >> SINE_BITS
    return Plane(level.pitch + hinge.turn, level.roll, height)


def _is_seen(seen: Profile, hinge: Hinge, slack: np.ndarray, unit: float) -> bool:
    """Whether the ramp shows itself from near its start on, over some distance."""
    rise = rises(np.array(hinge.start), np.array(hinge.turn), seen.run)
    telling = np.abs(rise) > slack
    # Where the tolerances of ramp and plane overlap, a cell is the plane's.
    low = np.maximum(rise - slack, slack) if hinge.turn > 0 else rise - slack
    high = rise + slack if hinge.turn > 0 else np.minimum(rise + slack, -slack)
    anew = np.where(telling, seen.under(high) - seen.under(low), 0)
    there = np.where(telling, seen.under(np.maximum(rise, 0) + BELOW * slack), 0)
    total, running = int(anew.sum()), np.cumsum(anew)
    if 100 * total < MIN_SHARE * int(there.sum()) or not total:
        return False
    first, last = (int(seen.run[np.argmax(10 * running >= n * total)]) for n in (1, 9))
    begin = int(seen.run[np.argmax(telling)])
    return first < begin + round(RAMP_NEAR_M / unit) and last - first > round(SPREAD_M / unit)
