"""What is to be done with a log: decided before its frames are worked on, and then only read."""

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
    """Sees each batch with what was found in it, for instance to compare it with the truth.

    It is pickled into the processes that work on a log. What it says depends on the log and on its
    public attributes alone, which are part of the run's record. Where it has an attribute
    ``needs_color`` that is True, colour images are read for every frame.
    """

    def __call__(self, batch: "Batch", found: Detections, /) -> Any:
        """What it makes of a batch, picklable; ``found`` are NumPy arrays."""
        ...

    def summary(self, seen: Sequence[Any], /) -> Any:
        """What it says of a log, from all that it made of its batches; JSON can hold it."""
        ...


class Unit(NamedTuple):
    """Frames of a log, those of the plan in a range: what a process takes at a time."""

    number: int
    start: int
    stop: int
    """The frame after the last."""


class UnitSizes(NamedTuple):
    """Sizes of the units into which the frames of a log are divided."""

    size: int
    """Frames of a unit."""
    end_frames: int
    """About so many frames at the end are in smaller units, so that all workers end together."""
    end_size: int
    """Frames of those."""


def units_of(frames: range, sizes: UnitSizes) -> Iterator[Unit]:
    """The units that frames are shared out in, in order."""
    count, (size, end_frames, end_size) = len(frames), sizes
    whole = max(0, count - end_frames) // size * size
    ends = [*range(0, whole, size), *range(whole, count, end_size), count]
    for number, (first, last) in enumerate(pairwise(ends)):
        part = frames[first:last]
        yield Unit(number, part[0], part[-1] + 1)


class LogPlan(NamedTuple):
    """What holds for all frames of a log. No unit's results depend on another's."""

    log: str
    """The log's name."""
    camera: str
    """The camera's."""
    label: str
    """The log's name, and the camera's where the log has several."""
    frames: range
    """Numbers of the frames."""
    config: Config
    backend: BackendName
    batch_size: int
    """Frames that are read and computed together."""
    sizes: UnitSizes
    planes: Planes
    drawn: frozenset[int]
    """Frames to draw."""
    folder: Path
    """Folder of the log's results, in which pictures are drawn."""
    scratch: Path
    """Folder for temporary files."""
    picture: str
    """What names of pictures begin with."""
    maps: bool
    """Whether there is to be a map."""
    observers: Mapping[str, Observer]

    def units(self) -> Iterator[Unit]:
        """The units, in the order of their frames."""
        return units_of(self.frames, self.sizes)

    def where(self, unit: Unit) -> str:
        """The log and the frames of a unit."""
        first, last = unit.start, unit.stop - 1
        return f"{self.label}, " + (
            f"frames {first} to {last}" if last > first else f"frame {last}"
        )
