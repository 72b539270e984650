"""Who works on a log: one process, or the workers of a pool together."""

from collections.abc import Callable, Generator
from functools import partial
from math import prod
from typing import TYPE_CHECKING, Protocol

from jaxdet.engine.device import Device, OwnDevice
from jaxdet.engine.floors import Planes, decide_planes
from jaxdet.engine.memory import BATCH, BATCHES_IN_FLIGHT, READ_AHEAD, Memory, MemoryPlan, Needs
from jaxdet.engine.plan import LogPlan, Unit
from jaxdet.engine.pool import Pool
from jaxdet.engine.settings import RunSettings
from jaxdet.engine.startup import start_up
from jaxdet.engine.unit import UnitProcessor
from jaxdet.engine.unit_result import UnitResult
from jaxdet.engine.worker import UnitContext, decide_floors
from jaxdet.results.writer import ROWS_PER_GROUP

if TYPE_CHECKING:
    from jaxdet.io import Log

_ROW_BYTES, _COLUMN_BYTES = 4096, 9
"""Of a frame's rows, with the free floor of each pixel column, while they are packed: some are in
memory twice."""


class Executor(Protocol):
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

    def work(self, log: "Log", plan: LogPlan) -> Generator[tuple[Unit, UnitResult], None, None]:
        """Yield all units of the plan with their parts, in any order."""
        ...


ChooseExecutor = Callable[["Log", Memory], Executor]
"""Chooses who works on an open log."""


def memory_plan(
    settings: RunSettings, log: "Log", memory: Memory, workers: int, packing: int = 1
) -> MemoryPlan:
    """Return how a log is worked on within the memory.

    Args:
        settings: The run.
        log: Open log.
        memory: The memory of the run.
        workers: Processes that share it.
        packing: Processes that pack rows at a time.

    Raises:
        InputError: There is no room for one frame.
    """
    batch = min(settings.options.batch_size or BATCH, max(BATCH, len(log.frames)))
    row = _ROW_BYTES + _COLUMN_BYTES * log.depth_shape[1]
    frame = 2 * prod(log.depth_shape) + _color_bytes(settings, log, batch)
    rows = packing * min(ROWS_PER_GROUP, len(log.frames)) * row
    return memory.allot(Needs(frame, log.index_bytes, rows), batch, workers, log.name)


def _color_bytes(settings: RunSettings, log: "Log", batch: int) -> int:
    """Return how much memory colour images take, per frame that is in memory [bytes].

    All frames of the preset ``paper`` have one, else all of a batch in which one is drawn.
    """
    if settings.config.cluster.points:
        camera = log.calibration.image
        return 3 * camera.height * camera.width
    if not log.has_color or log.color_shape is None:
        return 0
    batches = BATCHES_IN_FLIGHT + READ_AHEAD
    drawn = -(-settings.options.pictures * batches * batch // max(1, len(log.frames)))
    return -(-prod(log.color_shape) * min(drawn, batches) // batches)


class InProcess:
    """The process that it is in does the log itself.

    Args:
        settings: The run.
        memory: What it may take.
        device: What computes.
        alive: Called after each batch; None: in the first process.
        together: Frames that are read together; by default those that are computed together.
        devices: GPUs that compute for it.
        others: Processes that do other logs in the same memory.
    """

    def __init__(
        self,
        settings: RunSettings,
        memory: MemoryPlan,
        device: Device,
        alive: Callable[[], object] | None = None,
        *,
        together: int | None = None,
        devices: int = 0,
        others: int = 0,
    ) -> None:
        self.settings, self.memory, self.device = settings, memory, device
        self.workers, self.devices, self.others = 1, devices, others
        self._together = together or memory.batch
        self._alive = alive

    def start(self, log: "Log") -> int:
        """Load what computes."""
        if self.settings.options.backend == "jax" and self._alive is None:
            start_up()
        return min(self._together, max(1, len(log.frames)))

    def find_planes(self, log: "Log", at_once: int) -> Planes:
        """Find the floors in this process."""
        given = log, self.settings.config, self.settings.options.backend, None, at_once
        alive = self._alive or (lambda: None)
        return decide_planes(*given, alive=alive, find=self.device.find_floors)

    def work(self, log: "Log", plan: LogPlan) -> Generator[tuple[Unit, UnitResult], None, None]:
        """Work through all units in order."""
        work = UnitProcessor(log, plan, self.device)
        work.batch_done = self._alive or work.batch_done
        return work.process_units(plan.units(), self.memory.read_ahead)


class InPool:
    """The workers of a pool share the frames of a log.

    Args:
        settings: The run.
        pool: The workers.
        memory: What they may take.
    """

    def __init__(self, settings: RunSettings, pool: Pool, memory: MemoryPlan) -> None:
        self.settings, self.pool, self.memory = settings, pool, memory
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
        given = log, self.settings.config, self.settings.options.backend, None, at_once
        if self.pool.devices:
            device = OwnDevice(self.settings.config, self.settings.options.backend, ahead=1)
            return decide_planes(*given, find=device.find_floors)
        return self.pool.call(decide_floors, *given)

    def work(self, log: "Log", plan: LogPlan) -> Generator[tuple[Unit, UnitResult], None, None]:
        """Share out all units."""
        return self.pool.process_units(plan, partial(self._context, log, plan))

    def _context(self, log: "Log", plan: LogPlan) -> UnitContext:
        return UnitContext(log, plan, self._serve(log)[0] if self.pool.devices else None)

    def _serve(self, log: "Log"):  # noqa: ANN202 (as Pool.serve)
        return self.pool.serve(
            log, self.settings.config, self.settings.options.batch_size, self.memory.batch
        )
