"""Where a track was in each frame from its first to its last, how fast, and whether it moved."""

from typing import NamedTuple

import numpy as np

from jaxdet.tracks.config import TrackConfig
from jaxdet.tracks.pairs import ranges
from jaxdet.tracks.things import Things


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
    edges = _filled(things, edges, starts, first, track, frame, stamp)
    line, slope = _fitted(track, time, edges, config.smooth_s)
    low, high = line[:, :2], line[:, 2:]
    base = line[starts][track]
    shift = np.stack([line - base, np.roll(line - base, 2, axis=1)])
    middle = np.abs(shift.sum(0)[:, :2] / 2)
    ends = np.minimum(*np.abs(np.split(line - base, 2, axis=1)))
    least = np.minimum(ends, middle).max(axis=1)
    farthest = np.maximum.reduceat(least, starts)
    size = np.maximum.reduceat((high - low).max(axis=1), starts)
    moving = farthest > np.maximum(config.moving_m, 0.3 * size)
    velocity = (slope[:, :2] + slope[:, 2:]) / 2 * moving[track, None]
    return Motion(starts, count, (low + high) / 2, velocity, moving)


def _filled(things, edges, starts, first, track, frame, stamp):
    """Edges in all frames, ``(P, 4)``, by lines between sightings."""
    seen_track = np.searchsorted(first, np.arange(len(things.frame)), "right") - 1
    point = starts[seen_track] + things.frame - things.frame[first][seen_track]
    known = np.zeros(len(track), bool)
    known[point] = True
    before = np.cumsum(known) - 1
    after = np.minimum(before + ~known, len(point) - 1)
    whole = np.maximum(stamp[point[after]] - stamp[point[before]], 1)
    share = (stamp - stamp[point[before]]) / whole
    return edges[before] + share[:, None] * (edges[after] - edges[before])


def _fitted(track: np.ndarray, time: np.ndarray, values: np.ndarray, reach_s: float):
    """Lines through the values within ``reach_s`` of each point: value and slope, ``(P, V)``."""
    n = np.ones(len(track))
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
            t = np.where(near, t, 0.0)
            shift = (values[there] - values[here]) * near[:, None]
            n[here] += near
            st[here] += t
            stt[here] += t * t
            sv[here] += shift
            stv[here] += t[:, None] * shift
    mean_t, mean_v = st / n, sv / n[:, None]
    spread = stt / n - mean_t**2
    slope = (stv / n[:, None] - mean_t[:, None] * mean_v) / np.maximum(spread, 1e-12)[:, None]
    slope[spread < 1e-12] = 0.0
    return values + mean_v - slope * mean_t[:, None], slope
