"""Memory that workers share with the process that computes, and what they tell each other.

Each worker has a few slots of it: it decodes a piece of its unit into one while the pieces in the
others are computed, and finds their results in memory that is divided alike.
"""

import itertools
import mmap
import os
from collections.abc import Mapping
from dataclasses import dataclass
from math import prod
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from jaxdet.errors import WorkerError
from jaxdet.results.rows import RowInputs, map_leaves
from jaxdet.types import Detections, GroundPlane

if TYPE_CHECKING:
    from jaxdet.floor.units import FloorFit

SLOTS = 4
"""Of each worker: one that it decodes to, and three that are copied, computed, sent back or wait
for it."""
_PAGE = 4096
_numbers = itertools.count(1)


class Images(NamedTuple):
    """The images of a slot."""

    depth: np.ndarray
    """``(n, Hd, Wd)`` uint16."""
    color: np.ndarray | None
    """``(n, H, W, 3)`` uint8; None: the method reads depth alone."""


class Slots(NamedTuple):
    """The shared memory of a log's images and how it is divided; goes to the workers."""

    path: str
    """Where other processes find it."""
    frames: int
    """Frames of a slot."""
    depth: tuple[int, ...]
    """Shape of a depth image, ``(Hd, Wd)`` uint16."""
    color: tuple[int, ...] | None
    """Shape of a colour image, ``(H, W, 3)`` uint8; None: the method reads depth alone."""
    workers: int
    number: int = 0
    """Of the memory: what has been freed leaves its path to the next one."""

    @property
    def sizes(self) -> tuple[int, int]:
        """Bytes of a slot's depth and colour images, in whole pages."""
        depth, color = 2 * prod(self.depth), prod(self.color) if self.color else 0
        return _pages(depth * self.frames), _pages(color * self.frames)

    @property
    def nbytes(self) -> int:
        """Of all slots."""
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


def _pages(nbytes: int) -> int:
    return -(-nbytes // _PAGE) * _PAGE


@dataclass(frozen=True)
class Leaf:
    """An array of :class:`jaxdet.results.rows.RowInputs` in the packed results."""

    shape: tuple[int, ...]
    """Of a frame."""
    kind: np.dtype


class Packing(NamedTuple):
    """The shared memory of the results: a row of int32 for each frame of each slot."""

    path: str
    inputs: Any
    """:class:`jaxdet.results.rows.RowInputs` of :class:`Leaf`."""

    @property
    def ints(self) -> int:
        """int32 of a frame."""
        return sum(int(np.prod(leaf.shape)) for leaf in _leaves(self.inputs))

    def view(self, memory: mmap.mmap, slots: Slots) -> np.ndarray:
        """``(slots, frames, ints)`` int32."""
        shape = slots.workers * SLOTS, slots.frames, self.ints
        return np.ndarray(shape, np.int32, memory)

    def unpacked(self, rows: np.ndarray) -> RowInputs:
        """What ``rows`` ``(B, ints)`` hold, without a copy but of what is boolean."""
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
    """A slot that a worker has filled."""

    worker: int
    slot: int
    """Among all slots."""
    plane: GroundPlane
    whole: bool


class Sample(NamedTuple):
    """A slot that a worker has filled with depth images, whose floors are wanted."""

    worker: int
    slot: int
    """Among all slots."""
    plane: GroundPlane
    """The prior of each; as many as there are images."""


class Reply(NamedTuple):
    """Its results are there, or why not."""

    slot: int
    packing: bytes
    """:class:`Packing`, pickled: all replies have the same one."""
    whole: Detections | None
    error: Exception | None
    busy_s: Mapping[str, float]
    """Its share of the times of its batch."""
    floors: "FloorFit | None" = None
    """To a :class:`Sample`."""


class ServerPipe(NamedTuple):
    """A worker's way to the device server."""

    number: int
    pipe: Any
    """A :class:`multiprocessing.connection.Connection`."""


class SharedMemory:
    """Shared memory without a name, which is freed with the last process that has it."""

    def __init__(self, nbytes: int) -> None:
        self._file = os.memfd_create("jaxdet")
        try:
            os.ftruncate(self._file, nbytes)
            self.map = mmap.mmap(self._file, nbytes)
        except OSError as error:
            os.close(self._file)
            problem = f"no shared memory of {nbytes >> 20} MiB ({error.strerror})"
            raise WorkerError(problem, remedy="take fewer --workers") from error
        self.path = f"/proc/{os.getpid()}/fd/{self._file}"
        self.number = next(_numbers)

    def close(self) -> None:
        """Frees this process' part."""
        os.close(self._file)


def attached(path: str) -> mmap.mmap:
    """Another process' memory."""
    file = os.open(path, os.O_RDWR)
    try:
        return mmap.mmap(file, os.fstat(file).st_size)
    finally:
        os.close(file)
