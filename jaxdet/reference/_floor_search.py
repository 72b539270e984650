"""Search for floor planes, near a guess or over all usual camera poses."""

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
"""Usual pitch and roll of cameras. They exclude walls: a wall in front of a level camera is like
the floor of a camera pitched by 90 degrees.
"""
ROLLED_DEG = 40  # maximum roll of a plane after refinement
FILLS_DEG, FILLS = 35, 12
"""Increase of the minimum inlier fraction per degree of pitch beyond ``FILLS_DEG`` [per mille]: the
more a camera is pitched, the more floor it sees."""
WINNERS = 6  # number of planes that are refined, those with the most votes
APART = 12
"""Planes of neighbouring directions whose heights differ by at most this many bins are the same."""
NEAR_DEG, STEEP_DEG = 4, 8
"""Search range to both sides of a guess: ``NEAR_DEG`` in pitch and roll, and for one steep plane
``STEEP_DEG`` in pitch."""
LEAST = np.iinfo(np.int64).min  # fewer votes than any plane has
RINGS = len(RINGS_M) + 1  # number of rings, which divide the cells by depth
MIN_SHARE = 3
"""Minimum fraction of the cells that are in a ring or nearer, for a search among only these cells
[percent]."""


def vote(
    cells: Sample,
    down: np.ndarray,
    slack: np.ndarray,
    heights: tuple[int, int, int],
    ring: np.ndarray,
    rings: int,
) -> np.ndarray:
    """Compute :func:`score` of planes by direction and height, with the cells up to each ring.

    In contrast to :func:`score`, cells lower than the tolerance count as clearly below, because the
    tolerance includes the spacing of the lattice. This is a Hough transform: for a direction a cell
    votes for a range of heights, so the ends of the ranges are counted, and their prefix sums are
    the score.

    Args:
        cells: ``K`` cells.
        down: Directions ``(D, 3)``.
        slack: Tolerance ``(K,)`` [depth units].
        heights: Smallest height [depth units], number of heights, and ``bits``: their spacing is
            ``2**bits``.
        ring: Ring of each cell, ``(K,)`` int64.
        rings: Number of rings.

    Returns:
        Votes ``(rings, D, bins)`` int64.
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
    """Find the best planes of a lattice of pitch, roll and height, by non-maximum suppression.

    Args:
        votes: Votes ``(P, R, bins)``, by pitch, roll and bin of height.
        count: Number of planes.
        reach: Planes of neighbouring directions whose heights differ by at most this many bins are
            the same.

    Returns:
        Indices ``(count, 3)``, best first.
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
    """Return the smallest height, the number of heights, and the exponent of their spacing."""
    bits = scale.bits(BIN_M)
    return low, ((high - low) >> bits) + 1, bits


class _Lattice:
    """Votes for planes on a lattice of pitch, roll and height, by rings."""

    def __init__(self, pitch: np.ndarray, roll: np.ndarray, heights: tuple[int, int, int]) -> None:
        self.pitch, self.roll, self.heights = np.clip(pitch, -STEEPEST, STEEPEST), roll, heights

    def votes(self, cells: Sample, slack: np.ndarray, ring: np.ndarray, rings: int) -> np.ndarray:
        """Return the votes ``(rings, P, R, bins)`` int64."""
        down = down_units(self.pitch[:, None], self.roll[None]).reshape(-1, 3)
        votes = vote(cells, down, slack, self.heights, ring, rings)
        return votes.reshape(rings, len(self.pitch), len(self.roll), -1)

    def best(self, votes: np.ndarray, count: int) -> list[Plane]:
        """Return the ``count`` planes with the most ``votes``, ``(P, R, bins)``."""
        lowest, _, bits = self.heights
        return [
            Plane(int(self.pitch[i]), int(self.roll[j]), lowest + (k << bits))
            for i, j, k in peaks(votes, count, APART).tolist()
        ]


def rings(cells: Sample, scale: Scale) -> np.ndarray:
    """Return the ring of each cell, ``(K,)`` int64, by depth."""
    return np.searchsorted([scale.length(m) for m in RINGS_M], cells.z)


def shown(ring: np.ndarray) -> np.ndarray:
    """Return the rings up to which there are enough cells for a plane."""
    count = np.cumsum(np.bincount(ring, minlength=RINGS))
    return np.flatnonzero(100 * count >= MIN_SHARE * len(ring))


def is_usual(plane: Plane) -> bool:
    """Return whether the camera's tilt is usual on a robot or in a hand, which excludes walls."""
    low, high = (n * ANGLES for n in PITCHES_DEG)
    tilted = low <= plane.pitch <= high and abs(plane.roll) <= ROLLED_DEG * ANGLES
    return tilted and plane.height > 0


def least_share(plane: Plane, least: int) -> int:
    """Return the minimum inlier fraction of a plane [per mille], ``least`` for a level camera."""
    return least + (FILLS * max(plane.pitch - FILLS_DEG * ANGLES, 0)) // ANGLES


def near_planes(cells: Sample, guess: Plane, prior: Plane | None, scale: Scale) -> list[Plane]:
    """Find planes near a guess: the best one of the cells up to each ring, and three of all cells.

    The last plane may be steeper than the others.

    Args:
        cells: ``K`` cells.
        guess: Centre of the search range.
        prior: Prior of the angles, or None.
        scale: Depth unit.
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
    """Find the best floor without a prior, for any usual pose of the camera.

    The best plane of the cells up to each ring and the ``WINNERS`` best of all cells are refined:
    far walls fill the image of a low camera, and if little of its floor is measured, the floor has
    the most votes only among the nearest cells. The result is the usual plane with the most votes
    beyond its minimum inlier fraction (:func:`least_share`).
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
