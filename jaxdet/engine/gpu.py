"""A GPU: a batch of pieces is copied to it while another one is computed."""

import time
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from jaxdet.engine.slots import Piece, Reply, Served, SlotMemory
from jaxdet.engine.startup import computing
from jaxdet.floor.plane import join_planes, unknown_plane
from jaxdet.pipeline import detect
from jaxdet.results.rows import map_leaves, row_inputs
from jaxdet.types import Detections, Frames, GroundPlane


def result_types(served: Served) -> Any:
    """Return the types and shapes of a frame's results, for :attr:`Served.results`.

    They are those of the reference for an image without depth, which takes less time than compiling
    the program.
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
    """Time at which it was started, by ``time.perf_counter`` [s]."""
    packed: Any = None
    """Its results on the device, see :func:`_pack`."""
    ready: "Future[float] | None" = None
    """Time at which its results were ready, by ``time.perf_counter`` [s]."""


class Gpu:
    """Copies batches to a device, computes them and copies their results back.

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
        # A gigabyte of pages is made and locked while the program is traced and loaded.
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
