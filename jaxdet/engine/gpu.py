"""GPUs of the main process, which compute for all workers, in a thread per GPU.

Workers decode images into slots of memory that they share with this process::

    worker 1 ...  decode > slot ---Piece--+
                                          |  all pieces that wait, at most a batch
    a thread per GPU           Gpu.copy  >  Gpu.start  >  Gpu.finish
                               batch 3      batch 2       batch 1, at the same time
                                                            |
    worker 1 ...  rows < results in the slot <---Reply------+

A batch holds pieces of any workers, in any order. Frames don't depend on each other, so results
don't depend on which pieces are in a batch.
"""

import threading
import time
from collections import deque
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain
from math import prod
from multiprocessing import Pipe
from multiprocessing.connection import wait
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxdet.config import Config
from jaxdet.engine.device import out_of_memory
from jaxdet.engine.slots import SLOTS, Piece, Reply, Served, SlotMemory
from jaxdet.engine.startup import computing
from jaxdet.floor.plane import join_planes, unknown_plane
from jaxdet.pipeline import detect
from jaxdet.results.rows import map_leaves, row_inputs
from jaxdet.types import Detections, Frames, GroundPlane

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
        piece_frames: Maximum number of frames in a slot, by the memory for images.
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


def result_types(served: Served) -> Any:
    """Return the types and shapes of a frame's results, for :attr:`Served.results`.

    The reference computes them for an image without depth, which takes less time than compiling the
    program.
    """
    depth = np.zeros((1, *served.depth), np.uint16)
    color = [np.zeros((1, *served.color), np.uint8)] if served.color else []
    frames = _frames([depth, *color], served, unknown_plane(1))
    found = row_inputs(detect(frames, served.config, backend="reference"))
    return map_leaves(lambda part: np.dtype((part.dtype, part.shape[1:])), found)


def _frames(images: list[Any], served: Served, plane: GroundPlane) -> Frames:
    """Return frames with the images that the method reads."""
    depth, *color = images
    nothing = np.zeros(len(depth), np.int64)
    known = nothing, nothing, nothing > 0
    return Frames(depth, served.calibration, *known, color=color[0] if color else None, plane=plane)


@dataclass
class Batch:
    """Pieces that are computed together."""

    pieces: list[Piece]
    copied: "Future[tuple[list[Any], float]]"
    """Images on the device, and the time of copying them [s]."""
    begin: float = 0.0
    """Time at which computing began, by ``time.perf_counter`` [s]."""
    packed: Any = None
    """Results on the device, see :func:`_pack`."""
    ready: "Future[float] | None" = None
    """Time at which the results were ready, by ``time.perf_counter`` [s]."""


class Gpu:
    """A GPU, to which a batch of pieces is copied while the previous batch is computed.

    Args:
        memory: Memory of images and results.
        device: The device.
        pieces: Maximum number of pieces in a batch.
    """

    def __init__(self, memory: SlotMemory, device: Any, pieces: int) -> None:
        from jaxdet.stages._upload import Uploader, wait_asleep

        wait_asleep(device)  # leaves the CPU cores to the workers
        served = memory.served
        self.memory, self.rows = memory, pieces * served.frames
        kinds = [(served.depth, np.uint16)] + ([(served.color, np.uint8)] if served.color else [])
        self.uploader = Uploader([((self.rows, *shape), kind) for shape, kind in kinds], device)
        self._watch = ThreadPoolExecutor(1, "jaxdet-watch")
        self._ready = 0.0
        """Time when the last batch was computed, by ``time.perf_counter`` [s]."""
        # A gigabyte is allocated and page-locked while the program is traced and loaded.
        self._copier = ThreadPoolExecutor(1, "jaxdet-copier")
        self._locked = self._copier.submit(memory.page_lock, device)

    def compile(self) -> None:
        """Compute an empty batch, so that the program is compiled and allocates its memory."""
        empty = Batch([], Future())
        empty.copied.set_result(self._upload([]))
        self.start(empty)
        self.finish(empty)

    def close(self) -> None:
        """End the threads."""
        self._copier.shutdown()
        self._watch.shutdown()

    def copy(self, pieces: list[Piece]) -> Batch:
        """Begin to copy pieces to the device."""
        return Batch(pieces, self._copier.submit(self._upload, pieces))

    def _upload(self, pieces: list[Piece]) -> tuple[list[Any], float]:
        """Copy the images of pieces; return the arrays on the device, and the time taken."""
        if pieces:
            self._locked.result()
        begin = time.perf_counter()
        images = self.uploader.upload([self.memory.slots[piece.slot].images for piece in pieces])
        return images, time.perf_counter() - begin

    def start(self, batch: Batch) -> None:
        """Wait until a batch is copied, and begin to compute it."""
        images, _ = batch.copied.result()
        served, batch.begin = self.memory.served, time.perf_counter()
        missing = unknown_plane(self.rows - len(batch.pieces) * served.frames)
        plane = join_planes([*(piece.plane for piece in batch.pieces), missing])
        with computing():
            found = detect(_frames(images, served, plane), served.config)
        batch.packed = _pack()(row_inputs(found))
        batch.ready = self._watch.submit(_time_when_ready, batch.packed)

    def finish(self, batch: Batch) -> list[Reply]:
        """Wait for the results and copy them to the slots; return the replies."""
        assert batch.ready
        ready, begin = batch.ready.result(), time.perf_counter()
        results = [self.memory.slots[piece.slot].results for piece in batch.pieces]
        self.uploader.download(batch.packed, results)
        _, copying_s = batch.copied.result()
        copying_s += time.perf_counter() - begin
        # The time for which a batch waits for the previous one is not part of its computing time.
        computing_s = ready - max(self._ready, batch.begin)
        self._ready = ready
        times = {"transfer": copying_s, "compute": computing_s}
        busy_s = {what: taken / max(1, len(results)) for what, taken in times.items()}
        return [Reply(piece.slot, None, busy_s) for piece in batch.pieces]


def _time_when_ready(found: Any) -> float:
    """Wait until an array is computed; return the time, by ``time.perf_counter`` [s]."""
    found.block_until_ready()
    return time.perf_counter()


@lru_cache(maxsize=1)
def _pack() -> Any:
    """Return the compiled function that packs inputs of rows as ``(B, ints)`` int32."""
    import jax
    import jax.numpy as jnp

    @jax.jit
    def pack(inputs: Detections) -> Any:
        rows = [a.reshape(len(a), -1).astype(jnp.int32) for a in jax.tree.leaves(inputs)]
        return jnp.concatenate(rows, axis=1)

    return pack


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
        """Connections that are read; connections to workers that have died are removed."""
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
                copied = copying = computing = None  # frees their images on the device
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
