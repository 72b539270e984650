"""A track, and the pieces that the way of a long one is fitted in."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxdet.tracks.things import Things


class Track(NamedTuple):
    """One thing over time."""

    number: int
    """In the log, from 0, by its first sighting."""
    in_world: bool
    """Whether its path is in the world, else in the camera's ground frame."""
    first_frame: int
    """Number of the frame that shows it first."""
    last_frame: int
    first_stamp_ns: int
    last_stamp_ns: int
    frames: int
    """In which it was seen."""
    obstacles: int
    """Rows of ``obstacles.parquet`` that show it."""
    moving: bool
    mean_speed_mps: float
    """0 where it does not move [m/s]."""
    max_speed_mps: float
    """[m/s]."""
    length_m: float
    """The longer side of its outline, median [m]."""
    width_m: float
    """The shorter side [m]."""
    top_m: float
    """Its highest point above the floor, median; NaN where that is not known [m]."""
    path: np.ndarray
    """``(P, 2)`` float64, its middle in each frame from the first to the last; one point where it
    does not move [m]."""
    speed: np.ndarray
    """``(P,)`` float32, at each point of the path [m/s]."""


class Piece(NamedTuple):
    """Some frames of a track that follow each other, with what a :class:`Track` has of all."""

    in_world: bool
    first_frame: int
    last_frame: int
    first_stamp_ns: int
    last_stamp_ns: int
    seen: int
    obstacles: int
    moving: bool
    length_m: float
    width_m: float
    top_m: float
    num_frames: int
    """Those that don't show it as well."""
    path: np.ndarray
    """``(num_frames, 2)`` float64, or one point where it does not move [m]."""
    speed: np.ndarray
    """``(num_frames,)`` or ``(1,)`` float32 [m/s]."""


def piece_of(
    seen: Things, numbers: np.ndarray, stamps: np.ndarray, way: np.ndarray, speed: np.ndarray
) -> Piece:
    """A piece of a track.

    Args:
        seen: The sightings in it.
        numbers: ``(P,)`` numbers of its frames.
        stamps: ``(P,)`` their stamps [ns].
        way: ``(P, 2)``, where it is in each [m].
        speed: ``(P,)``, 0 in all where it does not move [m/s].
    """
    moving = bool(speed.any())
    # Which side of an outline is its first one changes from frame to frame.
    shorter, longer = 2 * np.median(np.sort(seen.outline.half, axis=1), axis=0)
    top = seen.top_m[~np.isnan(seen.top_m)]
    return Piece(
        bool(seen.in_world[0]),
        int(numbers[0]),
        int(numbers[-1]),
        int(stamps[0]),
        int(stamps[-1]),
        len(seen.frame),
        int(seen.obstacles.sum()),
        moving,
        float(longer),
        float(shorter),
        float(np.median(top)) if len(top) else float("nan"),
        len(numbers),
        way if moving else np.median(way, axis=0)[None],
        (speed if moving else speed[:1]).astype(np.float32),
    )


def track_of(number: int, pieces: Sequence[Piece]) -> Track:
    """The track that the pieces make.

    It moves if one of them does; sizes, and where it stands, are their means.
    """
    first, last = pieces[0], pieces[-1]
    moving = any(piece.moving for piece in pieces)
    seen = np.array([piece.seen for piece in pieces], np.float64)
    if moving:
        path = np.concatenate([np.broadcast_to(p.path, (p.num_frames, 2)) for p in pieces])
        speed = np.concatenate([np.broadcast_to(p.speed, p.num_frames) for p in pieces])
    else:
        points = np.concatenate([piece.path for piece in pieces])
        path = np.average(points, axis=0, weights=seen)[None]
        speed = np.zeros(1, np.float32)

    def mean(name: str) -> float:
        values = np.array([getattr(piece, name) for piece in pieces])
        known = ~np.isnan(values)
        return float(np.average(values[known], weights=seen[known])) if known.any() else np.nan

    return Track(
        number,
        first.in_world,
        first.first_frame,
        last.last_frame,
        first.first_stamp_ns,
        last.last_stamp_ns,
        sum(piece.seen for piece in pieces),
        sum(piece.obstacles for piece in pieces),
        moving,
        float(speed.mean(dtype=np.float64)),
        float(speed.max()),
        mean("length_m"),
        mean("width_m"),
        mean("top_m"),
        path,
        speed,
    )
