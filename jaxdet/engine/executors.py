"""Executors, which process the frames of a log in this process or in the workers of a pool."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, NamedTuple, Protocol

from jaxdet.config import Config
from jaxdet.engine.device import Device, OwnDevice
from jaxdet.engine.floors import Planes, decide_planes
from jaxdet.engine.gpu import served_for
from jaxdet.engine.memory import Memory
from jaxdet.engine.placement import Machine, Share
from jaxdet.engine.plan import LogPlan, Unit, UnitQueue
from jaxdet.engine.pool import Pool
from jaxdet.engine.settings import Report, RunSettings
from jaxdet.engine.slots import Served
from jaxdet.engine.startup import start_up
from jaxdet.engine.unit import lost_unit, process_units
from jaxdet.engine.unit_result import UnitResult, UnitResults
from jaxdet.engine.worker import Failure, Lost, WorkerProcess
from jaxdet.pipeline import BackendName

if TYPE_CHECKING:
    from jaxdet.io import Log


class Executor(Protocol):
    """Executor of the frames of one camera of an open log."""

    share: Share
    """Number of processes and batch sizes for the frames."""

    def find_planes(self) -> Planes:
        """Start workers that don't run yet, and return the priors of the log's floors."""
        ...

    def work(self, plan: LogPlan, units: Sequence[Unit]) -> UnitResults:
        """Yield the units with their results, in any order."""
        ...


@dataclass(frozen=True)
class Host:
    """The process that works on a log, from its files to its results."""

    memory: Memory
    """Memory of the run; if a log has large chunks, fewer processes share its frames."""
    executor: Callable[["Log", Memory], Executor]
    """Returns the executor of an open log."""
    report: Report = lambda *_: None
    """Called with the progress of the log."""
    log_per_worker: bool = False
    """Whether each process of the run works on a log of its own. If so, errors are raised, not
    recorded, also if the log exceeds this process's share of the memory."""


def first_process(machine: Machine, report: Report = lambda *_: None) -> Host:
    """Return the first process of a run: it processes a log itself, or divides it among workers."""

    def executor(log: "Log", memory: Memory) -> Executor:
        settings, share = machine.settings, machine.share_of_all(log, memory)
        if not share.here:
            return InPool(settings, log, share, machine.pool)
        if settings.options.backend == "jax":
            start_up()
        device = OwnDevice(settings.config, settings.options.backend, ahead=1)
        return InProcess(settings, log, share, device)

    return Host(machine.memory, executor, report)


@dataclass
class InProcess:
    """Executor that processes the frames in the current process."""

    settings: RunSettings
    log: "Log"
    """Open log."""
    share: Share
    device: Device
    """Device that computes."""
    alive: Callable[[], object] = lambda: None
    """Called after each batch, to report progress."""

    def find_planes(self) -> Planes:
        """Find the floors in this process."""
        config, backend = self.settings.config, self.settings.options.backend
        return decide_planes(self.log, config, backend, None, self.share.read, self.alive)

    def work(self, plan: LogPlan, units: Sequence[Unit]) -> UnitResults:
        """Work through the units in order."""
        return process_units(self.log, plan, self.device, units, self.alive)


class InPool:
    """Executor that divides the frames of an open log among the workers of a pool."""

    def __init__(self, settings: RunSettings, log: "Log", share: Share, pool: Pool) -> None:
        self.settings, self.log, self.share, self.pool = settings, log, share, pool
        if served := self._serve():
            self.share = share._replace(batch=served.batch, read=served.frames)

    def find_planes(self) -> Planes:
        """Find the floors in a worker, as frames of a damaged log may kill the process.

        Raises:
            WorkerError: A worker was lost twice.
        """
        job = FloorJob(self.log, self.settings.config, self.settings.options.backend)
        where = "before the first frame"
        found = self.pool.call(job, self.share.read, where, tries=2)
        if isinstance(found, Lost):
            raise found.as_raised(where)
        return found

    def work(self, plan: LogPlan, units: Sequence[Unit]) -> UnitResults:
        """Let the workers process the units.

        If the worker of a unit is lost, the unit is tried once more, while no other unit is
        processed and, if workers compute, in smaller batches. If a worker is lost again, the status
        of the unit's frames reports it.
        """
        todo, failure = UnitQueue(units, self.pool.count), None
        while todo and not failure:
            with closing(self.pool.each(self._job(plan), todo)) as answers:
                for unit, answer in answers:
                    if failure:
                        continue  # lets workers complete their tasks, so that they can be reused
                    if isinstance(answer, Lost):
                        answer = self._retry(plan, unit, answer)
                    if isinstance(answer, Failure):
                        failure = answer.as_raised(unit.where(self.log.label))
                        todo.clear()
                    else:
                        yield unit, answer
        if failure:
            raise failure

    def _retry(self, plan: LogPlan, unit: Unit, lost: Lost) -> UnitResult:
        """Return the result of a unit whose worker was lost."""
        batch = plan.batch_size if self.pool.devices else max(1, plan.batch_size // 2)
        job = self._job(plan._replace(batch_size=batch))
        found = self.pool.call(job, unit, unit.where(self.log.label))
        if not isinstance(found, Lost):
            return found
        reason = f"{found.reason}, twice" if found.reason == lost.reason else found.reason
        return lost_unit(self.log, plan, unit, found.status, reason)

    def _job(self, plan: LogPlan) -> "UnitJob":
        """Return the job that processes units, with the memory that the GPUs share now."""
        return UnitJob(self.log, plan, self._serve())

    def _serve(self) -> Served | None:
        """Let the GPUs compute for workers; return the frames' format, or None without GPUs."""
        if not self.pool.devices:
            return None
        given = self.settings.config, self.settings.options.batch_size, self.share.read
        return self.pool.serve(served_for(self.log, *given, self.pool.count))


class FloorJob(NamedTuple):
    """Job that estimates the floors of a log in a worker; a task consists of the batch size."""

    log: "Log"
    config: Config
    backend: BackendName

    @contextmanager
    def open(self, process: WorkerProcess) -> Iterator[Callable[[int], Planes]]:
        """Return the function that finds the floors."""
        given = self.log, self.config, self.backend, None
        with closing(self.log):
            yield partial(decide_planes, *given, alive=process.report_progress)


class UnitJob(NamedTuple):
    """Job that processes units of a log in workers; each task is a unit."""

    log: "Log"
    """Open log; it is sent with its index but without the content of its files."""
    plan: LogPlan
    served: Served | None
    """Format of the frames that GPUs compute; None if workers compute."""

    @contextmanager
    def open(self, process: WorkerProcess) -> Iterator[Callable[[Unit], UnitResult]]:
        """Return the function that processes a unit."""
        device = process.device(self.served, self.plan.settings)

        def process_unit(unit: Unit) -> UnitResult:
            given = self.log, self.plan, device, [unit], process.report_progress
            ((_, result),) = process_units(*given)
            return result

        with closing(self.log):
            yield process_unit
