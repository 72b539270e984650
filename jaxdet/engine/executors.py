"""Executors of a log: one process, or the workers of a pool together."""

from collections.abc import Callable, Generator, Iterator
from contextlib import closing, contextmanager
from functools import partial
from math import prod
from typing import TYPE_CHECKING, NamedTuple, Protocol

from jaxdet.config import Config
from jaxdet.engine.device import Device
from jaxdet.engine.floors import Planes, decide_planes
from jaxdet.engine.memory import BATCH, BATCHES_IN_FLIGHT, Memory, MemoryPlan, Needs
from jaxdet.engine.plan import LogPlan, Unit
from jaxdet.engine.pool import Pool
from jaxdet.engine.settings import RunSettings
from jaxdet.engine.shared_slots import ServerConfig
from jaxdet.engine.tasks import UnitQueue
from jaxdet.engine.unit import UnitProcessor
from jaxdet.engine.unit_result import UnitResult
from jaxdet.engine.worker import Failure, Lost, WorkerProcess
from jaxdet.pipeline import BackendName
from jaxdet.results.writer import ROWS_PER_GROUP

if TYPE_CHECKING:
    from jaxdet.io import Log

_ROW_BYTES, _COLUMN_BYTES = 4096, 9
"""Memory of a frame's rows while they are packed, and additional memory per pixel column for the
free floor, parts of which are in memory twice [bytes]."""


class Executor(Protocol):
    """Processes the frames of one camera of a log."""

    memory: MemoryPlan
    """Numbers of processes and of frames computed together."""
    workers: int
    """Number of processes that share the frames."""
    devices: int
    """Number of GPUs that compute for the processes."""
    together: int
    """Number of frames that are read together."""

    def find_planes(self, log: "Log") -> Planes:
        """Start processes that don't run yet, and return the priors of the floors."""
        ...

    def work(self, log: "Log", plan: LogPlan) -> Generator[tuple[Unit, UnitResult], None, None]:
        """Yield all units of the plan with their results, in any order."""
        ...


ChooseExecutor = Callable[["Log", Memory], Executor]
"""Function that returns the executor of an open log."""


def memory_plan(
    settings: RunSettings, log: "Log", memory: Memory, workers: int, packing: int = 1
) -> MemoryPlan:
    """Return how many processes and frames at a time fit into the memory.

    Args:
        settings: The run.
        log: Open log.
        memory: The memory of the run.
        workers: Largest number of processes.
        packing: Number of processes that pack rows at the same time.

    Raises:
        InputError: There is no room for one frame.
    """
    batch = min(settings.options.batch_size or BATCH, max(BATCH, len(log.frames)))
    row = _ROW_BYTES + _COLUMN_BYTES * log.depth_shape[1]
    frame = 2 * prod(log.depth_shape) + _color_bytes(settings, log, batch)
    rows = packing * min(ROWS_PER_GROUP, len(log.frames)) * row
    return memory.allot(Needs(frame, log.index_bytes, rows), batch, workers, log.name)


