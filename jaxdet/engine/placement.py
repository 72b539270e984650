"""Placement: choice of the processes that work on each log. It does not change the tables.

Starting workers takes as long as processing a few hundred frames. If all workers share a log, most
of them wait while one process opens it, estimates its floor and writes its tables: half a second,
in which sixteen cores could process a thousand frames. So these rules assign processes to logs:

======================================================  ==========================================
Logs                                                    Processes
======================================================  ==========================================
few bytes together, or one log of few frames            this process alone, if no workers run yet
many logs, except the largest                           each log by one worker, one after the other
the largest logs; a single log                          all workers share the frames of a log
the first log of each camera on GPUs, which compute     all workers; then the camera's other logs,
for one camera at a time                                each by one worker
logs that need more than a worker's share of memory     fewer workers, or this process alone
logs of a run after one that was killed                 workers, even a single one: a log may have
                                                        killed it
logs that failed in a worker                            this process, or all workers, once more
======================================================  ==========================================

:func:`logs_for_workers` decides before logs are opened, :meth:`Machine.share_of_all` and
:func:`share_of_worker` for an open log.
"""

import heapq
import logging
from collections.abc import Mapping
from contextlib import suppress
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from jaxdet.cores import cores
from jaxdet.engine.memory import BATCH, BATCHES_IN_FLIGHT, Memory, MemoryPlan
from jaxdet.engine.pool import Pool
from jaxdet.engine.settings import RunSettings
from jaxdet.memory import size_text
from jaxdet.pipeline import check_not_forked
from jaxdet.results.manifest import fingerprint
from jaxdet.results.writer import ROWS_PER_GROUP
from jaxdet.types import Calibration

if TYPE_CHECKING:
    from jaxdet.engine.slots import Served
    from jaxdet.io import Log, LogFiles

LOGGER = logging.getLogger("jaxdet")
FEW_BYTES = 256 << 20
"""Minimum total size of logs for which workers are started [bytes]."""
FEW_FRAMES = 500
"""Minimum number of frames of a single log for which workers are started."""
OPENING_BYTES = 128 << 20
"""Fixed time per log, expressed as the number of bytes that a worker processes in that time."""
_ROW_BYTES, _COLUMN_BYTES = 4096, 9
"""Memory of a frame's rows while they are packed, and additional memory per pixel column for the
free floor, parts of which are in memory twice [bytes]."""


class Share(NamedTuple):
    """Number of processes and batch sizes for an open log."""

    workers: int
    """Number of processes that share the frames."""
    batch: int
    """Number of frames computed together."""
    read: int
    """Number of frames read together by a process."""
    here: bool
    """Whether this process works on the frames; otherwise workers do."""


class OtherCameraError(Exception):
    """The GPUs currently compute for a camera other than that of a log."""

    def __init__(self, calibration: Calibration) -> None:
        super().__init__(calibration)
        self.calibration = calibration


class Machine:
    """Memory and processes of a run.

    Args:
        settings: Settings of the run.
        pool: Worker processes of this and other runs.
        apart: Whether the previous run was killed, so that this process leaves all logs to workers.

    Attributes:
        memory: Memory and the number of processes that fit into it.
        batch: Largest number of frames computed together so far.
        workers: Largest number of processes that shared the logs so far.

    Raises:
        ConfigError: This process can't use JAX, or there is too little memory.
    """

    def __init__(self, settings: RunSettings, pool: Pool, *, apart: bool = False) -> None:
        if settings.options.backend == "jax":
            check_not_forked()
        options, devices = settings.options, pool.devices
        workers = options.workers or max(1, cores() - bool(devices))
        largest = settings.log_options.max_chunk_mib << 20
        self.settings, self.pool = settings, pool
        self.memory = Memory(options.memory, workers, len(devices), apart=apart, largest=largest)
        pool.resize(self.memory.workers)
        if settings.need_main:
            pool.import_main()
        self.batch, self.workers = options.batch_size or 0, 1
        if options.workers and self.memory.workers < options.workers:
            room = f"{size_text(self.memory.total)} of memory have no room for more"
            LOGGER.warning("%d of %d workers: %s", self.memory.workers, options.workers, room)

    @property
    def waits_for_workers(self) -> bool:
        """Whether no workers run yet, and neither ``--workers`` nor a GPU requires them."""
        pool = self.pool
        return not (self.settings.options.workers or pool.devices or pool.started)

    def share_of_all(self, log: "Log", memory: Memory) -> Share:
        """Return the placement of a log that this process has opened.

        Args:
            log: Open log.
            memory: Memory of the run, divided among fewer processes if the log has large chunks.

        Raises:
            InputError: There is no room for one frame.
        """
        apart = bool(self.pool.devices) or memory.apart
        few = len(log.frames) < FEW_FRAMES and not apart and self.waits_for_workers
        plan = memory_plan(self.settings, log, memory, 1 if few else memory.workers)
        self.batch = max(self.batch, plan.batch)
        here = plan.workers == 1 and not apart
        self.pool.resize(plan.workers)  # frees the memory of workers, which this process may need
        return Share(*plan, plan.batch, here)


