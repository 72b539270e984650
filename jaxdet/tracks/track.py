"""Tracks, and the pieces in which long trajectories are fitted."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxdet import elementary
from jaxdet.elementary import median
from jaxdet.tracks.observations import Observations


class Track(NamedTuple):
    """An object over time."""

    number: int
    """Number in the log, from 0, in the order of first observations."""
    in_world: bool
    """Whether the path is in the world frame; otherwise it is in the camera's ground frame."""
    first_frame: int
    """Number of the first frame with an observation."""
    last_frame: int
    """Number of the last frame with an observation."""
    first_stamp_ns: int
    """Timestamp of the first frame [ns]."""
    last_stamp_ns: int
    """Timestamp of the last frame [ns]."""
    frames: int
    """Number of frames with an observation."""
    obstacles: int
    """Number of obstacles (rows of ``obstacles.parquet``) in the track."""
    moving: bool
    """Whether the object moves."""
    mean_speed_mps: float
    """Mean speed, 0 for a stationary track [m/s]."""
    max_speed_mps: float
    """Maximum speed [m/s]."""
    length_m: float
    """Median of the outline's longer side [m]."""
    width_m: float
    """Median of the outline's shorter side [m]."""
    top_m: float
    """Median height of the highest point above the floor, NaN if unknown [m]."""
    path: np.ndarray
    """Centre of the outline in each frame from the first to the last, ``(P, 2)`` float64 [m]; a
    single point for a stationary track."""
    speed: np.ndarray
    """Speed at each point of the path, ``(P,)`` float32 [m/s]."""


class Piece(NamedTuple):
    """Consecutive frames of a track, with fields as in :class:`Track`."""

    in_world: bool
    first_frame: int
    last_frame: int
    first_stamp_ns: int
    last_stamp_ns: int
    num_observations: int
    """Number of frames with an observation."""
    obstacles: int
    moving: bool
    length_m: float
    width_m: float
    top_m: float
    num_frames: int
    """Number of frames, with or without an observation."""
    path: np.ndarray
    """Path ``(num_frames, 2)`` float64, or one point if stationary [m]."""
    speed: np.ndarray
    """Speed ``(num_frames,)`` or ``(1,)`` float32 [m/s]."""


def piece_of(
    obs: Observations, numbers: np.ndarray, stamps: np.ndarray, path: np.ndarray, speed: np.ndarray
) -> Piece:
    """Build a piece of a track.

    Args:
        obs: Observations in the piece.
        numbers: Frame numbers ``(P,)``.
        stamps: Timestamps of these frames, ``(P,)`` [ns].
        path: Position in each frame, ``(P, 2)`` [m].
        speed: Speed in each frame, ``(P,)``, all 0 if stationary [m/s].
    """
    moving = bool(speed.any())
    # Depending on the frame, an outline's first side may be the longer or the shorter one.
    shorter, longer = 2 * median(np.sort(obs.outline.half, axis=1), axis=0)
    top = obs.top_m[~np.isnan(obs.top_m)]
    return Piece(
        bool(obs.in_world[0]),
        int(numbers[0]),
        int(numbers[-1]),
        int(stamps[0]),
        int(stamps[-1]),
        len(obs.frame),
        int(obs.obstacles.sum()),
        moving,
        float(longer),
        float(shorter),
        float(median(top)) if len(top) else float("nan"),
        len(numbers),
        path if moving else median(path, axis=0)[None],
        (speed if moving else speed[:1]).astype(np.float32),
    )


def track_of(number: int, pieces: Sequence[Piece]) -> Track:
    """Join pieces to a track.

    The track moves if any piece does. Its size, and its position if stationary, are means over
    pieces.
    """
    first, last = pieces[0], pieces[-1]
    moving = any(piece.moving for piece in pieces)
    counts = np.array([piece.num_observations for piece in pieces], np.float64)
    if moving:
        path = np.concatenate([np.broadcast_to(p.path, (p.num_frames, 2)) for p in pieces])
        speed = np.concatenate([np.broadcast_to(p.speed, p.num_frames) for p in pieces])
    else:
        points = np.concatenate([piece.path for piece in pieces])
        path = elementary.mean(points, counts)[None]
        speed = np.zeros(1, np.float32)

    def mean(name: str) -> float:
        values = np.array([getattr(piece, name) for piece in pieces])
        finite = ~np.isnan(values)
        return float(elementary.mean(values[finite], counts[finite])) if finite.any() else np.nan

    return Track(
        number,
        first.in_world,
        first.first_frame,
        last.last_frame,
        first.first_stamp_ns,
        last.last_stamp_ns,
        sum(piece.num_observations for piece in pieces),
        sum(piece.obstacles for piece in pieces),
        moving,
        float(elementary.mean(speed)),
        float(speed.max()),
        mean("length_m"),
        mean("width_m"),
        mean("top_m"),
        path,
        speed,
    )
