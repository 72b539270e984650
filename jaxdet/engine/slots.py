"""Memory in which workers and the threads of the main process exchange images and results.

Each worker has :data:`SLOTS` slots: it decodes a piece of its unit into one slot while the pieces
in its other slots are computed. The results of a piece are written to its slot.
"""

import itertools
import mmap
import os
import threading
from collections.abc import Mapping
from math import prod
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from jaxdet.config import Config
from jaxdet.engine.device import Found
from jaxdet.errors import WorkerError
from jaxdet.results.rows import map_leaves
from jaxdet.types import Calibration, Detections, GroundPlane

if TYPE_CHECKING:
    from jaxdet.io import Batch

SLOTS = 4
"""Number of slots of each worker: it decodes into one slot while the other three are copied,
computed, copied back, or wait for the worker."""
_PAGE = 4096
_numbers = itertools.count(1)


class Piece(NamedTuple):
    """Message from a worker: a slot with images to compute, and the priors of their floors."""

    slot: int
    """Number of the slot, counted over all workers."""
    plane: GroundPlane


class Reply(NamedTuple):
    """Message to a worker: the results of a slot, or an error."""

    slot: int
    error: Exception | None
    busy_s: Mapping[str, float]
    """The slot's share of the time of each step of its batch [s]."""


class GpuPipe(NamedTuple):
    """Connection of a worker to the threads that compute."""

    worker: int
    """Number of the worker."""
    pipe: Any
    """A :class:`multiprocessing.connection.Connection`."""


class Slot(NamedTuple):
    """Arrays of a slot."""

    images: list[np.ndarray]
    """Depth images ``(n, Hd, Wd)`` uint16, and colour images ``(n, H, W, 3)`` uint8 if the method
    reads them."""
    results: np.ndarray
    """Packed results, ``(n, ints)`` int32, see :meth:`Served.unpacked`."""


class Served(NamedTuple):
    """Format of the frames that GPUs compute for workers, and of the memory that holds them.

    It is sent to workers. Logs with equal fields up to ``config`` can be computed together.
    """

    frames: int
    """Number of frames in a slot."""
    pieces: int
    """Number of slots in a batch."""
    depth: tuple[int, ...]
    """Shape of a depth image, ``(Hd, Wd)`` uint16."""
    color: tuple[int, ...] | None
    """Shape of a colour image, ``(H, W, 3)`` uint8; None if the method reads only depth."""
    workers: int
    calibration: Calibration
    config: Config
    path: str = ""
    """Path by which other processes map the memory."""
    number: int = 0
    """Number that identifies the memory, as its path may be used again after it is freed."""
    results: Any = None
    """Types and shapes of a frame's results, as :class:`jaxdet.types.Detections` of NumPy dtypes;
    None until the memory exists."""

    @property
    def batch(self) -> int:
        """Number of frames that are computed together."""
        return self.pieces * self.frames

    @property
    def ints(self) -> int:
        """Number of int32 values in the packed results of a frame."""
        leaves: list[np.dtype] = []
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

    def slots(self, memory: mmap.mmap) -> list[Slot]:
        """Return the arrays of each slot."""
        found, (depth_bytes, color_bytes, _) = [], self.sizes
        for start in range(0, self.nbytes, sum(self.sizes)):
            images = [np.ndarray((self.frames, *self.depth), np.uint16, memory, start)]
            start += depth_bytes
            if self.color:
                images.append(np.ndarray((self.frames, *self.color), np.uint8, memory, start))
            shape = self.frames, self.ints
            results = np.ndarray(shape, np.int32, memory, start + color_bytes)
            found.append(Slot(images, results))
        return found

    def unpacked(self, rows: np.ndarray) -> Detections:
        """Return the detections in packed results ``(B, ints)``; only boolean arrays are copied."""
        start = 0

        def unpack(leaf: np.dtype) -> np.ndarray:
            nonlocal start
            stop = start + prod(leaf.shape)
            part, start = rows[:, start:stop].reshape(len(rows), *leaf.shape), stop
            return part.astype(leaf.base, copy=False)

        return map_leaves(unpack, self.results)


class SlotMemory:
    """Anonymous shared memory of all slots, which is freed when the last process that maps it ends.

    Named memory of :mod:`multiprocessing.shared_memory` would outlive a killed run, and containers
    limit it.

    Args:
        served: Frames that are computed, and the layout of the memory.

    Attributes:
        served: The argument, with the path of the memory.
        slots: Arrays of each slot.

    Raises:
        WorkerError: There is too little memory.
    """

    def __init__(self, served: Served) -> None:
        self._file, nbytes = os.memfd_create("jaxdet"), served.nbytes
        try:
            os.ftruncate(self._file, nbytes)
            self._map = mmap.mmap(self._file, nbytes)
        except OSError as error:
            os.close(self._file)
            problem = f"no shared memory of {nbytes >> 20} MiB ({error.strerror})"
            raise WorkerError(problem, remedy="use fewer --workers") from error
        path = f"/proc/{os.getpid()}/fd/{self._file}"
        self.served = served._replace(path=path, number=next(_numbers))
        self.slots = served.slots(self._map)
        self._lock = threading.Lock()
        self._page_lock: Any = None

    def close(self) -> None:
        """Close the file, which no device uses any more; memory lives as long as it is mapped."""
        if self._page_lock:
            self._page_lock.unlock()
        os.close(self._file)

    def page_lock(self, device: Any) -> None:
        """Page-lock the memory, slot by slot, unless it is already locked."""
        from jaxdet.stages._upload import PageLock

        with self._lock:
            if not self._page_lock:
                self._page_lock = PageLock(self._map, device, sum(self.served.sizes))


def attached(path: str) -> mmap.mmap:
    """Map the memory of another process."""
    file = os.open(path, os.O_RDWR)
    try:
        return mmap.mmap(file, os.fstat(file).st_size)
    finally:
        os.close(file)


class SharedDevice:
    """The GPUs of the main process, which compute for this worker.

    Args:
        served: Format of the frames, see :meth:`jaxdet.engine.pool.Pool.serve`.
        pipe: Connection of this worker to :class:`jaxdet.engine.gpu.GpuThreads`.
    """

    ahead, doing = SLOTS - 1, "wait"

    def __init__(self, served: Served, pipe: GpuPipe) -> None:
        self.served, self._pipe = served, pipe.pipe
        self._slots = served.slots(attached(served.path))
        self._first, self._turn = pipe.worker * SLOTS, 0
        self._replies: dict[int, Reply] = {}

    def images(self) -> np.ndarray | tuple[np.ndarray, np.ndarray]:
        """Return the memory that the next batch is decoded into."""
        self._turn = (self._turn + 1) % SLOTS
        depth, *color = self._slots[self._first + self._turn].images
        return (depth, color[0]) if color else depth

    def start(self, batch: "Batch") -> int:
        """Start the batch whose images are in the memory that :attr:`images` returned last."""
        slot = self._first + self._turn
        assert batch.frames.plane is not None
        self._pipe.send(Piece(slot, batch.frames.plane))
        return slot

    def finish(self, started: int) -> Found:
        """Wait for a batch; its results are valid until its slot is started again."""
        while started not in self._replies:
            received: Reply = self._pipe.recv()
            self._replies[received.slot] = received
        reply = self._replies.pop(started)
        if reply.error:
            raise reply.error
        inputs = self.served.unpacked(self._slots[started].results)
        return Found(inputs, busy_s=reply.busy_s)
