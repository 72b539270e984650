"""Devices that find the obstacles of a batch: this process, or the device server with a GPU."""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from jaxdet.config import Config
from jaxdet.engine.color import method_frames
from jaxdet.engine.shared_slots import (
    SLOTS,
    Piece,
    Reply,
    ServerConfig,
    ServerPipe,
    attached,
)
from jaxdet.engine.startup import computing
from jaxdet.pipeline import BackendName, detect
from jaxdet.results.rows import row_inputs, to_host
from jaxdet.types import Detections, GroundPlane

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
    busy_s: Mapping[str, float] = MappingProxyType({})
    """Time that other processes spent on the batch, by step, as in
    :attr:`jaxdet.results.summary.Counts.busy_s`."""


class Device(Protocol):
    """Finds obstacles; batches are finished in the order in which they were started."""

    ahead: int
    """Number of batches that are started before the first of them is finished."""
    doing: str
    """Step to which the time of :meth:`start` and :meth:`finish` belongs: ``compute``, or ``wait``
    for the device server."""

    @property
    def images(self) -> ImageMemory | None:
        """Memory that the next batch is decoded into; None if any memory may be used."""
        ...

    def start(self, batch: "Batch", plane: GroundPlane) -> Any:
        """Start a batch.

        Args:
            batch: Frames with images.
            plane: Prior of each frame's floor.
        """
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
    """

    images: ImageMemory | None = None
    doing = "compute"

    def __init__(self, config: Config, backend: BackendName, ahead: int) -> None:
        self.ahead = ahead
        self._config = config
        self._backend: BackendName = backend

    def start(self, batch: "Batch", plane: GroundPlane) -> Detections:
        """Start a batch."""
        frames = method_frames(batch.frames._replace(plane=plane), self._config)
        with computing():
            return detect(frames, self._config, backend=self._backend)

    def finish(self, started: Detections) -> Found:
        """Wait for a batch."""
        with computing():
            return Found(to_host(row_inputs(started)))


def out_of_memory(error: Exception) -> bool:
    """Return whether an error means that this machine or a GPU ran out of memory."""
    return isinstance(error, MemoryError) or "RESOURCE_EXHAUSTED" in str(error)


class SharedDevice:
    """The device server, which computes for this worker in another process.

    Args:
        served: Configuration of the device server, see :meth:`jaxdet.engine.pool.Pool.serve`.
        server_pipe: Connection of this worker to the device server.
    """

    ahead, doing = SLOTS - 1, "wait"

    def __init__(self, served: ServerConfig, server_pipe: ServerPipe) -> None:
        self.served, self._server_pipe = served, server_pipe
        self._slots = slots = served.slots
        self._first = server_pipe.number * SLOTS
        self._arrays = slots.arrays(attached(slots.path))
        self._turn = 0
        self._replies: dict[int, Reply] = {}

    def images(self) -> np.ndarray | tuple[np.ndarray, np.ndarray]:
        """Return the memory that the next batch is decoded into."""
        self._turn = (self._turn + 1) % SLOTS
        depth, color, _ = self._arrays[self._first + self._turn]
        return depth if color is None else (depth, color)

    def start(self, batch: "Batch", plane: GroundPlane) -> int:
        """Start the batch whose images are in the memory that :attr:`images` returned last."""
        slot = self._first + self._turn
        self._server_pipe.pipe.send(Piece(self._server_pipe.number, slot, plane))
        return slot

    def finish(self, started: int) -> Found:
        """Wait for a batch; its results are valid until its slot is started again."""
        reply = self._reply(started)
        inputs = self._slots.unpacked(self._arrays[started].results)
        return Found(inputs, reply.busy_s)

    def _reply(self, slot: int) -> Reply:
        """Wait for the device server's reply to a slot; raise the error in it."""
        while slot not in self._replies:
            reply: Reply = self._server_pipe.pipe.recv()
            self._replies[reply.slot] = reply
        reply = self._replies.pop(slot)
        if reply.error:
            raise reply.error
        return reply
