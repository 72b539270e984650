"""Logs that workers do whole, each one alone, while others do others.

A log that all workers share keeps most of them waiting while it is opened, while its floor is
looked for and while its parts are joined: half a second, in which sixteen cores do a thousand
frames. So where there are many logs each worker takes one after the other, but for the largest,
which would keep one worker at it when all others have ended. What a worker can't do is left for
:class:`jaxdet.engine.pooled_run.PooledLogRun`, which tries again or says what is wrong.
"""

import heapq
import pickle
from collections.abc import Callable, Generator, Mapping
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from jaxdet.engine.device import Device, OwnDevice
from jaxdet.engine.log_run import LogRun, RunContext
from jaxdet.engine.memory import Memory
from jaxdet.engine.pool import Pool
from jaxdet.engine.slots import Slots
from jaxdet.engine.worker import save_work, shared_device, tell_alive
from jaxdet.engine.workspace import WorkFolder
from jaxdet.types import Calibration

if TYPE_CHECKING:
    from jaxdet.io import Log, LogFiles, LogOptions

OPENING_BYTES = 128 << 20
"""What a log takes beside its frames, as bytes of a log that a worker reads and works on in that
time."""
FEW_BYTES = 256 << 20
"""So much is done sooner by one process than workers have started."""
_DONE, _LEFT = "done", "left"


class Task(NamedTuple):
    """A log for a worker."""

    files: "LogFiles"
    file_name: str
    """What the names of its files begin with."""
    number: int
    """Among all logs of the run."""
    folder: Path
    """Where what is done lies."""


class Given(NamedTuple):
    """What all tasks of a round have in common."""

    run: RunContext
    log_options: "LogOptions"
    devices: int
    """GPUs."""
    entered: tuple[Slots, Calibration] | None
    """With GPUs: what workers are served in, and of what camera."""
    batch: int
    """With GPUs: frames computed together."""
    logs: int
    """Of the round."""


class OtherCamera(NamedTuple):
    """Instead of doing a log: the station serves another camera."""

    calibration: Calibration


def do_log(path: Path, task: Task) -> str | OtherCamera:
    """In a worker: makes a log whole, if it can be.

    Args:
        path: Holds :class:`Given`.
        task: The log.
    """
    run = _WholeLogRun(_given(path), task)
    try:
        run.make_whole(task.folder, run.given.log_options)
    except _OtherCameraError as error:
        return OtherCamera(error.calibration)
    except Exception:  # which is met again, and told, by who does what is left
        return _LEFT
    return _DONE


@lru_cache(maxsize=1)
def _given(path: Path) -> Given:
    return pickle.loads(path.read_bytes())


class _OtherCameraError(Exception):
    def __init__(self, calibration: Calibration) -> None:
        super().__init__()
        self.calibration = calibration


class _WholeLogRun(LogRun):
    """A log that a worker does alone, with its share of the memory of all."""

    def __init__(self, given: Given, task: Task) -> None:
        super().__init__(given.run, task.files, task.file_name, _no_report, task.number)
        self.given, self.batch_done = given, tell_alive
        self.others = self.memory.workers - 1

    def _decide_how(self, log: "Log") -> None:
        entered, workers = self.given.entered, self.memory.workers
        if entered and log.calibration != entered[1]:
            raise _OtherCameraError(log.calibration)
        # The rows of all wait in the first process; no one knows how many, so as many as of this.
        self.waiting = (self.given.logs - 1) * len(log.frames)
        self.allotment = self._allot(log, workers)
        together = entered[0].frames if entered else 1
        if self.allotment.workers < workers or self.allotment.batch < together:
            raise MemoryError("not enough for as many at a time")
        self.workers, self.batch = workers, self.given.batch or self.allotment.batch
        self.about.workers, self.about.devices = 1, self.given.devices

    def _use_fewer(self, memory: Memory) -> None:
        raise MemoryError("not enough for chunks of this size")

    def _start(self, log: "Log") -> int:
        entered = self.given.entered
        return entered[0].frames if entered else self._together(log)

    @cached_property
    def device(self) -> Device:
        """What computes for this worker, or itself."""
        entered = self.given.entered
        if entered:
            return shared_device(entered[0])
        return OwnDevice(self.config, self.options.backend, ahead=0)


