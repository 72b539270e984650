"""Who works on a log: one process, or the workers of a pool together."""

from collections.abc import Callable, Generator
from functools import partial
from math import prod
from typing import TYPE_CHECKING, NamedTuple, Protocol

from jaxdet.config import Config
from jaxdet.engine.device import Device, OwnDevice
from jaxdet.engine.floors import Planes, decide_planes
from jaxdet.engine.memory import BATCH, BATCHES_IN_FLIGHT, READ_AHEAD, Memory, MemoryPlan, Needs
from jaxdet.engine.options import RunOptions
from jaxdet.engine.part import Part
from jaxdet.engine.plan import LogPlan, Observer, Unit
from jaxdet.engine.pool import Pool
from jaxdet.engine.startup import start_up
from jaxdet.engine.unit import LogWork
from jaxdet.engine.worker import UnitContext, decide_floors
from jaxdet.results.writer import ROWS_PER_GROUP

if TYPE_CHECKING:
    from collections.abc import Mapping

    from jaxdet.io import Log, LogOptions

_ROW_BYTES, _COLUMN_BYTES = 4096, 9
"""Of a frame's rows, with the free floor of each pixel column, while they are packed: some are in
memory twice."""


class Job(NamedTuple):
    """What the logs of a run have in common."""

    config: Config
    log_options: "LogOptions"
    options: RunOptions
    observers: "Mapping[str, Observer]"
    about: dict[str, object]
    """Versions and the digest of the configuration, for manifests."""
    described: dict[str, object]
    """Content of ``config.json`` but for the batch size."""


class Crew(Protocol):
    """Works on one camera's log."""

    memory: MemoryPlan
    """Processes, frames computed together and batches that are read ahead."""
    workers: int
    """Processes that share the frames."""
    devices: int
    """GPUs that compute for them."""
    others: int
    """Processes that do other logs in the same memory."""

    def start(self, log: "Log") -> int:
        """Start what computes, if it isn't there; return the frames that are read together."""
        ...

    def find_planes(self, log: "Log", at_once: int) -> Planes:
        """Return the priors of the floors, before the frames are worked on."""
        ...

    def work(self, log: "Log", plan: LogPlan) -> Generator[tuple[Unit, Part], None, None]:
        """Yield all units of the plan with their parts, in any order."""
        ...


Choose = Callable[["Log", Memory], Crew]
"""Chooses who works on an open log."""


def memory_plan(job: Job, log: "Log", memory: Memory, workers: int, packing: int = 1) -> MemoryPlan:
    """Return how a log is worked on within the memory.

    Args:
        job: The run.
        log: Open log.
        memory: The memory of the run.
        workers: Processes that share it.
        packing: Processes that pack rows at a time.

    Raises:
        InputError: There is no room for one frame.
    """
    batch = min(job.options.batch_size or BATCH, max(BATCH, len(log.frames)))
    row = _ROW_BYTES + _COLUMN_BYTES * log.depth_shape[1]
    frame = 2 * prod(log.depth_shape) + _color_bytes(job, log, batch)
    rows = packing * min(ROWS_PER_GROUP, len(log.frames)) * row
    return memory.allot(Needs(frame, log.index_bytes, rows), batch, workers, log.name)


def _color_bytes(job: Job, log: "Log", batch: int) -> int:
    """Return how much memory colour images take, per frame that is in memory [bytes].

    All frames of the preset ``paper`` have one, else all of a batch in which one is drawn.
    """
    if job.config.cluster.points:
        camera = log.calibration.image
        return 3 * camera.height * camera.width
    if not log.has_color or log.color_shape is None:
        return 0
    batches = BATCHES_IN_FLIGHT + READ_AHEAD
    drawn = -(-job.options.pictures * batches * batch // max(1, len(log.frames)))
    return -(-prod(log.color_shape) * min(drawn, batches) // batches)


class OneProcess:
    """The process that it is in does the log itself.

    Args:
        job: The run.
        memory: What it may take.
        device: What computes.
        alive: Called after each batch; None: in the first process.
    """

    def __init__(
        self,
        job: Job,
        memory: MemoryPlan,
        device: Device,
        alive: Callable[[], object] | None = None,
    ) -> None:
        self.job, self.memory, self.device = job, memory, device
        self.workers, self.devices, self.others = 1, 0, 0
        self.together = memory.batch
        """Frames that are read together."""
        self._alive = alive

    def start(self, log: "Log") -> int:
        """Load what computes."""
        if self.job.options.backend == "jax" and self._alive is None:
            start_up()
        return min(self.together, max(1, len(log.frames)))

    def find_planes(self, log: "Log", at_once: int) -> Planes:
        """Find the floors in this process."""
        given = log, self.job.config, self.job.options.backend, None, at_once
        alive = self._alive or (lambda: None)
        return decide_planes(*given, alive=alive, find=self.device.find_floors)

    def work(self, log: "Log", plan: LogPlan) -> Generator[tuple[Unit, Part], None, None]:
        """Work through all units in order."""
        work = LogWork(log, plan, self.device)
        work.batch_done = self._alive or work.batch_done
        return work.work_through(plan.units(), self.memory.read_ahead)


class PoolCrew:
    """The workers of a pool share the frames of a log.

    Args:
        job: The run.
        pool: The workers.
        memory: What they may take.
    """

    def __init__(self, job: Job, pool: Pool, memory: MemoryPlan) -> None:
        self.job, self.pool, self.memory = job, pool, memory
        self.workers, self.devices, self.others = memory.workers, len(pool.devices), 0
        pool.resize(self.workers)

    def start(self, log: "Log") -> int:
        """Start the workers."""
        self.pool.start()
        if self.pool.devices:
            slots, batch = self._serve(log)
            self.memory = self.memory._replace(batch=batch)
            return slots.frames
        return min(self.memory.batch, max(1, len(log.frames)))

    def find_planes(self, log: "Log", at_once: int) -> Planes:
        """Find the floors where they are computed: this process may have no need of JAX."""
        given = log, self.job.config, self.job.options.backend, None, at_once
        if self.pool.devices:
            device = OwnDevice(self.job.config, self.job.options.backend, ahead=1)
            return decide_planes(*given, find=device.find_floors)
        return self.pool.call(decide_floors, *given)

    def work(self, log: "Log", plan: LogPlan) -> Generator[tuple[Unit, Part], None, None]:
        """Share out all units."""
        return self.pool.work_through(plan, partial(self._context, log, plan))

    def _context(self, log: "Log", plan: LogPlan) -> UnitContext:
        return UnitContext(log, plan, self._serve(log)[0] if self.pool.devices else None)

    def _serve(self, log: "Log"):  # noqa: ANN202 (as Pool.serve)
        return self.pool.serve(log, self.job.config, self.job.options.batch_size, self.memory.batch)
