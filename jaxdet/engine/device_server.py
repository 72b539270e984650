"""Device server: the process with the GPUs computes for all workers.

Images and results are in memory that it shares with the workers. It collects pieces of any workers
in any order; the queue of a device copies them to its GPU as one batch, and the packed results
back. Frames don't depend on each other, so the way pieces form batches changes no result.
"""

import queue
import selectors
import threading
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from math import prod
from multiprocessing import Pipe
from typing import TYPE_CHECKING, Any, NamedTuple

from jaxdet.config import Config
from jaxdet.engine.device import out_of_memory
from jaxdet.engine.device_queue import DeviceQueue, ServerMemory
from jaxdet.engine.shared_slots import Piece, Reply, ServerConfig, Slots

if TYPE_CHECKING:
    from jaxdet.io import Log

PIECE_FRAMES, PIECE_BYTES = 16, 24 << 20
"""Maximum number of frames and of bytes in a slot, which holds at least one frame."""
BATCH_PIECES = 16
"""Number of pieces in a batch; for images of 640x480 it has 256 frames."""


def server_config(
    log: "Log", config: Config, batch_size: int | None, piece_frames: int, workers: int
) -> ServerConfig:
    """Return the properties of a device server for a log, with the sizes of slots and batches.

    The arguments are those of :meth:`jaxdet.engine.pool.Pool.serve`.
    """
    depth, color = log.depth_shape, None
    if config.cluster.points:
        camera = log.calibration.image
        color = camera.height, camera.width, 3
    fits = PIECE_BYTES // (2 * prod(depth) + (prod(color) if color else 0))
    frames = max(1, min(PIECE_FRAMES, fits, piece_frames, batch_size or PIECE_FRAMES))
    pieces = BATCH_PIECES if batch_size is None else -(-batch_size // frames)
    return ServerConfig(Slots("", frames, depth, color, workers), pieces, log.calibration, config)


class _Batch(NamedTuple):
    """Pieces that are computed together."""

    pieces: list[Piece]
    state: Any
    """Future of their copy on the device, or the handle of their computation."""


_NOTHING = _Batch([], None)


class DeviceServer:
    """Server that computes the images that workers decode, with a thread per GPU.

    It runs until :meth:`close`. It has page-locked memory for each worker: ``SLOTS`` times
    ``PIECE_BYTES`` of images, or ``SLOTS`` frames if that is more, and their results (0.25 MB per
    frame of 640x480).

    Args:
        served: Properties that all logs share.
        pipes: Connections to the workers.
        devices: GPUs.

    Raises:
        WorkerError: There is too little memory.
    """

    def __init__(self, served: ServerConfig, pipes: list[Any], devices: Sequence[Any]) -> None:
        self.served, self.pipes, self.devices = served, pipes, devices
        self.memory = ServerMemory(served)
        self.waiting: queue.SimpleQueue[Piece | None] = queue.SimpleQueue()
        self.sending = threading.Lock()
        """Held while a reply is sent, as two threads may have replies for one worker."""
        self.threads: list[threading.Thread] = []
        self.woken, self.waker = Pipe(duplex=False)
        self._run(self._receive)
        for device in devices:
            self._run(self._compute, device)

    @property
    def config(self) -> ServerConfig:
        """Configuration for workers: ``served``, with the path of the slots."""
        return self.served._replace(slots=self.memory.slots)

    def close(self) -> None:
        """End the threads and free the memory."""
        self.waker.send(None)
        for thread in self.threads:
            thread.join()
        for end in (self.waker, self.woken):
            end.close()
        self.memory.close()

    def _run(self, target: Any, *args: Any) -> None:
        name = "jaxdet-device-server"
        thread = threading.Thread(target=target, args=args, name=name, daemon=True)
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
        """Compute batches on one device while the next one is copied to it.

        If the device runs out of memory, the batches on it are copied again, half as large.
        """
        size, device_queue, more = self.served.pieces, None, True
        left: deque[Piece] = deque()
        copying = computing = _NOTHING
        while more or left or copying.pieces or computing.pieces:
            new: list[Piece] = []
            try:
                if device_queue is None:
                    device_queue = DeviceQueue(self.memory, device, size)
                    device_queue.compile()  # while workers read
                if more and not left:
                    idle = not (copying.pieces or computing.pieces)
                    more = self._collect(left, size, block=idle)
                new = [left.popleft() for _ in range(min(size, len(left)))]
                copying, computing = self._step(device_queue, new, copying, computing)
            except Exception as error:
                left.extendleft(reversed([*computing.pieces, *copying.pieces, *new]))
                copying = computing = _NOTHING
                if device_queue:
                    device_queue.close()
                device_queue = None
                if out_of_memory(error) and size > 1:
                    size //= 2
                    continue
                more = more and (bool(left) or self._collect(left, size, block=True))
                while left:
                    piece = left.popleft()
                    self._send(piece, Reply(piece.slot, error, {}))
        if device_queue:
            device_queue.close()

    def _step(
        self, device_queue: DeviceQueue, new: list[Piece], copying: _Batch, computing: _Batch
    ) -> tuple[_Batch, _Batch]:
        """Send the results of a batch, compute the next one, and copy the one after that."""
        copied = _Batch(new, device_queue.copy(new)) if new else _NOTHING
        started = _NOTHING
        if copying.pieces:
            state = device_queue.start(copying.pieces, copying.state.result())
            started = copying._replace(state=state)
        if computing.pieces:
            for piece, reply in zip(computing.pieces, device_queue.finish(*computing), strict=True):
                self._send(piece, reply)
        return copied, started

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

    def _send(self, to: Piece, reply: Reply) -> None:
        with self.sending, suppress(OSError):  # the worker has died, which its pool reports
            self.pipes[to.worker].send(reply)
