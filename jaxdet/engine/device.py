"""Devices that find the obstacles of a batch: this process, or the GPUs of the main process."""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from jaxdet.config import Config
from jaxdet.engine.slots import SLOTS, GpuPipe, Piece, Reply, Served, attached
from jaxdet.engine.startup import computing
from jaxdet.pipeline import BackendName, detect
from jaxdet.results.rows import row_inputs, to_host
from jaxdet.types import Detections, Frames

if TYPE_CHECKING:
    from jaxdet.io import Batch

ImageMemory = Callable[[], np.ndarray | tuple[np.ndarray, np.ndarray]]
"""Function that returns memory for decoded depth images, or depth and colour images; see
:meth:`Log.batches`."""


class Found(NamedTuple):
    """Detections of a batch, on the host."""

    inputs: Detections
    """Part of the detections from which rows are made, see
    :func:`jaxdet.results.rows.row_inputs`."""
    detections: Detections | None = None
    """All detections; None from GPUs of another process."""
    busy_s: Mapping[str, float] = MappingProxyType({})
    """Time that other processes spent on the batch, by step, as in
    :attr:`jaxdet.results.summary.Counts.busy_s`."""


class Device(Protocol):
    """Finds obstacles; batches are finished in the order in which they were started."""

    ahead: int
    """Number of batches that are started before the first of them is finished."""
    doing: str
    """Step to which the time of :meth:`start` and :meth:`finish` belongs: ``compute``, or ``wait``
    for GPUs of another process."""

    @property
    def images(self) -> ImageMemory | None:
        """Memory that the next batch is decoded into; None if any memory may be used."""
        ...

    def start(self, batch: "Batch") -> Any:
        """Start a batch of frames with images and with the priors of their floors."""
        ...

    def finish(self, started: Any) -> Found:
        """Return the detections of a batch; ``started`` is what :meth:`start` returned for it."""
        ...


class OwnDevice:
    """Device of this process: NumPy, or JAX on its default device.

    Args:
        config: The method's parameters.
        backend: Backend that computes.
        ahead: See :class:`Device`.
        with_cells: See :func:`jaxdet.detect`.
    """

    images: ImageMemory | None = None
    doing = "compute"

    def __init__(
        self, config: Config, backend: BackendName, ahead: int = 0, *, with_cells: bool = False
    ) -> None:
        self.ahead = ahead
        self._config = config
        self._how: Any = {"backend": backend, "with_cells": with_cells}

    def start(self, batch: "Batch") -> Detections:
        """Start a batch."""
        frames = method_frames(batch.frames, self._config)
        with computing():
            return detect(frames, self._config, **self._how)

    def finish(self, started: Detections) -> Found:
        """Wait for a batch."""
        with computing():
            detections: Detections = to_host(started)
        return Found(row_inputs(detections), detections)


def method_frames(frames: Frames, config: Config) -> Frames:
    """Return frames with the images that the method reads.

    By default the method reads only depth. The preset ``paper`` reads colour too; if the log has no
    colour images, black ones are used, and its frames have the status ``no_color``.
    """
    if not config.cluster.points:
        return frames._replace(color=None)
    if frames.color is not None:
        return frames
    camera = frames.calibration.image
    black = np.zeros((len(frames.depth), camera.height, camera.width, 3), np.uint8)
    return frames._replace(color=black)


def out_of_memory(error: Exception) -> bool:
    """Return whether an error means that this machine or a GPU ran out of memory."""
    return isinstance(error, MemoryError) or "RESOURCE_EXHAUSTED" in str(error)


class SharedDevice:
    """The GPUs of the main process, which compute for this worker.

    Args:
        served: Format of the frames, see :meth:`jaxdet.engine.pool.Pool.serve`.
        pipe: Connection of this worker to :class:`jaxdet.engine.gpu_threads.GpuThreads`.
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
