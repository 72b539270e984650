"""Where a track was in each frame from its first to its last, how fast, and whether it moved."""

from typing import NamedTuple

import numpy as np

from jaxdet.tracks.config import TrackConfig
from jaxdet.tracks.pairs import ranges
from jaxdet.tracks.things import Things

GUESSED = 0.05
"""Weight of a frame between sightings."""
STEADY_S = 0.02
"""Fits over less time than this are drawn to standing still [s]."""


class Motion(NamedTuple):
    """``K`` tracks; ``P`` points, those of the first track first, one a frame."""

    first: np.ndarray
    """``(K,)`` int64, the first point of each."""
    count: np.ndarray
    """``(K,)`` int64, its points: its frames from the first to the last."""
    place: np.ndarray
    """``(P, 2)`` float64, middle of the outline [m]."""
    velocity: np.ndarray
    """``(P, 2)`` float64 [m/s]."""
    moving: np.ndarray
    """``(K,)`` bool."""


def motion_of(
    things: Things, first: np.ndarray, stamps: np.ndarray, config: TrackConfig
) -> Motion:
    """Fits the ways of tracks.

    Between sightings the outline's edges are interpolated; over ``smooth_s`` before and after each
    frame they are lines.

    Args:
        things: Sightings, those of the first track first, each track's by frame.
        first: ``(K,)``, the first sighting of each track.
        stamps: Stamps of the log's frames [ns].
        config: Times and limits.
    """
    last = np.append(first[1:], len(things.frame)) - 1
    count = things.frame[last] - things.frame[first] + 1
    starts = np.cumsum(count) - count
    track = np.repeat(np.arange(len(first)), count)
    frame = ranges(things.frame[first], count)
    stamp = stamps[frame]
    time = (stamp - stamp[starts][track]) * 1e-9
    reach = np.stack([things.outline.reach(np.broadcast_to(way, things.outline.axis.shape))
                      for way in np.eye(2)], 1)
    edges = np.hstack([things.outline.center - reach, things.outline.center + reach])
    edges, weight = _filled(things, edges, starts, first, stamp)
    line, slope = _fitted(track, time, edges, weight, config.smooth_s)
    low, high = line[:, :2], line[:, 2:]
    base = line[starts][track]
    shift = np.stack([line - base, np.roll(line - base, 2, axis=1)])
    middle = np.abs(shift.sum(0)[:, :2] / 2)
    ends = np.minimum(*np.abs(np.split(line - base, 2, axis=1)))
    least = np.minimum(ends, middle).max(axis=1)
    farthest = np.maximum.reduceat(least, starts)
    size = np.maximum.reduceat((high - low).max(axis=1), starts)
    moving = farthest > np.maximum(config.moving_m, 0.2 * size)
    velocity = (slope[:, :2] + slope[:, 2:]) / 2 * moving[track, None]
    return Motion(starts, count, (low + high) / 2, velocity, moving)


def _filled(
    things: Things, edges: np.ndarray, starts: np.ndarray, first: np.ndarray, stamp: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Edges in all frames, ``(P, 4)``, by lines between sightings, and their weights, ``(P,)``."""
    track = np.searchsorted(first, np.arange(len(things.frame)), "right") - 1
    point = starts[track] + things.frame - things.frame[first][track]
    known = np.zeros(len(stamp), bool)
    known[point] = True
    before = np.cumsum(known) - 1
    after = np.minimum(before + ~known, len(point) - 1)
    whole = np.maximum(stamp[point[after]] - stamp[point[before]], 1)
    share = (stamp - stamp[point[before]]) / whole
    filled = edges[before] + share[:, None] * (edges[after] - edges[before])
    return filled, np.where(known, things.weight[before], GUESSED)


def _fitted(
    track: np.ndarray, time: np.ndarray, values: np.ndarray, weight: np.ndarray, reach_s: float
) -> tuple[np.ndarray, np.ndarray]:
    """Lines through the values within ``reach_s`` of each point: value and slope, ``(P, V)``."""
    n = weight.copy()
    st, stt = np.zeros(len(track)), np.zeros(len(track))
    sv, stv = np.zeros_like(values), np.zeros_like(values)
    for sign in (-1, 1):
        for step in range(1, len(track)):
            here = np.s_[step:] if sign < 0 else np.s_[:-step]
            there = np.s_[:-step] if sign < 0 else np.s_[step:]
            t = time[there] - time[here]
            near = (track[there] == track[here]) & (np.abs(t) <= reach_s)
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