def _no_report(*_: object) -> None:
    """Where a log stands only its worker knows."""


def choose_whole(sizes: Mapping[str, int], workers: int) -> set[str]:
    """Which logs workers should do whole, so that all are done soonest.

    The smallest ones: as many as it pays to do before the others are shared out one by one.

    Args:
        sizes: Bytes of each log.
        workers: Processes.
    """
    costs = sorted((size + OPENING_BYTES, name) for name, size in sizes.items())
    ends = [0] * workers  # when each worker is done
    shared = sum((cost - OPENING_BYTES) / workers + OPENING_BYTES for cost, _ in costs)
    best, count = shared, 0
    for number, (cost, _) in enumerate(costs, 1):
        heapq.heapreplace(ends, ends[0] + cost)
        shared -= (cost - OPENING_BYTES) / workers + OPENING_BYTES
        if (end := max(ends) + shared) <= best:
            best, count = end, number
    return {name for _, name in costs[:count]}


class WholeLogs:
    """The logs of a run that workers do whole, while this process takes all logs in order.

    Args:
        pool: The workers.
        run: What logs have in common.
        log_options: How to read.
        tasks: By the logs' names.
    """

    def __init__(
        self, pool: Pool, run: RunContext, log_options: "LogOptions", tasks: Mapping[str, Task]
    ) -> None:
        self._pool, self._run, self._options = pool, run, log_options
        self._count = len(tasks)
        self._todo = dict(tasks)
        self._cameras: dict[str, Calibration] = {}
        """Of logs that were opened while another camera was served."""
        self._done: set[str] = set()
        self._round: Generator[tuple[str, Any], None, None] | None = None

    def wait_for(self, name: str, batch: int, tell: Callable[[str], None]) -> bool:
        """Waits until a log is done; False: no worker does it, and none is at another one.

        Args:
            name: The log's.
            batch: With GPUs: frames that are computed together.
            tell: Gets what goes on.
        """
        while name not in self._done:
            if self._round is None and name in self._ready():
                self._round = self._begin(batch)
            if self._round is None:
                self._todo.pop(name, None)
                return False
            tell(f"{len(self._done)} of {self._count} logs are done")
            if answered := next(self._round, None):
                self._take(*answered)
            else:
                self._round = None
        return True

    def _ready(self) -> dict[str, Task]:
        """Logs that workers could do as things are."""
        if not self._pool.devices:
            return self._todo
        if self._pool.entered is None or self._pool.count != self._run.memory.workers:
            return {}  # the next log that is shared out makes all workers be served
        served = self._pool.entered[1]
        known = self._cameras
        return {
            name: task for name, task in self._todo.items() if known.get(name, served) == served
        }

    def _begin(self, batch: int) -> Generator[tuple[str, Any], None, None]:
        pool, run = self._pool, self._run
        pool.resize(run.memory.workers)
        entered, devices = pool.entered, len(pool.devices)
        work = WorkFolder(run.work.folder, run.work.record)
        run = run._replace(work=work, say=_no_report)
        tasks = self._ready()
        batch = batch if devices else 0
        given = Given(run, self._options, devices, entered, batch, len(tasks))
        path = save_work(run.work.folder, given)
        return pool.each(do_log, {name: (path, task) for name, task in tasks.items()})

    def _take(self, name: str, answer: Any) -> None:
        if isinstance(answer, OtherCamera):
            self._cameras[name] = answer.calibration
            return
        del self._todo[name]
        if answer == _DONE:
            self._done.add(name)
