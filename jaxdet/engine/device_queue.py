"""Queue of a device: a batch of pieces is copied to it while another one is computed."""

import threading
import time
from concurrent.futures import Future, ThreadPoolExecutor
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from jaxdet.engine.shared_slots import Leaf, Piece, Reply, ServerConfig, SharedMemory
from jaxdet.engine.startup import computing
from jaxdet.floor.plane import join_planes, unknown_plane
from jaxdet.pipeline import detect
from jaxdet.results.rows import map_leaves, row_inputs
from jaxdet.types import Detections, Frames, GroundPlane


class ServerMemory:
    """Memory of images and results, for all devices.

    Args:
        served: Properties that all logs share.

    Raises:
        WorkerError: There is too little memory.
    """

    def __init__(self, served: ServerConfig) -> None:
        self.served = served
        slots = served.slots._replace(results=_leaves(served))
        self.memory = SharedMemory(slots.nbytes)
        self.slots = slots._replace(path=self.memory.path, number=self.memory.number)
        self.arrays = self.slots.arrays(self.memory.map)
        self.pack = _pack()
        self._lock = threading.Lock()
        self._page_lock: Any = None

    def close(self) -> None:
        """Free the memory, which no device uses any more."""
        if self._page_lock:
            self._page_lock.unlock()
        self.memory.close()

    def page_lock(self, device: Any) -> None:
        """Page-lock the memory, slot by slot, unless it is already locked."""
        from jaxdet.stages._upload import PageLock

        with self._lock:
            if not self._page_lock:
                self._page_lock = PageLock(self.memory.map, device, sum(self.slots.sizes))


def _leaves(served: ServerConfig) -> Any:
    """Return the shapes and types of a frame's results.

    They are those of the reference for an image without depth, which takes less time than compiling
    the program.
    """
    slots = served.slots
    depth = np.zeros((1, *slots.depth), np.uint16)
    color = np.zeros((1, *slots.color), np.uint8) if slots.color else None
    frames = _frames(depth, color, served, unknown_plane(1))
    found = row_inputs(detect(frames, served.config, backend="reference"))
    return map_leaves(lambda part: Leaf(part.shape[1:], part.dtype), found)


def _frames(depth: Any, color: Any, served: ServerConfig, plane: GroundPlane) -> Frames:
    """Return frames with the images that the method reads."""
    nothing = np.zeros(len(depth), np.int64)
    known = nothing, nothing, nothing > 0
    return Frames(depth, served.calibration, *known, color=color, plane=plane)


class _Copied(NamedTuple):
    """Images of a batch on a device."""

    images: Any
    seconds: float
    """Time of copying [s]."""


class _Started(NamedTuple):
    """A batch that has been started."""

    packed: Any
    begin: float
    """Time at which it was started, by ``time.perf_counter`` [s]."""
    copying_s: float
    """Time of copying its images [s]."""
    ready: "Future[float]"
    """Time at which its results were ready, by ``time.perf_counter`` [s]."""


class DeviceQueue:
    """Copies batches to a device, computes them and copies their results back.

    Args:
        log: Memory of images and results.
        device: The device.
        pieces: Maximum number of pieces in a batch.
    """

    def __init__(self, log: ServerMemory, device: Any, pieces: int) -> None:
        from jaxdet.stages._upload import Uploader, wait_asleep

        wait_asleep(device)  # leaves the CPU cores to the workers
        slots = log.slots
        self.log, self.device, self.rows = log, device, pieces * slots.frames
        kinds = [(slots.depth, np.uint16)] + ([(slots.color, np.uint8)] if slots.color else [])
        self.uploader = Uploader([((self.rows, *shape), kind) for shape, kind in kinds], device)
        self._watch = ThreadPoolExecutor(1, "jaxdet-watch")
        self._ready = 0.0
        """Time when the last batch was computed, by ``time.perf_counter`` [s]."""
        # A gigabyte of pages is made and locked while the program is traced and loaded.
        self._copier = ThreadPoolExecutor(1, "jaxdet-copier")
        self._locked = self._copier.submit(log.page_lock, device)

    def compile(self) -> None:
        """Compute an empty batch, so that the program is compiled and allocates its memory."""
        self.finish([], self.start([], self._copied([])))

    def close(self) -> None:
        """End the threads."""
        self._copier.shutdown()
        self._watch.shutdown()

    def copy(self, pieces: list[Piece]) -> "Future[_Copied]":
        """Begin to copy pieces to the device."""
        return self._copier.submit(self._copied, pieces)

    def _copied(self, pieces: list[Piece]) -> _Copied:
        """Copy the images of pieces to the device; return the arrays on the device."""
        if pieces:
            self._locked.result()
        begin = time.perf_counter()
        images = self.uploader.upload([self.log.arrays[piece.slot].images for piece in pieces])
        return _Copied(images, time.perf_counter() - begin)

    def start(self, pieces: list[Piece], copied: _Copied) -> _Started:
        """Begin to compute pieces."""
        log, begin = self.log, time.perf_counter()
        missing = self.rows - len(pieces) * log.slots.frames
        plane = join_planes([*(piece.plane for piece in pieces), unknown_plane(missing)])
        depth, *color = copied.images
        frames = _frames(depth, color[0] if color else None, log.served, plane)
        with computing():
            found = detect(frames, log.served.config)
        packed = log.pack(_without_prior(found))
        ready = self._watch.submit(_time_when_ready, packed)
        return _Started(packed, begin, copied.seconds, ready)

    def finish(self, pieces: list[Piece], started: _Started) -> list[Reply]:
        """Wait for the results and copy them to the slots; return the replies."""
        ready, begin = started.ready.result(), time.perf_counter()
        results = [self.log.arrays[piece.slot].results for piece in pieces]
        self.uploader.download(started.packed, results)
        copying_s = started.copying_s + time.perf_counter() - begin
        # The time for which a batch waits for the previous one is not part of its computing time.
        computing_s = ready - max(self._ready, started.begin)
        self._ready = ready
        times = {"transfer": copying_s, "compute": computing_s}
        busy_s = {what: taken / max(1, len(pieces)) for what, taken in times.items()}
        return [Reply(piece.slot, None, busy_s) for piece in pieces]


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
    def pack(found: Detections) -> Any:
        arrays = jax.tree.leaves(row_inputs(found))
        rows = [a.reshape(len(a), -1).astype(jnp.int32) for a in arrays]
        return jnp.concatenate(rows, axis=1)

    return pack


def _without_prior(found: Detections) -> Any:
    """Return detections without the prior, which stays on the host."""
    return found if found.scene is None else found._replace(scene=found.scene._replace(prior=None))
