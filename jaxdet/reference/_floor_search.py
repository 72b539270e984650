"""Where planes are looked for: near a guess, or in all directions that cameras have."""

import numpy as np

from jaxdet.floor.units import (
    ANGLES,
    BIN_M,
    HEIGHTS_M,
    NEAR_M,
    RINGS_M,
    STEEP_M,
    STEEPEST,
    STEP_DEG,
    Scale,
)
from jaxdet.reference._floor_planes import (
    BELOW_COST,
    Plane,
    Sample,
    along,
    below,
    down_units,
    refined,
    score,
)

PITCHES_DEG, ROLLS_DEG = (-15, 72), (-30, 30)
"""Its tilts; a wall in front of a level camera is as a floor at 90 degrees."""
ROLLED_DEG = 40  # most that a plane found from there may be rolled
FILLS_DEG, FILLS = 35, 12
"""The more a camera is pitched, the more floor it sees: for each degree beyond, a plane must show
so much more of the cells [per mille]."""
WINNERS = 6  # so many of the first planes are looked at more closely
APART = 12  # planes of neighbouring directions within so many bins are one
NEAR_DEG, STEEP_DEG = 4, 8
"""Planes are looked for so far in pitch from a guess, in roll within the first, and one so far."""
LEAST = np.iinfo(np.int64).min  # fewer votes than any plane has
RINGS = len(RINGS_M) + 1  # planes are also looked for among the cells up to each
MIN_SHARE = 3  # they must be so many percent of all


def vote(
    cells: Sample,
    down: np.ndarray,
    slack: np.ndarray,
    heights: tuple[int, int, int],
    ring: np.ndarray,
    rings: int,
) -> np.ndarray:
    """:func:`score` of all planes of some directions and heights, by the cells up to each ring.

    But what lies lower than the tolerance counts as clearly below: it has room for the lattice's
    steps. This is a Hough transform: for a direction a cell votes for a range of heights, so the
    ends of the ranges are counted, and their prefix sums are the score.

    Args:
        cells: ``K`` of them.
        down: ``(D, 3)`` directions.
        slack: ``(K,)`` tolerance [depth units].
        heights: The least [depth units], how many, and ``bits``: they are ``2**bits`` apart.
        ring: ``(K,)`` int64, the ring of each cell.
        rings: How many there are.

    Returns:
        ``(rings, D, bins)`` int64.
    """
    lowest, bins, bits = heights
    height = along(down, cells) - lowest
    shape = rings, len(down), bins + 1
    row = (ring * shape[1] + np.arange(shape[1])[:, None]) * shape[2]
    ends = (
        (-((slack - height) >> bits), 1 + BELOW_COST),
        (((height + slack) >> bits) + 1, -1),
    )
    out = np.zeros(shape, np.int64)
    for end, worth in ends:
        place = (row + np.clip(end, 0, bins)).ravel()
        out += worth * np.bincount(place, minlength=out.size).reshape(shape)
    votes = np.cumsum(np.cumsum(out, axis=2), axis=0)[..., :bins]
    below_all = BELOW_COST * np.cumsum(np.bincount(ring, minlength=rings))
    return votes - below_all[:, None, None]


def peaks(votes: np.ndarray, count: int, reach: int) -> np.ndarray:
    """The best planes of a lattice of pitch, roll and height, by non-maximum suppression.

    Args:
        votes: ``(P, R, bins)``.
        count: How many.
        reach: Planes of neighbouring directions whose heights differ by so many bins are one.

    Returns:
        ``(count, 3)`` indices, best first.
    """
    left, out = votes.copy(), []
    for _ in range(count):
        p, r, h = (int(i) for i in np.unravel_index(np.argmax(left), left.shape))
        out.append((p, r, h))
        part = tuple(slice(max(i - n, 0), i + n + 1) for i, n in ((p, 1), (r, 1), (h, reach)))
        left[part] = LEAST
    return np.array(out)


def _lattice(center: int, reach: tuple[int, int], step: int) -> np.ndarray:
    return center + ANGLES * np.arange(reach[0], reach[1] + 1, step)


def _heights(low: int, high: int, scale: Scale) -> tuple[int, int, int]:
    """The least height, how many there are, and the power of two between them."""
    bits = scale.bits(BIN_M)
    return low, ((high - low) >> bits) + 1, bits


class _Lattice:
    """Votes for planes on a lattice of pitch, roll and height, by rings."""

    def __init__(self, pitch: np.ndarray, roll: np.ndarray, heights: tuple[int, int, int]) -> None:
        self.pitch, self.roll, self.heights = np.clip(pitch, -STEEPEST, STEEPEST), roll, heights

    def votes(self, cells: Sample, slack: np.ndarray, ring: np.ndarray, rings: int) -> np.ndarray:
        """``(rings, P, R, bins)`` int64."""
        down = down_units(self.pitch[:, None], self.roll[None]).reshape(-1, 3)
        votes = vote(cells, down, slack, self.heights, ring, rings)
        return votes.reshape(rings, len(self.pitch), len(self.roll), -1)

    def best(self, votes: np.ndarray, count: int) -> list[Plane]:
        """The planes with most votes ``(P, R, bins)``."""
        lowest, _, bits = self.heights
        return [
            Plane(int(self.pitch[i]), int(self.roll[j]), lowest + (k << bits))
            for i, j, k in peaks(votes, count, APART).tolist()
        ]


