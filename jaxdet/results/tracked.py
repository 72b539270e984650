"""What ``jaxdet track`` says of each frame: which tracks it has, where they are, how they move."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from jaxdet.elementary import hypot


class Mover(NamedTuple):
    """A track in a frame, shown or not."""

    track: int
    in_world: bool
    """Whether its path is in the world, else in the camera's ground frame."""
    moving: bool
    path: np.ndarray
    """``(n, 2)`` float64, its way up to this frame; where it does not move, its place [m]."""
    velocity: np.ndarray
    """``(2,)`` float64 [m/s]."""


class TracksInFrames:
    """The tracks of a log's frames, asked for one frame after the other.

    Args:
        tracks: Rows of ``tracks.parquet``, as they stand there.
    """

    def __init__(self, tracks: Iterable[Mapping[str, Any]]) -> None:
        self._tracks: Iterator[Mapping[str, Any]] = iter(tracks)
        self._next = next(self._tracks, None)
        self._there: list[tuple[int, Mapping[str, Any]]] = []
        self._row = -1

    def at(self, frame: int) -> list[Mover]:
        """Those of the next frame, which has this number."""
        self._row += 1
        while self._next is not None and self._next["first_frame"] <= frame:
            path = np.reshape(self._next["path"], (-1, 2)).astype(np.float64)
            self._there.append((self._row, {**self._next, "path": path}))
            self._next = next(self._tracks, None)
        self._there = [(row, track) for row, track in self._there if track["last_frame"] >= frame]
        return [_mover(track, self._row - row) for row, track in self._there]


def _mover(track: Mapping[str, Any], point: int) -> Mover:
    path = track["path"]
    point = min(point, len(path) - 1)
    way = path[min(point + 1, len(path) - 1)] - path[max(point - 1, 0)]
    velocity = track["speed_mps"][point] * way / max(float(hypot(*way)), 1e-9)
    about = track["track"], track["in_world"], track["moving"]
    return Mover(*about, path[: point + 1], velocity)
