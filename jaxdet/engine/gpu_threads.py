"""Threads of the main process that compute on its GPUs for all workers.

Workers decode images into slots of memory that they share with this process::

    worker 1 ...  decode > slot ---Piece--+
                                          |  as many pieces as there are, at most a batch
    a thread per GPU           Gpu.copy  >  Gpu.start  >  Gpu.finish
                               batch 3      batch 2       batch 1, at the same time
                                                            |
    worker 1 ...  rows < results in the slot <---Reply------+

Pieces of any workers form a batch, in any order. Frames don't depend on each other, so the way
pieces form batches changes no result.
"""

import threading
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from itertools import chain
from math import prod
from multiprocessing import Pipe
from multiprocessing.connection import wait
from typing import TYPE_CHECKING, Any

from jaxdet.config import Config
from jaxdet.engine.device import out_of_memory
from jaxdet.engine.gpu import Batch, Gpu, result_types
from jaxdet.engine.slots import SLOTS, Piece, Reply, Served, SlotMemory

if TYPE_CHECKING:
    from jaxdet.io import Log

PIECE_FRAMES, PIECE_BYTES = 16, 24 << 20
"""Maximum number of frames and of bytes in a slot, which holds at least one frame."""
BATCH_PIECES = 16
"""Number of pieces in a batch; for images of 640x480 it has 256 frames."""


def served_for(
    log: "Log", config: Config, batch_size: int | None, piece_frames: int, workers: int
) -> Served:
    """Return the format of the frames of a log that GPUs compute.

    Args:
        log: Open log.
        config: The method's parameters.
        batch_size: Number of frames computed together; by default those of :data:`BATCH_PIECES`
            slots.
        piece_frames: Maximum number of frames in a slot that fit into the memory.
        workers: Number of workers.
    """
    depth, color = log.depth_shape, None
    if config.cluster.points:
        camera = log.calibration.image
        color = camera.height, camera.width, 3
    fits = PIECE_BYTES // (2 * prod(depth) + (prod(color) if color else 0))
    frames = max(1, min(PIECE_FRAMES, fits, piece_frames, batch_size or PIECE_FRAMES))
    pieces = BATCH_PIECES if batch_size is None else -(-batch_size // frames)
    return Served(frames, pieces, depth, color, workers, log.calibration, config)


class GpuThreads:
    """Threads that compute the images that workers decode, one per GPU.

    They run until :meth:`close`. Each worker has page-locked memory: ``SLOTS`` times
    ``PIECE_BYTES`` of images, or ``SLOTS`` frames if that is more, and their results (0.25 MB per
    frame of 640x480).

    Args:
        wanted: Format of the frames, see :func:`served_for`.
        pipes: Connections to the workers.
        devices: GPUs.

    Raises:
        WorkerError: There is too little memory.
    """

    def __init__(self, wanted: Served, pipes: list[Any], devices: Sequence[Any]) -> None:
        self.wanted, self.pipes, self.devices = wanted, pipes, devices
        self.memory = SlotMemory(wanted._replace(results=result_types(wanted)))
        self.woken, self.waker = Pipe(duplex=False)
        self.ends = [*pipes, self.woken]
        """Connections that are read; those of workers that have died are removed."""
        self.receiving, self.sending = threading.Lock(), threading.Lock()
        """Held while pieces are received, or a reply is sent, by one of the threads."""
        given: dict[str, Any] = {"target": self._compute, "name": "jaxdet-gpu", "daemon": True}
        self.threads = [threading.Thread(args=(device,), **given) for device in devices]
        for thread in self.threads:
            thread.start()

    def close(self) -> None:
        """End the threads and free the memory."""
        self.waker.send(None)
        for thread in self.threads:
            thread.join()
        for end in (self.waker, self.woken):
            end.close()
        self.memory.close()

    def _compute(self, device: Any) -> None:
        """Send the results of a batch, compute the next one, and copy the one after that.

        If the device runs out of memory, the batches on it are copied again, half as large.
        """
        size, gpu, more = self.wanted.pieces, None, True
        left: deque[Piece] = deque()
        copied: Batch | None = None
        copying: Batch | None = None
        computing: Batch | None = None
        while more or left or copying or computing:
            new: list[Piece] = []
            try:
                if gpu is None:
                    gpu = Gpu(self.memory, device, size)
                    gpu.compile()  # while workers read
                if more and not left:
                    more = self._collect(left, size, block=not (copying or computing))
                new = [left.popleft() for _ in range(min(size, len(left)))]
                copied = gpu.copy(new) if new else None
                if copying:
                    gpu.start(copying)
                if computing:
                    for reply in gpu.finish(computing):
                        self._send(reply)
                copying, computing = copied, copying
            except Exception as error:
                batches = [batch.pieces for batch in (computing, copying) if batch]
                left.extendleft(reversed([*chain(*batches), *new]))
                copied = copying = computing = None  # their images leave the device
                if gpu:
                    gpu.close()
                gpu = None
                if out_of_memory(error) and size > 1:
                    size //= 2
                    continue
                more = more and (bool(left) or self._collect(left, size, block=True))
                while left:
                    self._send(Reply(left.popleft().slot, error, {}))
        if gpu:
            gpu.close()

    def _collect(self, left: deque[Piece], most: int, *, block: bool) -> bool:
        """Add pieces that workers have sent to ``left``; return whether more may come.

        Args:
            left: Pieces to compute.
            most: Maximum number of pieces.
            block: Whether to wait for the first piece. If another thread waits for pieces, this one
                gets none unless it waits too.
        """
        if not self.receiving.acquire(blocking=block):
            return True
        try:
            while len(left) < most:
                ready: list[Any] = wait(self.ends, None if block and not left else 0)
                if self.woken in ready:
                    return False
                if not ready:
                    break
                for end in ready[: most - len(left)]:
                    self.ends.remove(end)
                    try:
                        left.append(end.recv())
                    except (EOFError, OSError):  # the worker has died, which its pool reports
                        continue
                    self.ends.append(end)  # last, so that all workers get their turn
        finally:
            self.receiving.release()
        return True

    def _send(self, reply: Reply) -> None:
        with self.sending, suppress(OSError):  # the worker has died, which its pool reports
            self.pipes[reply.slot // SLOTS].send(reply)
