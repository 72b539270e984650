"""Devices that find the obstacles of a batch: this process, or the device server with a GPU."""

import pickle
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from jaxdet.config import Config
from jaxdet.engine.color import method_frames
from jaxdet.engine.floors import find_here, find_without_jax
from jaxdet.engine.shared_slots import (
    SLOTS,
    Packing,
    Piece,
    Reply,
    ServerConfig,
    ServerPipe,
    attached,
)
from jaxdet.engine.startup import computing
from jaxdet.floor.plane import join_planes, unknown_plane
from jaxdet.floor.units import FloorFit, floor_fit
from jaxdet.pipeline import BackendName, detect
from jaxdet.results.rows import RowInputs, row_inputs, to_host
from jaxdet.types import Detections, Frames, GroundPlane

if TYPE_CHECKING:
    from jaxdet.io import Batch

ImageMemory = Callable[[], np.ndarray | tuple[np.ndarray, np.ndarray]]
"""Function that returns memory for decoded depth images, or depth and colour images; see
:meth:`Log.batches`."""


class Found(NamedTuple):
    """Detections of a batch, on the host."""

    inputs: RowInputs
    """Part of the detections from which rows are made."""
    whole: Detections | None
    """All detections; None unless they were requested."""
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

    def start(self, batch: "Batch", plane: GroundPlane, *, whole: bool) -> Any:
        """Start a batch.

        Args:
            batch: Frames with images.
            plane: Prior of each frame's floor.
            whole: Whether all detections are needed, not only the part that rows are made of.
        """
        ...

    def finish(self, started: Any) -> Found:
        """Return the detections of a batch; ``started`` is what :meth:`start` returned for it."""
        ...

    def find_floors(self, frames: Frames) -> FloorFit:
        """Return the floors of frames, see :func:`jaxdet.pipeline.find_floors`.

        All started batches must be finished first.
        """
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

    def start(self, batch: "Batch", plane: GroundPlane, *, whole: bool) -> "_Started":
        """Start a batch."""
        frames = method_frames(batch.frames._replace(plane=plane), self._config)
        with computing():
            found = detect(frames, self._config, backend=self._backend, with_cells=whole)
        return _Started(found, whole)

    def finish(self, started: "_Started") -> Found:
        """Wait for a batch."""
        with computing():
            found = to_host(started.found)
        return Found(row_inputs(found), found if started.whole else None)

    def find_floors(self, frames: Frames) -> FloorFit:
        """Return the floors of frames."""
        return find_here(self._config, self._backend, frames)


class _Started(NamedTuple):
    """A batch that has been started."""

    found: Detections
    whole: bool


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
        self._views = slots.views(attached(slots.path))
        self._turn = 0
        self._replies: dict[int, Reply] = {}
        self._results: tuple[bytes, Packing, np.ndarray] | None = None

    def images(self) -> np.ndarray | tuple[np.ndarray, np.ndarray]:
        """Return the memory that the next batch is decoded into."""
        self._turn = (self._turn + 1) % SLOTS
        depth, color = self._views[self._first + self._turn]
        return depth if color is None else (depth, color)

    def start(self, batch: "Batch", plane: GroundPlane, *, whole: bool) -> int:
        """Start the batch whose images are in the memory that :attr:`images` returned last."""
        return self._start(plane, whole)

    def finish(self, started: int) -> Found:
        """Wait for a batch; its results are valid until its slot is started again."""
        _, packed, whole, _, busy_s = self._reply(started)
        if self._results is None or self._results[0] != packed:
            packing: Packing = pickle.loads(packed)
            self._results = packed, packing, packing.view(attached(packing.path), self._slots)
        _, packing, rows = self._results
        return Found(packing.unpacked(rows[started]), whole, busy_s)

    def find_floors(self, frames: Frames) -> FloorFit:
        """Return the floors of frames, at most as many as a slot has; see :class:`Device`.

        They are computed as a batch, whose results contain the floors. Results of the preset
        ``paper`` do not, and turned images do not fit the calibration of the device server: those
        floors are found in this process, and are equal.
        """
        config, camera = self.served.config, self.served.calibration
        if config.cluster.points or frames.calibration.depth != camera.depth:
            return find_without_jax(config, frames)
        count = len(frames.valid)
        self._views[self._first + self._turn].depth[:count] = frames.depth
        assert frames.plane is not None
        plane = join_planes([frames.plane, unknown_plane(self._slots.frames - count)])
        scene = self.finish(self._start(plane, whole=False)).inputs.scene
        assert scene is not None
        floors = np.array(scene.floor[:count])
        return floor_fit(floors, frames.plane, frames.calibration.depth_unit)

    def _start(self, plane: GroundPlane, whole: bool) -> int:
        """Send the images in the current slot to the device server, without waiting for results."""
        slot = self._first + self._turn
        self._server_pipe.pipe.send(Piece(self._server_pipe.number, slot, plane, whole))
        return slot

    def _reply(self, slot: int) -> Reply:
        """Wait for the device server's reply to a slot; raise the error in it."""
        while slot not in self._replies:
            reply: Reply = self._server_pipe.pipe.recv()
            self._replies[reply.slot] = reply
        reply = self._replies.pop(slot)
        if reply.error:
            raise reply.error
        return reply
