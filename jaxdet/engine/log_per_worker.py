"""Processing of whole logs by single workers.

If all workers share a log, most workers wait while it is opened, its floor is estimated and its
tables are written. This takes half a second, in which sixteen cores could process a thousand
frames. If there are many logs, each worker therefore processes whole logs, one after the other. The
largest logs are still shared, as a single worker would need longer for one than all other workers
for the rest. If a worker can't process a log, the first process tries it with all workers, and
reports the error if that fails too.
"""

import heapq
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from jaxdet.engine.executors import InProcess, memory_plan
from jaxdet.engine.memory import Memory
from jaxdet.engine.process_log import no_report, process_log
from jaxdet.engine.settings import RunSettings
from jaxdet.engine.worker import WorkerProcess
from jaxdet.results.summary import LogSummary
from jaxdet.types import Calibration

if TYPE_CHECKING:
    from jaxdet.engine.shared_slots import ServerConfig
    from jaxdet.io import Log, LogFiles

OPENING_BYTES = 128 << 20
"""Fixed time per log, expressed as the number of bytes that a worker processes in that time."""
FEW_BYTES = 256 << 20
"""Minimum total size of logs at which workers are started [bytes]; one process finishes smaller
logs before workers have started."""


class LogTask(NamedTuple):
    """A log for a worker."""

    files: "LogFiles"
    folder: Path
    """New folder for its results."""


class OtherCameraError(Exception):
    """The device server doesn't serve the camera of a log; it is the answer to the log's task."""

    def __init__(self, calibration: Calibration) -> None:
        super().__init__(calibration)
        self.calibration = calibration


class LogJob(NamedTuple):
    """Job that processes logs; each worker processes one log at a time."""

    settings: RunSettings
    memory: Memory
    """Memory of the run, of which each worker takes its share."""
    devices: int
    """Number of GPUs."""
    served: "ServerConfig | None"
    """Configuration of the device server; None if workers compute."""

    @contextmanager
    def open(self, process: WorkerProcess) -> Iterator[Callable[[LogTask], Any]]:
        """Return :meth:`process_log` for tasks."""
        yield partial(self.process_log, process)

    def process_log(
        self, process: WorkerProcess, task: LogTask
    ) -> list[LogSummary] | OtherCameraError | None:
        """Write the results of a log, see :func:`jaxdet.engine.process_log.process_log`.

        Returns:
            The summaries of its cameras; an error if the device server doesn't serve its camera;
            None if the first process has to process the log.
        """
        try:
            given = self.memory, partial(self.choose, process), no_report
            return process_log(self.settings, *task, *given, log_per_worker=True)
        except OtherCameraError as error:
            return error
        except Exception:  # the first process tries the log again, and reports the error
            return None

    def choose(self, process: WorkerProcess, log: "Log", memory: Memory) -> InProcess:
        """Return the executor of a worker, with its share of the memory.

        Raises:
            MemoryError: The log needs more memory than this share.
        """
        served, workers = self.served, memory.workers
        if served and log.calibration != served.calibration:
            raise OtherCameraError(log.calibration)
        plan = memory_plan(self.settings, log, memory, workers, packing=workers)
        together = served.slots.frames if served else plan.batch
        if plan.workers < workers or plan.batch < together:
            raise MemoryError("not enough for as many logs at a time")
        plan = plan._replace(batch=served.batch if served else plan.batch)
        device = process.device(served, self.settings.config, self.settings.options.backend)
        given = self.settings, plan, device, process.report_progress
        return InProcess(*given, together=together, devices=self.devices)


def choose_logs(sizes: Mapping[str, int], workers: int) -> set[str]:
    """Return the logs to process one per worker, so that all logs are done soonest.

    These are the smallest ones; the others are shared by all workers afterwards.

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
