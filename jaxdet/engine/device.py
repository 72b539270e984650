"""Where the obstacles of a batch are found: in this process, or by the one that has the GPU."""

import pickle
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from jaxdet.config import Config
from jaxdet.engine.color import method_frames
from jaxdet.engine.floors import find_here
from jaxdet.engine.shared_slots import (
    SLOTS,
    Packing,
    Piece,
    Reply,
    Sample,
    ServerPipe,
    Slots,
    attached,
)
from jaxdet.engine.startup import computing
from jaxdet.pipeline import BackendName, detect
from jaxdet.results.rows import RowInputs, joined_inputs, row_inputs, to_host
from jaxdet.types import Detections, Frames, GroundPlane

if TYPE_CHECKING:
    from jaxdet.floor.units import FloorFit
    from jaxdet.io import Batch

ImageMemory = Callable[[], np.ndarray | tuple[np.ndarray, np.ndarray]]
"""Returns depth images to be written to, or depth and colour images; see :meth:`Log.batches`."""


class Found(NamedTuple):
    """What was found in a batch, on the host."""

    inputs: RowInputs
    """What rows need."""
    whole: Detections | None
    """All of it, where it was asked for."""
    busy_s: Mapping[str, float] = MappingProxyType({})
    """How long others worked on it, see :attr:`jaxdet.results.summary.Counts.busy_s`."""


class Device(Protocol):
    """Finds obstacles; batches are finished in the order in which they were started."""

    ahead: int
    """Batches that are started before the first of them is finished."""
    doing: str
    """What this process does meanwhile: ``compute``, or ``wait`` for who does."""

    @property
    def images(self) -> ImageMemory | None:
        """Gives the memory that the next batch is decoded to; None: any."""
        ...

    def start(self, batch: "Batch", plane: GroundPlane, *, whole: bool) -> Any:
        """Starts a batch.

        Args:
            batch: What was read.
            plane: The floor given to each frame.
            whole: Whether all that is found is asked for.
        """
        ...

    def finish(self, started: Any) -> Found:
        """Waits for what :meth:`start` returned."""
        ...

    def find_floors(self, frames: Frames) -> "FloorFit":
        """The floors of frames, see :func:`jaxdet.pipeline.find_floors`; no batch is started."""
        ...


class OwnDevice:
    """This process: NumPy, or JAX on whatever it computes on here.

    Args:
        config: The method's parameters.
        backend: What computes.
        ahead: Batches that are started before the first of them is finished.
    """

    images: ImageMemory | None = None
    doing = "compute"

    def __init__(self, config: Config, backend: BackendName, ahead: int) -> None:
        self.ahead = ahead
        self._config = config
        self._backend: BackendName = backend

    def start(self, batch: "Batch", plane: GroundPlane, *, whole: bool) -> "_Started":
        """Starts a batch."""
        frames = method_frames(batch.frames._replace(plane=plane), self._config)
        return _Started(frames, _if_it_fits(self._detect, frames, whole), whole)

    def finish(self, started: "_Started") -> Found:
        """Waits for a batch; one that takes too much memory is worked on in halves."""
        frames, found, whole = started
        found = found and _if_it_fits(self._on_host, found)
        found = found or self._in_halves(frames, whole)
        return Found(row_inputs(found), found if whole else None)

    def find_floors(self, frames: Frames) -> "FloorFit":
        """The floors of frames."""
        return find_here(self._config, self._backend, frames)

    def _detect(self, frames: Frames, whole: bool) -> Detections:
        with computing():
            return detect(frames, self._config, backend=self._backend, with_cells=whole)

    def _on_host(self, found: Detections) -> Detections:
        with computing():
            return to_host(found)

    def _in_halves(self, frames: Frames, whole: bool) -> Detections:
        """What is found in a batch, piece by piece; no frame's results depend on another's."""
        count = len(frames.valid)
        if count == 1:
            raise MemoryError("no memory for a single frame")
        found = []
        for rows in (slice(0, count // 2), slice(count // 2, count)):
            half = _rows(frames, rows)
            result = _if_it_fits(lambda half=half: self._on_host(self._detect(half, whole)))
            found.append(result or self._in_halves(half, whole))
        return joined_inputs(found)


class _Started(NamedTuple):
    """A batch that has been started."""

    frames: Frames
    found: Detections | None
    """None: there was not enough memory for all of it."""
    whole: bool


def _if_it_fits(function: Callable[..., Detections], *args: Any) -> Detections | None:
    """What a function returns; None: there is not enough memory for it."""
    try:
        return function(*args)
    except Exception as error:
        if not out_of_memory(error):
            raise
        return None


def out_of_memory(error: Exception) -> bool:
    """Whether memory, of this machine or a device, was not enough."""
    return isinstance(error, MemoryError) or "RESOURCE_EXHAUSTED" in str(error)


def _rows(frames: Frames, rows: slice) -> Frames:
    """Some frames of a batch."""
    parts = {k: a[rows] for k, a in frames._asdict().items() if isinstance(a, np.ndarray)}
    plane = frames.plane and GroundPlane(*(np.asarray(a)[rows] for a in frames.plane))
    return frames._replace(**parts, plane=plane)


class SharedDevice:
    """Another process, which computes for this worker.

    Args:
        slots: What :meth:`jaxdet.engine.pool.Pool.serve` returned.
        server_pipe: The worker's way to the device server.
    """

    ahead, doing = SLOTS - 1, "wait"

    def __init__(self, slots: Slots, server_pipe: ServerPipe) -> None:
        self._slots, self._server_pipe = slots, server_pipe
        self._first = server_pipe.number * SLOTS
        self._views = slots.views(attached(slots.path))
        self._turn = 0
        self._replies: dict[int, Reply] = {}
        self._results: tuple[bytes, Packing, np.ndarray] | None = None

    def images(self) -> np.ndarray | tuple[np.ndarray, np.ndarray]:
        """Return the memory for the next batch."""
        self._turn = (self._turn + 1) % SLOTS
        depth, color = self._views[self._first + self._turn]
        return depth if color is None else (depth, color)

    def start(self, batch: "Batch", plane: GroundPlane, *, whole: bool) -> int:
        """Starts the batch whose images are in the memory of the last call."""
        slot = self._first + self._turn
        self._server_pipe.pipe.send(Piece(self._server_pipe.number, slot, plane, whole))
        return slot

    def finish(self, started: int) -> Found:
        """Waits for a batch; its results are valid until its slot is started again."""
        _, told, whole, _, busy_s, _ = self._reply(started)
        if self._results is None or self._results[0] != told:
            packing: Packing = pickle.loads(told)
            self._results = told, packing, packing.view(attached(packing.path), self._slots)
        _, packing, rows = self._results
        return Found(packing.unpacked(rows[started]), whole, busy_s)

    def find_floors(self, frames: Frames) -> "FloorFit":
        """The floors of at most as many frames as a slot has."""
        count, slot = len(frames.valid), self._first + self._turn
        self._views[slot].depth[:count] = frames.depth
        assert frames.plane is not None
        self._server_pipe.pipe.send(Sample(self._server_pipe.number, slot, frames.plane))
        floors = self._reply(slot).floors
        assert floors is not None
        return floors

    def _reply(self, slot: int) -> Reply:
        """The device server's reply to what was sent in a slot; raises its error."""
        while slot not in self._replies:
            reply: Reply = self._server_pipe.pipe.recv()
            self._replies[reply.slot] = reply
        reply = self._replies.pop(slot)
        if reply.error:
            raise reply.error
        return reply