def rings(cells: Sample, scale: Scale) -> np.ndarray:
    """The ring of each cell, ``(K,)`` int64, by depth."""
    return np.searchsorted([scale.length(m) for m in RINGS_M], cells.z)


def shown(ring: np.ndarray) -> np.ndarray:
    """The rings up to which there are enough cells to tell a plane."""
    count = np.cumsum(np.bincount(ring, minlength=RINGS))
    return np.flatnonzero(100 * count >= MIN_SHARE * len(ring))


def is_usual(plane: Plane) -> bool:
    """Whether a camera on a robot or in a hand can be so tilted: no wall is a floor."""
    low, high = (n * ANGLES for n in PITCHES_DEG)
    tilted = low <= plane.pitch <= high and abs(plane.roll) <= ROLLED_DEG * ANGLES
    return tilted and plane.height > 0


def least_share(plane: Plane, least: int) -> int:
    """The share of the cells that a plane must show [per mille], ``least`` of a level camera."""
    return least + (FILLS * max(plane.pitch - FILLS_DEG * ANGLES, 0)) // ANGLES


def near_planes(cells: Sample, guess: Plane, prior: Plane | None, scale: Scale) -> list[Plane]:
    """Planes near a guess: for each ring the best of the cells up to it, and of all cells three.

    The last of them may be steeper than the others.

    Args:
        cells: ``K`` of them.
        guess: In the middle of what is tried.
        prior: What is known of the angles; None: nothing.
        scale: The depth unit.
    """
    span = scale.length(STEEP_M)
    lattice = _Lattice(
        _lattice(guess.pitch, (-STEEP_DEG, STEEP_DEG), 1),
        _lattice(guess.roll, (-NEAR_DEG, NEAR_DEG), 1),
        _heights(guess.height - span, guess.height + span, scale),
    )
    ring = rings(cells, scale)
    votes = lattice.votes(cells, scale.coarse(cells.z, 1), ring, RINGS)
    near = votes.copy()
    edge = (span - scale.length(NEAR_M)) >> scale.bits(BIN_M)
    for axis, n in ((1, STEEP_DEG - NEAR_DEG), (3, edge)):
        np.moveaxis(near, axis, 0)[np.r_[:n, near.shape[axis] - n : near.shape[axis]]] = LEAST
    out = []
    for n in shown(ring):
        some, whole = cells.take(ring <= n), n == RINGS - 1
        planes = lattice.best(near[n], 2 if whole else 1)
        planes += lattice.best(votes[n], 1) if whole else []
        out += [refined(plane, some, (2, 2, 1), prior, scale) for plane in planes]
    return out


def any_plane(cells: Sample, least: int, scale: Scale) -> Plane:
    """The best floor of any camera that a robot or a hand holds.

    For each ring the best plane of the cells up to it is looked at more closely, and of all cells
    ``WINNERS``: far walls fill the picture of a low camera, and where little of its floor is
    measured, it has most votes only among the nearest cells. Of these the usual one with most votes
    beyond what it must show (:func:`least_share`) is the floor.
    """
    once, span = np.zeros(len(cells.z), np.int64), scale.length(STEEP_M)
    low, high = (scale.length(m) for m in HEIGHTS_M)
    wide = _Lattice(
        _lattice(0, PITCHES_DEG, STEP_DEG),
        _lattice(0, ROLLS_DEG, STEP_DEG),
        _heights(low, high, scale),
    )
    ring = rings(cells, scale)
    votes = wide.votes(cells, scale.coarse(cells.z, STEP_DEG), ring, RINGS)
    planes = [p for n in shown(ring) for p in wide.best(votes[n], WINNERS if n == RINGS - 1 else 1)]
    best = []
    for plane in planes:
        close = _Lattice(
            _lattice(plane.pitch, (-1, 1), 1),
            _lattice(plane.roll, (-1, 1), 1),
            _heights(plane.height - span, plane.height + span, scale),
        )
        [plane] = close.best(close.votes(cells, scale.coarse(cells.z, 1), once, 1)[0], 1)
        plane = refined(plane, cells, (2, 2, 0), None, scale)
        votes = int(score(below(plane, cells), scale.fine.of(cells.z, plane.height)))
        more = 1000 * votes - least_share(plane, least) * len(cells.z)
        best.append((is_usual(plane), more, plane))
    return max(best, key=lambda found: found[:2])[-1]
