"""Memory that workers share with the device server, and their messages.

Each worker has a few slots: it decodes a piece of its unit into one of them while the pieces in the
others are computed. Results are in a second memory, which is divided into the same slots.
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
from jaxdet.results.rows import RowInputs, map_leaves
from jaxdet.types import Calibration, Detections, GroundPlane

SLOTS = 4
"""Number of slots of each worker: it decodes into one slot while the other three are copied,
computed, copied back, or wait for the worker."""
_PAGE = 4096
_numbers = itertools.count(1)


class Images(NamedTuple):
    """Images of a slot."""

    depth: np.ndarray
    """Depth images ``(n, Hd, Wd)`` uint16."""
    color: np.ndarray | None
    """Colour images ``(n, H, W, 3)`` uint8; None if the method reads only depth."""


class Slots(NamedTuple):
    """Shared memory of images, and its division into slots; it is sent to the workers."""

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
    """Number of the memory; its path alone may be equal to that of memory that was freed."""

    @property
    def sizes(self) -> tuple[int, int]:
        """Size of a slot's depth and colour images, in whole pages [bytes]."""
        depth, color = 2 * prod(self.depth), prod(self.color) if self.color else 0
        return _pages(depth * self.frames), _pages(color * self.frames)

    @property
    def nbytes(self) -> int:
        """Size of all slots [bytes]."""
        return self.workers * SLOTS * sum(self.sizes)

    def views(self, memory: mmap.mmap) -> list[Images]:
        """Return the images of each slot."""
        found = []
        for start in range(0, self.nbytes, sum(self.sizes)):
            depth = np.ndarray((self.frames, *self.depth), np.uint16, memory, start)
            color = None
            if self.color:
                shape, start = (self.frames, *self.color), start + self.sizes[0]
                color = np.ndarray(shape, np.uint8, memory, start)
            found.append(Images(depth, color))
        return found


class ServerConfig(NamedTuple):
    """Properties that logs must share to be computed by one device server."""

    slots: Slots
    """Shared memory of images; it has a path if the device server has started."""
    pieces: int
    """Number of pieces in a batch."""
    calibration: Calibration
    config: Config

    @property
    def batch(self) -> int:
        """Number of frames that are computed together."""
        return self.pieces * self.slots.frames


def _pages(nbytes: int) -> int:
    return -(-nbytes // _PAGE) * _PAGE


@dataclass(frozen=True)
class Leaf:
    """An array of :class:`jaxdet.results.rows.RowInputs` in the packed results."""

    shape: tuple[int, ...]
    """Shape of a frame's part."""
    kind: np.dtype


class Packing(NamedTuple):
    """Shared memory of results: a row of int32 for each frame of each slot."""

    path: str
    inputs: Any
    """:class:`jaxdet.results.rows.RowInputs` with a :class:`Leaf` in place of each array."""

    @property
    def ints(self) -> int:
        """Number of int32 per frame."""
        return sum(int(np.prod(leaf.shape)) for leaf in _leaves(self.inputs))

    def view(self, memory: mmap.mmap, slots: Slots) -> np.ndarray:
        """Return the results as ``(slots, frames, ints)`` int32."""
        shape = slots.workers * SLOTS, slots.frames, self.ints
        return np.ndarray(shape, np.int32, memory)

    def unpacked(self, rows: np.ndarray) -> RowInputs:
        """Return the arrays in ``rows`` ``(B, ints)``; only boolean ones are copied."""
        start = 0

        def unpack(leaf: Leaf) -> np.ndarray:
            nonlocal start
            stop = start + int(np.prod(leaf.shape))
            part, start = rows[:, start:stop].reshape(len(rows), *leaf.shape), stop
            return part.astype(leaf.kind, copy=False)

        return map_leaves(unpack, self.inputs)


def _leaves(tree: Any) -> list[Any]:
    found: list[Any] = []
    map_leaves(found.append, tree)
    return found


class Piece(NamedTuple):
    """Message of a worker: a slot with images to compute."""

    worker: int
    slot: int
    """Number of the slot among those of all workers."""
    plane: GroundPlane
    whole: bool


class Reply(NamedTuple):
    """Message to a worker: the results of a slot, or an error."""

    slot: int
    packing: bytes
    """Pickled :class:`Packing`, the same in all replies."""
    whole: Detections | None
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
