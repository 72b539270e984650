"""Where a track was in each frame from its first to its last, how fast, and whether it moved."""

from typing import NamedTuple

import numpy as np

from jaxdet.elementary import hypot
from jaxdet.tracks.config import TrackConfig
from jaxdet.tracks.hidden import unseen
from jaxdet.tracks.pairs import ranges
from jaxdet.tracks.things import Things

GUESSED = 0.05
"""Weight of a frame between sightings."""
LONGER, MERGED = 1.6, 0.1
"""An outline so much longer than usual holds something else; its weight."""
STEADY_S = 0.02
"""Fits over less time than this are drawn to standing still [s]."""


class Motion(NamedTuple):
    """``K`` tracks; ``P`` points, those of the first track first, one a frame."""

    first: np.ndarray
    """``(K,)`` int64, the first point of each; it has one for each frame from its first to its
    last."""
    place: np.ndarray
    """``(P, 2)`` float64, middle of the outline [m]."""
    velocity: np.ndarray
    """``(P, 2)`` float64 [m/s]."""
    moving: np.ndarray
    """``(K,)`` bool."""


def motion_of(
    things: Things, first: np.ndarray, stamps: np.ndarray, start: int, config: TrackConfig
) -> Motion:
    """Fits the ways of tracks.

    A hidden side is put where it would be seen. Between sightings the outline's edges are
    interpolated; over ``smooth_s`` before and after each frame they are lines.

    Args:
        things: Sightings, those of the first track first, each track's by frame.
        first: ``(K,)``, the first sighting of each track.
        stamps: Stamps of the log's frames from ``start`` on [ns].
        start: Number of the first of them.
        config: Times and limits.
    """
    last = np.append(first[1:], len(things.frame)) - 1
    count = things.frame[last] - things.frame[first] + 1
    starts = np.cumsum(count) - count
    track = np.repeat(np.arange(len(first)), count)
    stamp = stamps[ranges(things.frame[first] - start, count)]
    time = (stamp - stamp[starts][track]) * 1e-9
    length, usual = _lengths(things, first)
    longer = length > LONGER * np.repeat(usual, np.diff(np.append(first, len(length))))
    things = things._replace(weight=np.where(longer, MERGED, 1) * things.weight)
    shift = unseen(things, np.searchsorted(first, np.arange(len(length)), "right") - 1, len(first))
    edges = _edges(things) + np.hstack([shift, shift])
    edges, weight = _filled(things, edges, starts, first, stamp)
    line, slope = _fitted(track, time, edges, weight, config.smooth_s)
    velocity = _middle(slope)
    # Over a few frames noise alone can be such a speed.
    possible = _medians(hypot(*velocity.T), track, starts) <= config.max_speed_mps
    moving = _moves(line, edges, weight, starts, track, usual, config) & possible
    velocity *= moving[track, None]
    return Motion(starts, _middle(line), velocity, moving)


def _middle(edges: np.ndarray) -> np.ndarray:
    """``(N, 2)``, of edges ``(N, 4)``."""
    return (edges[:, :2] + edges[:, 2:]) / 2


def _edges(things: Things) -> np.ndarray:
    """``(N, 4)``, least x and y and greatest x and y of each outline [m]."""
    outline = things.outline
    ways = (np.broadcast_to(way, outline.axis.shape) for way in np.eye(2))
    reach = np.stack([outline.reach(way) for way in ways], axis=1)
    return np.hstack([outline.center - reach, outline.center + reach])


def _lengths(things: Things, first: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of each sighting, ``(N,)``, the longer side, and its median in each track, ``(K,)`` [m]."""
    track = np.searchsorted(first, np.arange(len(things.frame)), "right") - 1
    length = 2 * things.outline.half.max(axis=1)
    return length, _medians(length, track, first)


def _medians(values: np.ndarray, track: np.ndarray, first: np.ndarray) -> np.ndarray:
    """The upper median of the values ``(N,)`` of each track, which begins at ``first`` ``(K,)``."""
    count = np.diff(np.append(first, len(values)))
    return values[np.lexsort((values, track))][first + count // 2]


def _moves(
    line: np.ndarray,
    edges: np.ndarray,
    weight: np.ndarray,
    starts: np.ndarray,
    track: np.ndarray,
    usual: np.ndarray,
    config: TrackConfig,
) -> np.ndarray:
    """Which tracks move, ``(K,)``: both ends and the middle leave their places, by more than noise.

    Of long things, ``usual`` ``(K,)`` [m], more is asked: of a wall pieces come and go, whose ends
    jump.
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


def _filled(
    things: Things, edges: np.ndarray, starts: np.ndarray, first: np.ndarray, stamp: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Edges in all frames, ``(P, 4)``, by lines between sightings, and their weights, ``(P,)``."""
    track = np.searchsorted(first, np.arange(len(things.frame)), "right") - 1
    point = starts[track] + things.frame - things.frame[first][track]
    known = np.zeros(len(stamp), bool)
    known[point] = True
    before = np.cumsum(known) - 1
    after = before + ~known
    whole = np.maximum(stamp[point[after]] - stamp[point[before]], 1)
    share = (stamp - stamp[point[before]]) / whole
    filled = edges[before] + share[:, None] * (edges[after] - edges[before])
    return filled, np.where(known, things.weight[before], GUESSED)


def _fitted(
    track: np.ndarray, time: np.ndarray, values: np.ndarray, weight: np.ndarray, reach_s: float
) -> tuple[np.ndarray, np.ndarray]:
    """Lines through the values within ``reach_s`` of each point: value and slope, ``(P, V)``.

    At both ends of a track they go through more, so that it is never less than three quarters of
    the time. Where no other point is so near, they go through those next to it.
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
    """``(P,)`` bool, whether a line reaches no other point of the track within ``reach_s``."""
    apart = np.full((2, len(track)), np.nan)
    same = track[1:] == track[:-1]
    apart[0, 1:][same] = np.abs(time[:-1] - middle[1:])[same]
    apart[1, :-1][same] = np.abs(time[1:] - middle[:-1])[same]
    return np.fmin(*apart) > reach_s
