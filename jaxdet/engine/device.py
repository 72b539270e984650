"""Detection of the obstacles in batches of frames, for runs, exports, checks and the detector.

A batch is computed by a :class:`Device`: this process (:class:`OwnDevice`), or the GPUs of the main
process (:class:`jaxdet.engine.slots.SharedDevice`).
"""

import time
from collections import Counter, deque
from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, TypeVar

import numpy as np

from jaxdet.config import Config
from jaxdet.engine.floors import Planes
from jaxdet.engine.startup import computing
from jaxdet.pipeline import BackendName, detect
from jaxdet.results.rows import row_inputs, to_host
from jaxdet.types import Detections, Frames

if TYPE_CHECKING:
    from jaxdet.io import Batch

Key = TypeVar("Key")
ImageMemory = Callable[[], np.ndarray | tuple[np.ndarray, np.ndarray]]
"""Function that returns memory for decoded depth images, or depth and colour images; see
:meth:`Log.batches`."""


class Found(NamedTuple):
    """Detections of a batch, on the host."""

    inputs: Detections
    """Those arrays of the detections that table rows are made of, see
    :func:`jaxdet.results.rows.row_inputs`."""
    detections: Detections | None = None
    """All detections; None from GPUs of another process."""
    busy_s: Mapping[str, float] = MappingProxyType({})
    """Time that other processes spent on the batch, by step, as in
    :attr:`jaxdet.results.summary.Counts.busy_s`."""


class Device(Protocol):
    """Detector of batches, which are finished in the order in which they were started."""

    ahead: int
    """Number of later batches that are started before a batch is finished."""
    doing: str
    """Step to which the time of :meth:`start` and :meth:`finish` belongs: ``compute``, or ``wait``
    for GPUs of another process."""

    @property
    def images(self) -> ImageMemory | None:
        """Memory that the next batch is decoded into; None if any memory may be used."""
        ...

    def start(self, batch: "Batch") -> Any:
        """Start the detection in a batch of frames with images and floor priors."""
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
        """Start the detection in a batch."""
        frames = method_frames(batch.frames, self._config)
        with computing():
            return detect(frames, self._config, **self._how)

    def finish(self, started: Detections) -> Found:
        """Wait for the detections of a batch, and return them on the host."""
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


def detected(
    batches: Iterable[tuple[Key, "Batch"]],
    planes: Planes,
    device: Device,
    busy: Counter[Any] | None = None,
) -> Generator[tuple[Key, "Batch", Found], None, None]:
    """Yield each key with its batch, with floor priors, and the detections, in order.

    A batch is read while ``device.ahead`` earlier batches are computed.

    Args:
        batches: Batches of frames with images, see :func:`color_to_read`, each with a key that is
            returned with it.
        planes: Priors of the log's floors.
        device: Device that computes.
        busy: Time of each step [s]; the times of this process and of the device are added.
    """
    busy = Counter() if busy is None else busy
    in_flight: deque[tuple[Key, Batch, Any]] = deque()

    def finish() -> tuple[Key, "Batch", Found]:
        key, batch, started = in_flight.popleft()
        with timed(busy, device.doing):
            found = device.finish(started)
        busy.update(found.busy_s)
        return key, batch, found

    try:
        for key, batch in batches:
            plane = planes.of(batch.frames.stamp_ns)
            batch = batch._replace(frames=batch.frames._replace(plane=plane))
            with timed(busy, device.doing):
                in_flight.append((key, batch, device.start(batch)))
            if len(in_flight) > device.ahead:
                yield finish()
        while in_flight:
            yield finish()
    finally:
        for _, _, started in in_flight:
            with suppress(Exception):
                device.finish(started)


@contextmanager
def timed(busy: Counter[Any], step: str) -> Iterator[None]:
    """Add the time spent in the context to ``busy[step]`` [s]."""
    start = time.perf_counter()
    try:
        yield
    finally:
        busy[step] += time.perf_counter() - start  # pyright: ignore


def color_to_read(config: Config, shown: bool | Collection[int] = False) -> dict[str, Any]:
    """Return arguments of :meth:`jaxdet.io.Log.batches` that select the colour images to read.

    Args:
        config: Configuration; the preset ``paper`` reads the images of all frames.
        shown: Frames whose images are shown: True (all), False (none), or their numbers.
    """
    paper = config.cluster.points
    return {"color": paper or shown, "need_color": paper}
