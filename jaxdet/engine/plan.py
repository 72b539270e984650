"""Plan of a log: all that is decided before its frames are worked on."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from jaxdet.config import Config
from jaxdet.engine.floors import Planes
from jaxdet.pipeline import BackendName
from jaxdet.types import Detections

if TYPE_CHECKING:
    from jaxdet.io import Batch


class Observer(Protocol):
    """Callback that gets each batch with its detections, for instance to compare them with truth.

    It is pickled into the processes that work on a log. Its answers may depend on nothing but the
    log and its public attributes, which are part of the run's record. If it has an attribute
    ``needs_color`` that is True, colour images are read for every frame.
    """

    def __call__(self, batch: "Batch", found: Detections, /) -> Any:
        """Return a picklable answer to a batch, whose detections ``found`` are NumPy arrays."""
        ...

    def summary(self, seen: Sequence[Any], /) -> Any:
        """Return the entry of a log in ``summary.json``, from the answers to its batches."""
        ...


class Unit(NamedTuple):
    """Range of frames of a log, of which a process takes those in the plan at a time."""

    number: int
    start: int
    stop: int
    """Number after that of the last frame."""


class UnitSizes(NamedTuple):
    """Sizes of the units into which the frames of a log are divided."""

    size: int
    """Number of frames in a unit."""
    end_frames: int
    """Approximate number of last frames in smaller units, so that all workers end together."""
    end_size: int
    """Number of frames in each of those."""


def units_of(frames: range, sizes: UnitSizes) -> Iterator[Unit]:
    """Yield the units of frames, in order."""
    count, (size, end_frames, end_size) = len(frames), sizes
    whole = max(0, count - end_frames) // size * size
    ends = [*range(0, whole, size), *range(whole, count, end_size), count]
    for number, (first, last) in enumerate(pairwise(ends)):
        part = frames[first:last]
        yield Unit(number, part[0], part[-1] + 1)


class LogPlan(NamedTuple):
    """Plan of a log, which is the same for all frames; units don't depend on each other."""

    log: str
    """Name of the log."""
    camera: str
    """Name of the camera."""
    label: str
    """Name of the log, followed by that of the camera if the log has several."""
    frames: range
    """Numbers of the frames."""
    config: Config
    backend: BackendName
    batch_size: int
    """Number of frames that are read and computed together."""
    sizes: UnitSizes
    planes: Planes
    drawn: frozenset[int]
    """Numbers of the frames to draw."""
    folder: Path
    """Folder of the log's results, for pictures."""
    scratch: Path
    """Folder for temporary files."""
    picture: str
    """Prefix of the names of pictures."""
    maps: bool
    """Whether to make a map."""
    observers: Mapping[str, Observer]

    def units(self) -> Iterator[Unit]:
        """Yield the units in the order of their frames."""
        return units_of(self.frames, self.sizes)

    def where(self, unit: Unit) -> str:
        """Return the log and the frames of a unit, for people."""
        first, last = unit.start, unit.stop - 1
        return f"{self.label}, " + (
            f"frames {first} to {last}" if last > first else f"frame {last}"
        )
