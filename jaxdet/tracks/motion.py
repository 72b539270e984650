"""Position and velocity of a track in each of its frames, and whether it moves."""

from typing import NamedTuple

import numpy as np

from jaxdet.elementary import hypot
from jaxdet.tracks.config import TrackConfig
from jaxdet.tracks.observations import Observations
from jaxdet.tracks.occlusion import hidden_shift
from jaxdet.tracks.pairs import ranges

GUESSED = 0.05
"""Weight of interpolated edges, in frames without an observation."""
LONGER, MERGED = 1.6, 0.1
"""Ratio to the median length above which an outline counts as merged with another object, and the
weight of such outlines."""
STEADY_S = 0.02
"""Regularisation: velocities fitted over less time than this shrink toward zero [s]."""


class Motion(NamedTuple):
    """Trajectories of ``K`` tracks with ``P`` points in total, track by track, one per frame."""

    first: np.ndarray
    """Index of the first point of each track, ``(K,)`` int64. A track has a point for each frame
    from its first to its last."""
    position: np.ndarray
    """Centre of the outline, ``(P, 2)`` float64 [m]."""
    velocity: np.ndarray
    """Velocity ``(P, 2)`` float64 [m/s], 0 for stationary tracks."""
    moving: np.ndarray
    """Whether each track moves, ``(K,)`` bool."""


def motion_of(
    obs: Observations, first: np.ndarray, stamps: np.ndarray, start: int, config: TrackConfig
) -> Motion:
    """Fit the trajectories of tracks.

    Outlines are corrected for hidden sides. Their edges are interpolated between observations, and
    smoothed by a line fit over ``smooth_s`` before and after each frame.

    Args:
        obs: Observations by track, then by frame.
        first: First observation of each track, ``(K,)``.
        stamps: Timestamps of the log's frames from ``start`` on [ns].
        start: Index of the first of these frames in the log.
        config: Tracking parameters.
    """
    last = np.append(first[1:], len(obs.frame)) - 1
    count = obs.frame[last] - obs.frame[first] + 1
    starts = np.cumsum(count) - count
    track = np.repeat(np.arange(len(first)), count)
    stamp = stamps[ranges(obs.frame[first] - start, count)]
    time = (stamp - stamp[starts][track]) * 1e-9
    length, usual = _lengths(obs, first)
    longer = length > LONGER * np.repeat(usual, np.diff(np.append(first, len(length))))
    obs = obs._replace(weight=np.where(longer, MERGED, 1) * obs.weight)
    own_track = np.searchsorted(first, np.arange(len(length)), "right") - 1
    shift = hidden_shift(obs, own_track, len(first))
    edges = _edges(obs) + np.hstack([shift, shift])
    edges, weight = _interpolated_edges(obs, edges, starts, first, stamp)
    line, slope = _fitted_lines(track, time, edges, weight, config.smooth_s)
    velocity = _middle(slope)
    # In a track of a few frames, noise can look like a higher speed.
    possible = _medians(hypot(*velocity.T), track, starts) <= config.max_speed_mps
    moving = _is_moving(line, edges, weight, starts, track, usual, config) & possible
    velocity *= moving[track, None]
    return Motion(starts, _middle(line), velocity, moving)


def _middle(edges: np.ndarray) -> np.ndarray:
    """Return the centres ``(N, 2)`` of edges ``(N, 4)``."""
    return (edges[:, :2] + edges[:, 2:]) / 2


def _edges(obs: Observations) -> np.ndarray:
    """Return the bounds of each outline, ``(N, 4)``: minimum x and y, maximum x and y [m]."""
    outline = obs.outline
    directions = (np.broadcast_to(direction, outline.axis.shape) for direction in np.eye(2))
    reach = np.stack([outline.reach(direction) for direction in directions], axis=1)
    return np.hstack([outline.center - reach, outline.center + reach])


