"""Memory that workers share with the device server, and their messages.

Each worker has a few slots: it decodes a piece of its unit into one of them while the pieces in the
others are computed. The results of a piece are written to its slot.
"""

import itertools
import mmap
import os
from collections.abc import Mapping
from dataclasses import dataclass
from math import prod
from typing import Any, NamedTuple

import numpy as np

from jaxdet.config import Config
from jaxdet.errors import WorkerError
from jaxdet.results.rows import map_leaves
from jaxdet.types import Calibration, Detections, GroundPlane

SLOTS = 4
"""Number of slots of each worker: it decodes into one slot while the other three are copied,
computed, copied back, or wait for the worker."""
_PAGE = 4096
_numbers = itertools.count(1)


@dataclass(frozen=True)
class Leaf:
    """An array of :func:`jaxdet.results.rows.row_inputs` in a row of results."""

    shape: tuple[int, ...]
    """Shape of a frame's part."""
    kind: np.dtype


class SlotArrays(NamedTuple):
    """Arrays of a slot."""

    depth: np.ndarray
    """Depth images ``(n, Hd, Wd)`` uint16."""
    color: np.ndarray | None
    """``(n, H, W, 3)`` uint8; None if the method reads only depth."""
    results: np.ndarray
    """``(n, ints)`` int32, see :meth:`Slots.unpacked`."""

    @property
    def images(self) -> list[np.ndarray]:
        """Images that the method reads."""
        return [self.depth] if self.color is None else [self.depth, self.color]


class Slots(NamedTuple):
    """Shared memory of images and results, and its division into slots; it is sent to workers."""

    path: str
    """Path by which other processes map the memory."""
    frames: int
    """Number of frames in a slot."""
    depth: tuple[int, ...]
    """Shape of a depth image, ``(Hd, Wd)`` uint16."""
    color: tuple[int, ...] | None
    """Shape of a colour image, ``(H, W, 3)`` uint8; None if the method reads only depth."""
    workers: int
    number: int = 0
    """Number that identifies the memory, as a path is used again after memory is freed."""
    results: Any = None
    """:class:`jaxdet.types.Detections` of :class:`Leaf`; None until the memory exists."""

    @property
    def ints(self) -> int:
        """Number of int32 per frame of results."""
        leaves: list[Leaf] = []
        map_leaves(leaves.append, self.results)
        return sum(prod(leaf.shape) for leaf in leaves)

    @property
    def sizes(self) -> tuple[int, int, int]:
        """Size of a slot's depth images, colour images and results, in whole pages [bytes]."""
        frame = 2 * prod(self.depth), prod(self.color) if self.color else 0, 4 * self.ints
        depth, color, results = (-(-size * self.frames // _PAGE) * _PAGE for size in frame)
        return depth, color, results

    @property
    def nbytes(self) -> int:
        """Size of all slots [bytes]."""
        return self.workers * SLOTS * sum(self.sizes)

    def arrays(self, memory: mmap.mmap) -> list[SlotArrays]:
        """Return the arrays of each slot."""
        found, (depth_bytes, color_bytes, _) = [], self.sizes
        for start in range(0, self.nbytes, sum(self.sizes)):
            depth = np.ndarray((self.frames, *self.depth), np.uint16, memory, start)
            color, start = None, start + depth_bytes
            if self.color:
                color = np.ndarray((self.frames, *self.color), np.uint8, memory, start)
            shape = self.frames, self.ints
            results = np.ndarray(shape, np.int32, memory, start + color_bytes)
            found.append(SlotArrays(depth, color, results))
        return found

    def unpacked(self, rows: np.ndarray) -> Detections:
        """Return the arrays in results ``(B, ints)``; only boolean ones are copied."""
        start = 0

        def unpack(leaf: Leaf) -> np.ndarray:
            nonlocal start
            stop = start + prod(leaf.shape)
            part, start = rows[:, start:stop].reshape(len(rows), *leaf.shape), stop
            return part.astype(leaf.kind, copy=False)

        return map_leaves(unpack, self.results)


class ServerConfig(NamedTuple):
    """Properties that logs must share to be computed by one device server."""

    slots: Slots
    """Shared memory; it has a path if the device server has started."""
    pieces: int
    """Number of pieces in a batch."""
    calibration: Calibration
    config: Config

    @property
    def batch(self) -> int:
        """Number of frames that are computed together."""
        return self.pieces * self.slots.frames


class Piece(NamedTuple):
    """Message of a worker: a slot with images to compute."""

    worker: int
    slot: int
    """Number of the slot among those of all workers."""
    plane: GroundPlane


class Reply(NamedTuple):
    """Message to a worker: the results of a slot, or an error."""

    slot: int
    error: Exception | None
    busy_s: Mapping[str, float]
    """The slot's share of the time of each step of its batch [s]."""


class ServerPipe(NamedTuple):
    """Connection of a worker to the device server."""

    number: int
    pipe: Any
    """A :class:`multiprocessing.connection.Connection`."""


class SharedMemory:
    """Anonymous shared memory, which is freed when the last process that maps it ends.

    Named memory of :mod:`multiprocessing.shared_memory` would outlive a killed run, and containers
    limit it.
    """

    def __init__(self, nbytes: int) -> None:
        self._file = os.memfd_create("jaxdet")
        try:
            os.ftruncate(self._file, nbytes)
            self.map = mmap.mmap(self._file, nbytes)
        except OSError as error:
            os.close(self._file)
            problem = f"no shared memory of {nbytes >> 20} MiB ({error.strerror})"
            raise WorkerError(problem, remedy="use fewer --workers") from error
        self.path = f"/proc/{os.getpid()}/fd/{self._file}"
        self.number = next(_numbers)

    def close(self) -> None:
        """Close the file; the memory lives as long as it is mapped."""
        os.close(self._file)


def attached(path: str) -> mmap.mmap:
    """Map the memory of another process."""
    file = os.open(path, os.O_RDWR)
    try:
        return mmap.mmap(file, os.fstat(file).st_size)
    finally:
        os.close(file)
