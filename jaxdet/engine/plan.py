"""Plan of a log: its units, and the decisions that are made before its frames are processed."""

from collections import deque
from collections.abc import Iterable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from jaxdet.engine.floors import Planes
from jaxdet.engine.settings import RunSettings

UNIT_FRAMES = 256
"""Maximum number of frames in a unit; they are consecutive, as neighbours share chunks."""


class LogPlan(NamedTuple):
    """Plan of a log, shared by all its units, which don't depend on each other."""

    settings: RunSettings
    batch_size: int
    """Number of frames that are read and computed together."""
    planes: Planes
    drawn: frozenset[int]
    """Numbers of the frames to draw."""
    folder: Path
    """Folder of the log's results, to which pictures are written."""
    scratch: Path
    """Folder for temporary files."""
    picture: str
    """Prefix of the names of pictures."""


class Unit(NamedTuple):
    """Range of frames of a log, of which one process works on the selected frames."""

    number: int
    start: int
    stop: int
    """Number of the last frame plus 1."""

    def where(self, label: str) -> str:
        """Return a text with the log's ``label`` and the range of frames, for messages."""
        first, last = self.start, self.stop - 1
        return f"{label}, " + (f"frames {first} to {last}" if last > first else f"frame {last}")


def divide(frames: range, batch: int, workers: int, most: int = UNIT_FRAMES) -> list[Unit]:
    """Divide the frames of a log into units, in order.

    The last units are smaller, so that all workers finish at about the same time.

    Args:
        frames: Numbers of the frames.
        batch: Number of frames that are computed together; units are multiples of it.
        workers: Number of processes that share the units.
        most: Maximum number of frames in a unit.
    """
    count = len(frames)
    batches = max(1, min(most, count // (4 * workers)) // batch)
    size, end_size = batches * batch, max(1, batches // 4) * batch
    end_frames = workers * size if workers > 1 else 0
    whole = max(0, count - end_frames) // size * size
    ends = [*range(0, whole, size), *range(whole, count, end_size), count]
    return [
        Unit(number, frames[first], frames[last - 1] + 1)
        for number, (first, last) in enumerate(pairwise(ends))
    ]


class UnitQueue:
    """Queue of a log's units, in which each worker takes neighbouring units (work stealing).

    Neighbouring units share chunks of the log, which only one worker should decompress. So each
    worker has a run of units, and a worker without units takes the later half of the longest run.
    Large units are taken first; small units at the end let all workers finish together.

    Args:
        units: Units in order.
        workers: Number of workers.
    """

    def __init__(self, units: Iterable[Unit], workers: int) -> None:
        self._workers = workers
        self._runs: list[list[deque[Unit]]] = []
        self.put_back(units)

    def __len__(self) -> int:
        return sum(len(run) for runs in self._runs for run in runs)

    def clear(self) -> None:
        """Remove all units."""
        self._runs = []

    def take(self, worker: int) -> Unit:
        """Return the next unit for the worker of this number; the queue must not be empty."""
        runs = next(runs for runs in self._runs if any(runs))
        own, longest = runs[worker], max(runs, key=len)
        if not own:
            for _ in range(-(-len(longest) // 2)):
                own.appendleft(longest.pop())
        return own.popleft()

    def put_back(self, tasks: Iterable[Unit]) -> None:
        """Add units that were taken and not done, and divide all units among the workers again."""
        left = sorted([*tasks, *(unit for runs in self._runs for run in runs for unit in run)])
        most = max((unit.stop - unit.start for unit in left), default=0)
        kinds: list[list[Unit]] = [[], []]
        for unit in left:
            kinds[unit.stop - unit.start < most].append(unit)
        self._runs = [_even_runs(kind, self._workers) for kind in kinds]


def _even_runs(units: Sequence[Unit], count: int) -> list[deque[Unit]]:
    ends = [len(units) * i // count for i in range(count + 1)]
    return [deque(units[ends[i] : ends[i + 1]]) for i in range(count)]