def _color_bytes(settings: RunSettings, log: "Log", batch: int) -> int:
    """Return the memory of colour images per frame in memory [bytes].

    With the preset ``paper`` all frames have a colour image, otherwise only the frames of batches
    that contain a frame to draw.
    """
    if settings.config.cluster.points:
        camera = log.calibration.image
        return 3 * camera.height * camera.width
    if not log.has_color or log.color_shape is None:
        return 0
    pictures, in_flight = settings.options.pictures, BATCHES_IN_FLIGHT
    drawn = -(-pictures * in_flight * batch // max(1, len(log.frames)))
    return -(-prod(log.color_shape) * min(drawn, in_flight) // in_flight)


class InProcess:
    """Executor that processes a log in the current process.

    Args:
        settings: The run.
        memory: Memory plan for one process.
        device: Device that computes.
        alive: Called after each batch.
        together: See :class:`Executor`; by default as many as are computed together.
        devices: See :class:`Executor`.
    """

    def __init__(
        self,
        settings: RunSettings,
        memory: MemoryPlan,
        device: Device,
        alive: Callable[[], object] = lambda: None,
        *,
        together: int | None = None,
        devices: int = 0,
    ) -> None:
        self.settings, self.memory, self.device = settings, memory, device
        self.workers, self.devices = 1, devices
        self.together = together or memory.batch
        self._alive = alive

    def find_planes(self, log: "Log") -> Planes:
        """Find the floors in this process."""
        config, backend = self.settings.config, self.settings.options.backend
        return decide_planes(log, config, backend, None, self.together, self._alive)

    def work(self, log: "Log", plan: LogPlan) -> Generator[tuple[Unit, UnitResult], None, None]:
        """Work through all units in order."""
        work = UnitProcessor(log, plan, self.device, self._alive)
        return work.process_units(plan.units())


class InPool:
    """Executor that divides the frames of a log among the workers of a pool.

    Args:
        settings: The run.
        pool: The workers.
        memory: Memory plan, which sets the number of workers.
    """

    def __init__(self, settings: RunSettings, pool: Pool, memory: MemoryPlan) -> None:
        self.settings, self.pool, self.memory = settings, pool, memory
        self.workers, self.devices = memory.workers, len(pool.devices)
        self.together = memory.batch
        pool.resize(self.workers)

    def find_planes(self, log: "Log") -> Planes:
        """Find the floors in a worker, as frames of a damaged log may kill the process.

        Raises:
            WorkerError: A worker was lost twice.
        """
        if self.pool.devices:
            served = self._serve(log)
            self.memory = self.memory._replace(batch=served.batch)
            self.together = served.slots.frames
        job = FloorJob(log, self.settings.config, self.settings.options.backend)
        where = "before the first frame"
        found = self.pool.call(job, self.together, where, tries=2)
        if isinstance(found, Lost):
            raise found.as_raised(where)
        return found

    def work(self, log: "Log", plan: LogPlan) -> Generator[tuple[Unit, UnitResult], None, None]:
        """Let the workers process all units of the plan.

        If the worker of a unit is lost, the unit is tried once more, while no other unit is
        processed and, if workers compute, in smaller batches. If a worker is lost again, the status
        of the unit's frames says so.
        """
        todo, failure = UnitQueue(plan.units(), self.pool.count), None
        while todo and not failure:
            with closing(self.pool.each(self._job(log, plan), todo)) as answers:
                for unit, answer in answers:
                    if failure:
                        continue  # workers that complete their tasks can be used again
                    if isinstance(answer, Lost):
                        answer = self._retry(log, plan, unit, answer)
                    if isinstance(answer, Failure):
                        failure = answer.as_raised(plan.where(unit))
                        todo.clear()
                    else:
                        yield unit, answer
        if failure:
            raise failure

    def _retry(self, log: "Log", plan: LogPlan, unit: Unit, lost: Lost) -> UnitResult:
        """Return the result of a unit whose worker was lost."""
        where = plan.where(unit)
        batch = plan.batch_size if self.pool.devices else max(1, plan.batch_size // 2)
        smaller = plan._replace(batch_size=batch)
        found = self.pool.call(self._job(log, smaller), unit, where)
        if not isinstance(found, Lost):
            return found
        reason = f"{found.reason}, twice" if found.reason == lost.reason else found.reason
        job = self._job(log, plan)._replace(lost=found._replace(reason=reason))
        found = self.pool.call(job, unit, where)
        if isinstance(found, Lost):
            raise found.as_raised(where)
        return found

    def _job(self, log: "Log", plan: LogPlan) -> "UnitJob":
        """Return the job that processes units, with the current device server."""
        return UnitJob(log, plan, self._serve(log) if self.pool.devices else None)

    def _serve(self, log: "Log") -> ServerConfig:
        options = self.settings.options
        return self.pool.serve(log, self.settings.config, options.batch_size, self.memory.batch)


class FloorJob(NamedTuple):
    """Job that estimates a log's floors in a worker; its task is the batch size."""

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
    served: ServerConfig | None
    """Configuration of the device server; None if workers compute."""
    lost: Lost | None = None
    """Status for all frames if they are not to be processed; None to process them."""

    @contextmanager
    def open(self, process: WorkerProcess) -> Iterator[Callable[[Unit], UnitResult]]:
        """Return the function that processes a unit."""
        settings = self.plan.settings
        device = process.device(self.served, settings.config, settings.options.backend)
        work = UnitProcessor(self.log, self.plan, device, process.report_progress)
        with closing(self.log):
            yield partial(work.mark_lost, lost=self.lost) if self.lost else work.process_unit
