"""Where the obstacles of a batch are found: in this process, or by the one that has the GPU."""

import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from jaxdet.config import Config
from jaxdet.pipeline import BackendName, detect
from jaxdet.results.rows import RowInputs, row_inputs, to_host
from jaxdet.types import Detections, GroundPlane

if TYPE_CHECKING:
    from jaxdet.io import Batch

ImageMemory = Callable[[], tuple[np.ndarray, np.ndarray]]


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


@contextmanager
def interrupts_held_back() -> Iterator[None]:
    """A Ctrl-C waits until the end of the block.

    Kernels are called back by XLA in this thread: an exception there would leave a batch half
    computed.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    held: list[Any] = []
    before = signal.signal(signal.SIGINT, lambda *given: held.append(given))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        if held and callable(before):
            before(*held[0])


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

    def start(self, batch: "Batch", plane: GroundPlane, *, whole: bool) -> tuple[Detections, bool]:
        """Starts a batch."""
        frames = batch.frames._replace(plane=plane)
        with interrupts_held_back():
            return detect(frames, self._config, backend=self._backend), whole

    def finish(self, started: tuple[Detections, bool]) -> Found:
        """Waits for a batch."""
        found, whole = started
        with interrupts_held_back():
            found = to_host(found)
        return Found(row_inputs(found), found if whole else None)
