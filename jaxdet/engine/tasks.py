"""Queues of tasks for workers."""

from collections import deque
from collections.abc import Iterable, Sequence
from typing import Any

from jaxdet.engine.plan import Unit


class TaskQueue:
    """Tasks that free workers take in order.

    Args:
        tasks: The tasks.
    """

    def __init__(self, tasks: Iterable[Any]) -> None:
        self._left = deque(tasks)

    def __len__(self) -> int:
        return len(self._left)

    def take(self, worker: int) -> Any:
        """Return the next task for the worker of this number; the queue may not be empty."""
        return self._left.popleft()

    def put_back(self, tasks: Iterable[Any]) -> None:
        """Put tasks that were taken but not done back at the front."""
        self._left.extendleft(tasks)


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
        """Return the next unit for the worker of this number; the queue may not be empty."""
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
