"""What is still to be done by workers, and which of it a worker takes next."""

from collections import deque
from collections.abc import Iterable, Sequence
from typing import Any

from jaxdet.engine.plan import Unit


class TaskQueue:
    """Tasks in order, for whichever worker is free.

    Args:
        tasks: In order.
    """

    def __init__(self, tasks: Iterable[Any]) -> None:
        self._left = deque(tasks)

    def __len__(self) -> int:
        return len(self._left)

    def take(self, worker: int) -> Any:
        """Return the next task of a worker, by its number; there is one."""
        return self._left.popleft()

    def put_back(self, tasks: Iterable[Any]) -> None:
        """Take in tasks that were taken and not done."""
        self._left.extendleft(tasks)


class UnitQueue:
    """Shares out units so that a worker goes on where it is.

    Neighbouring units share chunks of a log, and what frames are is only known with the messages
    around them: of packed chunks, a worker that takes a unit elsewhere decompresses some twice.
    So each has a run of units; one that has none left takes the later half of the longest run
    (work stealing). Large units go first, so that the small ones let all workers end together.

    Args:
        units: In order.
        workers: How many there are.
    """

    def __init__(self, units: Iterable[Unit], workers: int) -> None:
        self._workers = workers
        self._runs: list[list[deque[Unit]]] = []
        self.put_back(units)

    def __len__(self) -> int:
        return sum(len(run) for runs in self._runs for run in runs)

    def clear(self) -> None:
        """Forget what is left."""
        self._runs = []

    def take(self, worker: int) -> Unit:
        """Return the next unit of a worker, by its number; there is one."""
        runs = next(runs for runs in self._runs if any(runs))
        own, longest = runs[worker], max(runs, key=len)
        if not own:
            for _ in range(-(-len(longest) // 2)):
                own.appendleft(longest.pop())
        return own.popleft()

    def put_back(self, tasks: Iterable[Unit]) -> None:
        """Share out again what is left, with units that were taken and not done."""
        left = sorted([*tasks, *(unit for runs in self._runs for run in runs for unit in run)])
        most = max((unit.stop - unit.start for unit in left), default=0)
        kinds: list[list[Unit]] = [[], []]
        for unit in left:
            kinds[unit.stop - unit.start < most].append(unit)
        self._runs = [_even_runs(kind, self._workers) for kind in kinds]


def _even_runs(units: Sequence[Unit], count: int) -> list[deque[Unit]]:
    ends = [len(units) * i // count for i in range(count + 1)]
    return [deque(units[ends[i] : ends[i + 1]]) for i in range(count)]