def share_of_worker(
    settings: RunSettings, log: "Log", memory: Memory, served: "Served | None"
) -> Share:
    """Return the placement of a log that one worker processes while other workers have other logs.

    Raises:
        MemoryError: The log needs more memory than this worker's share.
        OtherCameraError: GPUs compute for another camera.
    """
    if served and log.calibration != served.calibration:
        raise OtherCameraError(log.calibration)
    workers = memory.workers
    plan = memory_plan(settings, log, memory, workers, packing=workers)
    read = served.frames if served else plan.batch
    if plan.workers < workers or plan.batch < read:
        raise MemoryError("not enough for as many logs at a time")
    return Share(1, served.batch if served else plan.batch, read, here=True)


def logs_for_workers(logs: Mapping[str, "LogFiles"], machine: Machine) -> list[str]:
    """Return the names of logs that are each processed by a single worker, the largest first."""
    if len(logs) == 1 or machine.memory.workers == 1:
        return []
    sizes = {name: sum(map(_size, log.paths)) for name, log in logs.items()}
    if sum(sizes.values()) < FEW_BYTES and machine.waits_for_workers:
        return []
    chosen = smallest_logs(sizes, machine.memory.workers)
    return sorted(chosen, key=lambda name: -sizes[name])


def _size(path: Path) -> int:
    """Return the size of a file, or of a folder's files [bytes]; 0 if it can't be read."""
    with suppress(OSError):
        return fingerprint(path).get("size", 0) if path.is_dir() else path.stat().st_size
    return 0


def smallest_logs(sizes: Mapping[str, int], workers: int) -> set[str]:
    """Return the smallest logs, each to be processed by one worker before all share the others.

    Their number minimizes the estimated time until all logs are done.

    Args:
        sizes: Size of each log, by its name [bytes].
        workers: Number of processes.
    """
    costs = sorted((size + OPENING_BYTES, name) for name, size in sizes.items())
    ends = [0] * workers  # cost of the logs of each worker
    shared = sum((cost - OPENING_BYTES) / workers + OPENING_BYTES for cost, _ in costs)
    best, count = shared, 0
    for number, (cost, _) in enumerate(costs, 1):
        heapq.heapreplace(ends, ends[0] + cost)
        shared -= (cost - OPENING_BYTES) / workers + OPENING_BYTES
        if (end := max(ends) + shared) <= best:
            best, count = end, number
    return {name for _, name in costs[:count]}


def memory_plan(
    settings: RunSettings, log: "Log", memory: Memory, workers: int, packing: int = 1
) -> MemoryPlan:
    """Return the numbers of processes and of frames per batch that fit into the memory.

    Args:
        settings: Settings of the run.
        log: Open log.
        memory: Memory of the run.
        workers: Maximum number of processes.
        packing: Number of processes that pack rows at the same time.

    Raises:
        InputError: There is no room for one frame.
    """
    batch = min(settings.options.batch_size or BATCH, max(BATCH, len(log.frames)))
    row = _ROW_BYTES + _COLUMN_BYTES * log.depth_shape[1]
    frame = 2 * prod(log.depth_shape) + _color_bytes(settings, log, batch)
    rows = packing * min(ROWS_PER_GROUP, len(log.frames)) * row
    return memory.allot(frame, log.index_bytes, rows, batch, workers, log.name)


def _color_bytes(settings: RunSettings, log: "Log", batch: int) -> int:
    """Return the average memory of colour images per frame that is in memory [bytes].

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
