"""Frames of a log with their detections, for runs, exports, checks and :mod:`jaxdet.detector`."""

import time
from collections import Counter, deque
from collections.abc import Collection, Generator, Iterable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any, TypeVar

from jaxdet.config import Config
from jaxdet.engine.device import Device, Found
from jaxdet.engine.floors import Planes

if TYPE_CHECKING:
    from jaxdet.io import Batch

Key = TypeVar("Key")


def detected(
    batches: Iterable[tuple[Key, "Batch"]],
    planes: Planes,
    device: Device,
    busy: Counter[Any] | None = None,
) -> Generator[tuple[Key, "Batch", Found], None, None]:
    """Yield batches with the priors of their floors and with their detections, in order.

    A batch is read while ``device.ahead`` others are computed.

    Args:
        batches: Batches of frames with images, see :func:`color_to_read`, each with anything that
            belongs to it.
        planes: Priors of the log's floors.
        device: Device that computes.
        busy: Times of steps [s], to which those of this process and of the device are added.
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
    """Add the time that the context takes to a step."""
    start = time.perf_counter()
    try:
        yield
    finally:
        busy[step] += time.perf_counter() - start  # pyright: ignore


def color_to_read(config: Config, shown: bool | Collection[int] = False) -> dict[str, Any]:
    """Return which colour images are read, as arguments of :meth:`jaxdet.io.Log.batches`.

    Args:
        config: Configuration; the preset ``paper`` reads all.
        shown: Frames whose images are shown: all, none, or a container of numbers.
    """
    paper = config.cluster.points
    return {"color": paper or shown, "need_color": paper}
