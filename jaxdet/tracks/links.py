"""Data association in two passes: outlines of nearby frames, then tracklets across gaps."""

from typing import NamedTuple

import numpy as np

from jaxdet.elementary import hypot, log
from jaxdet.tracks.config import TrackConfig
from jaxdet.tracks.observations import Observations
from jaxdet.tracks.occlusion import hidden_shift
from jaxdet.tracks.outlines import Outlines, displacement, gap
from jaxdet.tracks.pairs import chain_starts, greedy_matching, pairs_of_frames, ranges

FIT_S = 0.5
"""Time over which the velocity at an end of a tracklet is fitted [s]; the observation next to the
end is used even if it is farther away in time."""
_STEADY_S = 0.1
"""Regularisation: velocities fitted over less time than this shrink toward zero [s]."""
_STRETCH = 0.1
"""Cost of a change in area by a factor of e [m]."""
_LOST_M, _LOST_MPS = 0.35, 0.5
"""Gate on the prediction error after a gap: a constant [m], and its increase with time [m/s]."""


def link_frames(
    obs: Observations, before: np.ndarray, first: int, config: TrackConfig
) -> np.ndarray:
    """Link observations to earlier ones by the motion of their edges (first pass).

    Consecutive frames are linked first, then frames with one frame between them, and so on. Between
    two frames, the pair that moved least is linked first.

    Args:
        obs: ``N`` observations.
        before: Index of the previous observation of each, ``(N,)`` int64, -1 for none.
        first: Index of the first observation that may be linked to an earlier one.
        config: Tracking parameters with the gate.

    Returns:
        ``before`` with the new links.
    """
    before = before.copy()
    for apart in range(1, config.max_gap_frames + 1):
        followed = np.zeros(len(before), bool)
        followed[before[before >= 0]] = True
        later = np.arange(first, len(before))
        a, b = pairs_of_frames(obs.frame, later[before[first:] < 0], apart)
        open_ = ~followed[a] & (obs.in_world[a] == obs.in_world[b])
        a, b = a[open_], b[open_]
        cost, near = _frame_cost(obs, a, b, config)
        a, b = a[near], b[near]
        taken = greedy_matching(a, b, cost[near], len(before))
        before[b[taken]] = a[taken]
    return before


def _frame_cost(
    obs: Observations, a: np.ndarray, b: np.ndarray, config: TrackConfig
) -> tuple[np.ndarray, np.ndarray]:
    """Return the cost of each pair [m], and whether it is inside the gate."""
    one, other = obs.outline.take(a), obs.outline.take(b)
    gap_s = (obs.stamp_ns[b] - obs.stamp_ns[a]) * 1e-9
    moved = np.maximum(displacement(one, other), displacement(other, one))
    middle = hypot(*(other.center - one.center).T)
    reach = config.gate_m + config.max_speed_mps * gap_s
    near = (moved < reach) & (gap_s > 0) & (gap_s <= config.max_gap_s)
    near &= middle < reach + np.abs(one.half - other.half).max(axis=1, initial=0)
    return moved + 0.25 * middle + _STRETCH * _stretch(one, other), near


def _stretch(a: Outlines, b: Outlines) -> np.ndarray:
    return np.abs(log(np.maximum(a.area, 1e-4) / np.maximum(b.area, 1e-4)))


def end_pieces(
    obs: Observations, before: np.ndarray, first: int, config: TrackConfig
) -> np.ndarray:
    """End tracklets at a split if they follow the fragment that is lost.

    A detection splits if a new tracklet starts next to it. If the fragment that the old tracklet
    follows is lost within ``max_gap_frames`` and the other one lasts longer, the object continues
    as the other fragment. So the old tracklet ends at the split.

    Args:
        obs: ``N`` observations.
        before: Result of the first pass, ``(N,)`` int64.
        first: Index of the first observation at which new tracklets are examined.
        config: Limits of distance and time.

    Returns:
        ``before`` without the links of these tracklets from the split on.
    """
    root = chain_starts(before)
    end = np.zeros(len(before), np.int64)  # last frame of each chain, stored at its first row
    np.maximum.at(end, root, obs.frame)
    starts = np.flatnonzero(before[first:] < 0) + first
    old, new = pairs_of_frames(obs.frame, starts, 0)
    lost = end[root[old]] - obs.frame[new]
    taken = (lost < config.max_gap_frames) & (end[new] > end[root[old]]) & (before[old] >= 0)
    short = 2 * obs.outline.half.max(axis=1) <= config.long_m
    taken &= short[old] & short[new]
    old, new = old[taken], new[taken]
    adjacent = gap(obs.outline.take(old), obs.outline.take(new)) <= config.touch_m
    cut = np.full(len(before), np.iinfo(np.int64).max)
    np.minimum.at(cut, root[old[adjacent]], obs.frame[old[adjacent]])
    return np.where(obs.frame >= cut[root], -1, before)


