"""The two passes of the association: outlines of near frames, then tracklets over gaps."""

from typing import NamedTuple

import numpy as np

from jaxdet.elementary import hypot, log
from jaxdet.tracks.config import TrackConfig
from jaxdet.tracks.hidden import unseen
from jaxdet.tracks.outlines import Outlines, displacement, gap
from jaxdet.tracks.pairs import chain_starts, choose, pairs_of_frames, ranges
from jaxdet.tracks.things import Things

FIT_S = 0.5
"""The velocity at an end of a tracklet is fitted over so much time, and at least to the next
sighting [s]."""
_STEADY_S = 0.1
"""Fits over less time than this are drawn to standing still [s]."""
_STRETCH = 0.1
"""Cost of a change of the sides by a factor of e [m]."""
_LOST_M, _LOST_MPS = 0.35, 0.5
"""How far from where it was expected a thing may be after a gap, and for each second of it."""


def link_frames(things: Things, before: np.ndarray, first: int, config: TrackConfig) -> np.ndarray:
    """First pass: links each thing to one of the frames before, by what its edges moved.

    Frames next to each other first, then those with one frame between them that shows neither,
    and so on. Within two frames the pair that moved least is linked first.

    Args:
        things: ``N`` things.
        before: ``(N,)`` int64, the thing before each, -1 for none.
        first: Things from here on are linked, to those before them or to each other.
        config: The gate.

    Returns:
        ``before`` with those links.
    """
    before = before.copy()
    for apart in range(1, config.max_gap_frames + 1):
        followed = np.zeros(len(before), bool)
        followed[before[before >= 0]] = True
        later = np.arange(first, len(before))
        a, b = pairs_of_frames(things.frame, later[before[first:] < 0], apart)
        open_ = ~followed[a] & (things.in_world[a] == things.in_world[b])
        a, b = a[open_], b[open_]
        cost, near = _frame_cost(things, a, b, config)
        a, b = a[near], b[near]
        taken = choose(a, b, cost[near], len(before))
        before[b[taken]] = a[taken]
    return before


def _frame_cost(
    things: Things, a: np.ndarray, b: np.ndarray, config: TrackConfig
) -> tuple[np.ndarray, np.ndarray]:
    """Cost of each pair [m], and whether it can be one thing."""
    one, other = things.outline.take(a), things.outline.take(b)
    gap_s = (things.stamp_ns[b] - things.stamp_ns[a]) * 1e-9
    moved = np.maximum(displacement(one, other), displacement(other, one))
    middle = hypot(*(other.center - one.center).T)
    reach = config.gate_m + config.max_speed_mps * gap_s
    near = (moved < reach) & (gap_s > 0) & (gap_s <= config.max_gap_s)
    near &= middle < reach + np.abs(one.half - other.half).max(axis=1, initial=0)
    return moved + 0.25 * middle + _STRETCH * _stretch(one, other), near


def _stretch(a: Outlines, b: Outlines) -> np.ndarray:
    return np.abs(log(np.maximum(a.area, 1e-4) / np.maximum(b.area, 1e-4)))


def end_pieces(things: Things, before: np.ndarray, first: int, config: TrackConfig) -> np.ndarray:
    """Ends tracklets where another begins beside them and outlasts them.

    A thing may fall into two pieces. Its tracklet follows one; if that is lost within
    ``max_gap_frames``, the thing goes on as the other, whose tracklet began beside it.

    Args:
        things: ``N`` things.
        before: ``(N,)`` int64, as the first pass left it.
        first: Tracklets that start from here on are looked at.
        config: How near the two are, and for how long.

    Returns:
        ``before`` without the links to and in those last frames.
    """
    root = chain_starts(before)
    end = np.zeros(len(before), np.int64)  # the last frame of each chain, at its first thing
    np.maximum.at(end, root, things.frame)
    starts = np.flatnonzero(before[first:] < 0) + first
    old, new = pairs_of_frames(things.frame, starts, 0)
    lost = end[root[old]] - things.frame[new]
    taken = (lost < config.max_gap_frames) & (end[new] > end[root[old]]) & (before[old] >= 0)
    short = 2 * things.outline.half.max(axis=1) <= config.long_m
    taken &= short[old] & short[new]
    old, new = old[taken], new[taken]
    beside = gap(things.outline.take(old), things.outline.take(new)) <= config.touch_m
    cut = np.full(len(before), np.iinfo(np.int64).max)
    np.minimum.at(cut, root[old[beside]], things.frame[old[beside]])
    return np.where(things.frame >= cut[root], -1, before)


