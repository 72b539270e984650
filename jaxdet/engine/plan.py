"""Plan of a log: the decisions that are made before its frames are processed."""

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from jaxdet.engine.floors import Planes
from jaxdet.engine.settings import RunSettings


class Unit(NamedTuple):
    """Range of frames of a log; one process works on those of its frames that are in the plan."""

    number: int
    start: int
    stop: int
    """Number of the last frame plus 1."""


class UnitSizes(NamedTuple):
    """Sizes of the units into which the frames of a log are divided."""

    size: int
    """Number of frames in a unit."""
    end_frames: int
    """Approximate number of frames at the log's end that are in smaller units, so that all workers
    finish at about the same time."""
    end_size: int
    """Number of frames in each of the smaller units."""


def units_of(frames: range, sizes: UnitSizes) -> Iterator[Unit]:
    """Yield the units of frames, in order."""
    count, (size, end_frames, end_size) = len(frames), sizes
    whole = max(0, count - end_frames) // size * size
    ends = [*range(0, whole, size), *range(whole, count, end_size), count]
    for number, (first, last) in enumerate(pairwise(ends)):
        part = frames[first:last]
        yield Unit(number, part[0], part[-1] + 1)


class LogPlan(NamedTuple):
    """Plan of a log, which holds for all its units; they don't depend on each other."""

    settings: RunSettings
    log: str
    """Name of the log."""
    camera: str
    """Name of the camera."""
    label: str
    """Name of the log, followed by that of the camera if the log has several."""
    frames: range
    """Numbers of the frames."""
    batch_size: int
    """Number of frames that are read and computed together."""
    sizes: UnitSizes
    planes: Planes
    drawn: frozenset[int]
    """Numbers of the frames to draw."""
    folder: Path
    """Folder of the log's results, to which pictures are written."""
    scratch: Path
    """Folder for temporary files."""
    picture: str
    """Prefix of the names of pictures."""

    def units(self) -> Iterator[Unit]:
        """Yield the units in the order of their frames."""
        return units_of(self.frames, self.sizes)

    def where(self, unit: Unit) -> str:
        """Return a text that names the log and the frames of a unit."""
        first, last = unit.start, unit.stop - 1
        return f"{self.label}, " + (
            f"frames {first} to {last}" if last > first else f"frame {last}"
        )
