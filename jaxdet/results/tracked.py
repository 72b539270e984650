"""Tracks in each frame, by ``jaxdet track``: their places and motions."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from jaxdet.elementary import hypot


class Mover(NamedTuple):
    """A track in a frame, whether the frame shows it or not."""

    track: int
    in_world: bool
    """Whether the path is in the world; otherwise it is in the camera's ground frame."""
    moving: bool
    path: np.ndarray
    """Path of the track up to this frame, or its position if it stands, ``(n, 2)`` float64 [m]."""
    velocity: np.ndarray
    """Velocity ``(2,)`` float64 [m/s]."""


class TracksInFrames:
    """Tracks of the frames of a log, which are requested one after the other.

    Args:
        tracks: Rows of ``tracks.parquet``, in order.
    """

    def __init__(self, tracks: Iterable[Mapping[str, Any]]) -> None:
        self._tracks: Iterator[Mapping[str, Any]] = iter(tracks)
        self._next = next(self._tracks, None)
        self._there: list[tuple[int, Mapping[str, Any]]] = []
        self._row = -1

    def at(self, frame: int) -> list[Mover]:
        """Return the tracks in the next frame, which has this number."""
        self._row += 1
        while self._next is not None and self._next["first_frame"] <= frame:
            path = np.reshape(self._next["path"], (-1, 2)).astype(np.float64)
            velocity = _velocities(path, np.asarray(self._next["speed_mps"], np.float64))
            self._there.append((self._row, {**self._next, "path": path, "velocity": velocity}))
            self._next = next(self._tracks, None)
        self._there = [(row, track) for row, track in self._there if track["last_frame"] >= frame]
        return [_mover(track, self._row - row) for row, track in self._there]


def _mover(track: Mapping[str, Any], point: int) -> Mover:
    point = min(point, len(track["path"]) - 1)
    about = track["track"], track["in_world"], track["moving"]
    return Mover(*about, track["path"][: point + 1], track["velocity"][point])


def _velocities(path: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """Return the velocities ``(n, 2)`` at the points of a path, along it, from speeds ``(n,)``."""
    way = np.concatenate([path[1:], path[-1:]]) - np.concatenate([path[:1], path[:-1]])
    return speed[:, None] * way / np.maximum(hypot(*way.T), 1e-9)[:, None]