class Tracklets(NamedTuple):
    """``K`` chains of linked things."""

    start: np.ndarray
    """``(K,)`` int64, the first thing of each."""
    end: np.ndarray
    """``(K,)`` int64, the last."""
    length: np.ndarray
    """``(K,)`` int64, things."""
    velocity: np.ndarray
    """``(K, 2, 2)`` float64, at the start and at the end [m/s]."""
    place: np.ndarray
    """``(K, 2, 2)`` float64, likewise the middle, hidden sides put where they would be seen [m]."""


def tracklets_of(things: Things, before: np.ndarray) -> Tracklets:
    """The chains, by their first thing."""
    start, chain = np.unique(chain_starts(before), return_inverse=True)
    count, row = len(start), np.arange(len(before))
    end = np.zeros(count, np.int64)
    np.maximum.at(end, chain, row)
    length = np.bincount(chain, minlength=count)
    center = things.outline.center + unseen(things, chain, count)
    fits = []
    for at, step in ((start, 1), (end, -1)):
        t = (things.stamp_ns - things.stamp_ns[at][chain]) * 1e-9
        chosen = np.abs(t) <= FIT_S
        chosen[_next(chain, at, step)] = True
        shift = center - center[at][chain]
        fits.append(_slopes(chain[chosen], t[chosen], shift[chosen], count))
    places = np.stack([center[start], center[end]], axis=1)
    return Tracklets(start, end, length, np.stack(fits, axis=1), places)


def _next(chain: np.ndarray, at: np.ndarray, step: int) -> np.ndarray:
    """Rows of the sightings ``step`` after those ``at`` in their chains, of chains with more."""
    order = np.argsort(chain, kind="stable")
    place = np.empty(len(chain), np.int64)
    place[order] = np.arange(len(chain))
    found = order[np.clip(place[at] + step, 0, len(chain) - 1)]
    return found[chain[found] == chain[at]]


def _slopes(group: np.ndarray, t: np.ndarray, xy: np.ndarray, count: int) -> np.ndarray:
    """Slopes of lines through the points of each group, ``(count, 2)``."""
    n = np.maximum(np.bincount(group, minlength=count), 1)[:, None]

    def mean(values: np.ndarray) -> np.ndarray:
        return np.bincount(group, values, count)[:, None] / n

    middle_t, spread = mean(t), mean(t * t)
    middle = np.hstack([mean(xy[:, 0]), mean(xy[:, 1])])
    both = np.hstack([mean(t * xy[:, 0]), mean(t * xy[:, 1])])
    return (both - middle_t * middle) / (spread - middle_t**2 + _STEADY_S**2)


def link_tracklets(
    things: Things,
    before: np.ndarray,
    first: int,
    config: TrackConfig,
    late: np.ndarray | None = None,
) -> np.ndarray:
    """Second pass: links the starts of tracklets to ends, where each expects the other.

    Args:
        things: ``N`` things.
        before: ``(N,)`` int64, as the first pass left it.
        first: Tracklets that start from here on are linked.
        config: The longest gap.
        late: Things before that, at which tracklets are linked as well.

    Returns:
        ``before`` with those links.
    """
    track = tracklets_of(things, before)
    long = track.length > 1
    wanted = np.arange(len(before)) >= first
    wanted[[] if late is None else late] = True
    starts = np.flatnonzero(long & wanted[track.start])
    ends = np.flatnonzero(long)
    ends = ends[np.argsort(things.stamp_ns[track.end[ends]], kind="stable")]
    stamp = things.stamp_ns[track.end[ends]]
    begun = things.stamp_ns[track.start[starts]]
    low = np.searchsorted(stamp, begun - round(config.max_gap_s * 1e9), "left")
    count = np.maximum(np.searchsorted(stamp, begun, "left") - low, 0)
    a, b = ends[ranges(low, count)], np.repeat(starts, count)
    cost, near = _gap_cost(things, track, a, b)
    a, b = a[near], b[near]
    taken = choose(a, b, cost[near], len(track.start))
    after = before.copy()
    after[track.start[b[taken]]] = track.end[a[taken]]
    return after


def _gap_cost(
    things: Things, track: Tracklets, a: np.ndarray, b: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Cost of going on from tracklets ``a`` to ``b`` [m], and whether it can be."""
    end, start = track.end[a], track.start[b]
    time = ((things.stamp_ns[start] - things.stamp_ns[end]) * 1e-9)[:, None]
    one, other = things.outline.take(end), things.outline.take(start)
    one = one._replace(center=track.place[a, 1])
    other = other._replace(center=track.place[b, 0])
    forth = one._replace(center=one.center + track.velocity[a, 1] * time)
    back = other._replace(center=other.center - track.velocity[b, 0] * time)
    missed = (displacement(forth, other) + displacement(back, one)) / 2
    cost = missed + _STRETCH * _stretch(one, other)
    same = things.in_world[end] == things.in_world[start]
    return cost, same & (cost < _LOST_M + _LOST_MPS * time[:, 0])