class Tracklets(NamedTuple):
    """``K`` chains of linked observations."""

    start: np.ndarray
    """First observation of each chain, ``(K,)`` int64."""
    end: np.ndarray
    """Last observation of each chain, ``(K,)`` int64."""
    length: np.ndarray
    """Number of observations, ``(K,)`` int64."""
    velocity: np.ndarray
    """Velocities at the start and at the end, ``(K, 2, 2)`` float64 [m/s]."""
    position: np.ndarray
    """Centres at the start and at the end, corrected for hidden sides, ``(K, 2, 2)`` float64 [m].
    """


def tracklets_of(obs: Observations, before: np.ndarray) -> Tracklets:
    """Return the tracklets, in the order of their first observations."""
    start, chain = np.unique(chain_starts(before), return_inverse=True)
    count, row = len(start), np.arange(len(before))
    end = np.zeros(count, np.int64)
    np.maximum.at(end, chain, row)
    length = np.bincount(chain, minlength=count)
    center = obs.outline.center + hidden_shift(obs, chain, count)
    fits = []
    for at, step in ((start, 1), (end, -1)):
        t = (obs.stamp_ns - obs.stamp_ns[at][chain]) * 1e-9
        chosen = np.abs(t) <= FIT_S
        chosen[_next(chain, at, step)] = True
        shift = center - center[at][chain]
        fits.append(_slopes(chain[chosen], t[chosen], shift[chosen], count))
    places = np.stack([center[start], center[end]], axis=1)
    return Tracklets(start, end, length, np.stack(fits, axis=1), places)


def _next(chain: np.ndarray, at: np.ndarray, step: int) -> np.ndarray:
    """Return the rows ``step`` observations after the rows ``at`` in their chains, if any."""
    order = np.argsort(chain, kind="stable")
    position = np.empty(len(chain), np.int64)
    position[order] = np.arange(len(chain))
    rows = order[np.clip(position[at] + step, 0, len(chain) - 1)]
    return rows[chain[rows] == chain[at]]


def _slopes(group: np.ndarray, t: np.ndarray, xy: np.ndarray, count: int) -> np.ndarray:
    """Fit a line to the points of each group; return the slopes ``(count, 2)``."""
    n = np.maximum(np.bincount(group, minlength=count), 1)[:, None]

    def mean(values: np.ndarray) -> np.ndarray:
        return np.bincount(group, values, count)[:, None] / n

    middle_t, spread = mean(t), mean(t * t)
    middle = np.hstack([mean(xy[:, 0]), mean(xy[:, 1])])
    both = np.hstack([mean(t * xy[:, 0]), mean(t * xy[:, 1])])
    return (both - middle_t * middle) / (spread - middle_t**2 + _STEADY_S**2)


def link_tracklets(
    obs: Observations,
    before: np.ndarray,
    first: int,
    config: TrackConfig,
    late: np.ndarray | None = None,
) -> np.ndarray:
    """Link ends of tracklets to starts of later ones across gaps (second pass).

    The prediction of the earlier tracklet forward in time must agree with the later one, as must
    the prediction of the later tracklet backward with the earlier one.

    Args:
        obs: ``N`` observations.
        before: Result of the first pass, ``(N,)`` int64.
        first: Index of the first observation at which tracklets are linked.
        config: Tracking parameters; the maximum gap is used.
        late: Indices of earlier observations at which tracklets are linked as well.

    Returns:
        ``before`` with the new links.
    """
    track = tracklets_of(obs, before)
    long = track.length > 1
    wanted = np.arange(len(before)) >= first
    wanted[[] if late is None else late] = True
    starts = np.flatnonzero(long & wanted[track.start])
    ends = np.flatnonzero(long)
    ends = ends[np.argsort(obs.stamp_ns[track.end[ends]], kind="stable")]
    stamp = obs.stamp_ns[track.end[ends]]
    begun = obs.stamp_ns[track.start[starts]]
    low = np.searchsorted(stamp, begun - round(config.max_gap_s * 1e9), "left")
    count = np.maximum(np.searchsorted(stamp, begun, "left") - low, 0)
    a, b = ends[ranges(low, count)], np.repeat(starts, count)
    cost, near = _gap_cost(obs, track, a, b)
    a, b = a[near], b[near]
    taken = greedy_matching(a, b, cost[near], len(track.start))
    after = before.copy()
    after[track.start[b[taken]]] = track.end[a[taken]]
    return after


def _gap_cost(
    obs: Observations, track: Tracklets, a: np.ndarray, b: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the cost of linking tracklets ``a`` to ``b`` [m], and whether it passes the gate."""
    end, start = track.end[a], track.start[b]
    time = ((obs.stamp_ns[start] - obs.stamp_ns[end]) * 1e-9)[:, None]
    one, other = obs.outline.take(end), obs.outline.take(start)
    one = one._replace(center=track.position[a, 1])
    other = other._replace(center=track.position[b, 0])
    forth = one._replace(center=one.center + track.velocity[a, 1] * time)
    back = other._replace(center=other.center - track.velocity[b, 0] * time)
    missed = (displacement(forth, other) + displacement(back, one)) / 2
    cost = missed + _STRETCH * _stretch(one, other)
    same = obs.in_world[end] == obs.in_world[start]
    return cost, same & (cost < _LOST_M + _LOST_MPS * time[:, 0])