def _lengths(obs: Observations, first: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the longer side of each outline ``(N,)``, and its median per track ``(K,)`` [m]."""
    track = np.searchsorted(first, np.arange(len(obs.frame)), "right") - 1
    length = 2 * obs.outline.half.max(axis=1)
    return length, _medians(length, track, first)


def _medians(values: np.ndarray, track: np.ndarray, first: np.ndarray) -> np.ndarray:
    """Return the upper median of values ``(N,)`` per track; tracks start at ``first`` ``(K,)``."""
    count = np.diff(np.append(first, len(values)))
    return values[np.lexsort((values, track))][first + count // 2]


def _is_moving(
    line: np.ndarray,
    edges: np.ndarray,
    weight: np.ndarray,
    starts: np.ndarray,
    track: np.ndarray,
    usual: np.ndarray,
    config: TrackConfig,
) -> np.ndarray:
    """Return which tracks move, ``(K,)``: both ends and the centre are displaced beyond noise.

    The limits are stricter for objects with a large median length ``usual`` ``(K,)`` [m], because
    parts of a wall appear and disappear, so that the ends of its outline jump.
    """
    shift = line - line[starts][track]
    low, high = shift[:, :2], shift[:, 2:]
    least = np.minimum(np.minimum(np.abs(low), np.abs(high)), np.abs(low + high) / 2).max(axis=1)
    size = np.maximum.reduceat((line[:, 2:] - line[:, :2]).max(axis=1), starts)
    square = np.add.reduceat(weight[:, None] * (edges - line) ** 2, starts)
    noise = np.sqrt(square / np.add.reduceat(weight, starts)[:, None]).max(axis=1)
    far = np.maximum.reduceat(least, starts)
    middle = np.maximum.reduceat(hypot(*(low + high).T) / 2, starts)
    short = (far > config.moving_m / 2) & (middle > np.maximum(config.moving_m, 1.2 * noise))
    long = (far > np.maximum(0.2 * size, 3 * noise)) & (far > config.moving_m)
    return np.where(usual <= config.long_m, short, long & (noise <= config.noise_m))


def _interpolated_edges(
    obs: Observations, edges: np.ndarray, starts: np.ndarray, first: np.ndarray, stamp: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Interpolate edges linearly to all frames, ``(P, 4)``, and return their weights ``(P,)``."""
    track = np.searchsorted(first, np.arange(len(obs.frame)), "right") - 1
    point = starts[track] + obs.frame - obs.frame[first][track]
    observed = np.zeros(len(stamp), bool)
    observed[point] = True
    before = np.cumsum(observed) - 1
    after = before + ~observed
    whole = np.maximum(stamp[point[after]] - stamp[point[before]], 1)
    share = (stamp - stamp[point[before]]) / whole
    filled = edges[before] + share[:, None] * (edges[after] - edges[before])
    return filled, np.where(observed, obs.weight[before], GUESSED)


def _fitted_lines(
    track: np.ndarray, time: np.ndarray, values: np.ndarray, weight: np.ndarray, reach_s: float
) -> tuple[np.ndarray, np.ndarray]:
    """Fit a line to the values within ``reach_s`` of each point: value and slope, ``(P, V)``.

    At both ends of a track the window is shifted inward, so that at least three quarters of it are
    inside the track. A point without others in its window is fitted with its neighbours.
    """
    ends = np.flatnonzero(np.diff(track, append=-1))
    first, last = time[np.append(0, ends[:-1] + 1)][track], time[ends][track]
    inner = np.minimum(reach_s / 2, (last - first) / 2)
    middle = np.clip(time, first + inner, last - inner)
    lonely = _are_lonely(track, time, middle, reach_s)
    n = weight.copy()
    st, stt = np.zeros(len(track)), np.zeros(len(track))
    sv, stv = np.zeros_like(values), np.zeros_like(values)
    for sign in (-1, 1):
        for step in range(1, len(track)):
            here = np.s_[step:] if sign < 0 else np.s_[:-step]
            there = np.s_[:-step] if sign < 0 else np.s_[step:]
            t = time[there] - time[here]
            near = np.abs(time[there] - middle[here]) <= reach_s
            near |= lonely[here] & (step == 1)
            near &= track[there] == track[here]
            if not near.any():
                break
            w = np.where(near, weight[there], 0.0)
            wt, shift = w * t, values[there] - values[here]
            n[here] += w
            st[here] += wt
            stt[here] += wt * t
            sv[here] += w[:, None] * shift
            stv[here] += wt[:, None] * shift
    mean_t, mean_v = st / n, sv / n[:, None]
    spread = stt / n - mean_t**2
    slope = (stv / n[:, None] - mean_t[:, None] * mean_v) / (spread + STEADY_S**2)[:, None]
    return values + mean_v - slope * mean_t[:, None], slope


def _are_lonely(
    track: np.ndarray, time: np.ndarray, middle: np.ndarray, reach_s: float
) -> np.ndarray:
    """Return which points have no other point of their track within ``reach_s``, ``(P,)`` bool."""
    apart = np.full((2, len(track)), np.nan)
    same = track[1:] == track[:-1]
    apart[0, 1:][same] = np.abs(time[:-1] - middle[1:])[same]
    apart[1, :-1][same] = np.abs(time[1:] - middle[:-1])[same]
    return np.fmin(*apart) > reach_s
