"""Units that are still to be done, and which of them a worker takes next."""

from collections import deque
from collections.abc import Iterable, Sequence

from jaxdet.engine.plan import Unit


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

    def __bool__(self) -> bool:
        """Whether any is left."""
        return any(run for runs in self._runs for run in runs)

    def take(self, worker: int) -> Unit | None:
        """The next unit of a worker, by its number; None: there is none left."""
        for runs in self._runs:
            if longest := max(runs, key=len):
                own = runs[worker]
                if not own:
                    for _ in range(-(-len(longest) // 2)):
                        own.appendleft(longest.pop())
                return own.popleft()
        return None

    def put_back(self, units: Iterable[Unit]) -> None:
        """Shares out again what is left, with units that were taken and not done."""
        left = sorted([*units, *(unit for runs in self._runs for run in runs for unit in run)])
        most = max((unit.stop - unit.start for unit in left), default=0)
        kinds: list[list[Unit]] = [[], []]
        for unit in left:
            kinds[unit.stop - unit.start < most].append(unit)
        self._runs = [_even_runs(kind, self._workers) for kind in kinds]


def _even_runs(units: Sequence[Unit], count: int) -> list[deque[Unit]]:
    ends = [len(units) * i // count for i in range(count + 1)]
    return [deque(units[ends[i] : ends[i + 1]]) for i in range(count)]
