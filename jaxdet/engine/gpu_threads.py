"""Threads of the main process that compute on its GPUs for all workers.

Workers decode images into slots of memory that they share with this process::

    worker 1 ...  decode > slot --Piece--> receive > queue of pieces
                                                          | batches of pieces
    a thread per GPU:             Gpu.copy  >  Gpu.start  >  Gpu.finish
                                  batch 3      batch 2       batch 1, at the same time
                                                               |
    worker 1 ...  rows < results in the slot <-----Reply-------+

Pieces of any workers form a batch, in any order. Frames don't depend on each other, so the way
pieces form batches changes no result.
"""

import queue
import selectors
import threading
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from itertools import chain
from math import prod
from multiprocessing import Pipe
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
    """Return what GPUs compute for a log, with the sizes of slots and batches.

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
    """Threads that compute the images that workers decode: one that receives, and one per GPU.

    They run until :meth:`close`. Each worker has page-locked memory: ``SLOTS`` times
    ``PIECE_BYTES`` of images, or ``SLOTS`` frames if that is more, and their results (0.25 MB per
    frame of 640x480).

    Args:
        wanted: What they compute, see :func:`served_for`.
        pipes: Connections to the workers.
        devices: GPUs.

    Raises:
        WorkerError: There is too little memory.
    """

    def __init__(self, wanted: Served, pipes: list[Any], devices: Sequence[Any]) -> None:
        self.wanted, self.pipes, self.devices = wanted, pipes, devices
        self.memory = SlotMemory(wanted._replace(results=result_types(wanted)))
        self.waiting: queue.SimpleQueue[Piece | None] = queue.SimpleQueue()
        self.sending = threading.Lock()
        """Held while a reply is sent, as two threads may have replies for one worker."""
        self.threads: list[threading.Thread] = []
        self.woken, self.waker = Pipe(duplex=False)
        self._run(self._receive)
        for device in devices:
            self._run(self._compute, device)

    def close(self) -> None:
        """End the threads and free the memory."""
        self.waker.send(None)
        for thread in self.threads:
            thread.join()
        for end in (self.waker, self.woken):
            end.close()
        self.memory.close()

    def _run(self, target: Any, *args: Any) -> None:
        thread = threading.Thread(target=target, args=args, name="jaxdet-gpu", daemon=True)
        self.threads.append(thread)
        thread.start()

    def _receive(self) -> None:
        """Put the pieces that workers send into the queue, until the end."""
        with selectors.DefaultSelector() as ends:
            for end in (*self.pipes, self.woken):
                ends.register(end, selectors.EVENT_READ)
            while True:
                for key, _ in ends.select():
                    end: Any = key.fileobj
                    if end is self.woken:
                        for _ in self.devices:
                            self.waiting.put(None)
                        return
                    try:
                        self.waiting.put(end.recv())
                    except (EOFError, OSError):  # the worker has died, which its pool reports
                        ends.unregister(end)

    def _compute(self, device: Any) -> None:
        """Send the results of a batch, compute the next one, and copy the one after that.

        If the device runs out of memory, the batches on it are copied again, half as large.
        """
        size, gpu, more = self.wanted.pieces, None, True
        left: deque[Piece] = deque()
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
                copying = computing = None
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
        """Add waiting pieces to ``left``, at most a batch; return whether more may come."""
        while len(left) < most:
            try:
                piece = self.waiting.get(block=block and not left)
            except queue.Empty:
                break
            if piece is None:
                return False
            left.append(piece)
        return True

    def _send(self, reply: Reply) -> None:
        with self.sending, suppress(OSError):  # the worker has died, which its pool reports
            self.pipes[reply.slot // SLOTS].send(reply)
