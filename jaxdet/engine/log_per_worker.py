"""Logs that are done one per worker.

A log that all workers share keeps most of them waiting while it is opened, while its floor is
looked for and while its tables are written: half a second, in which sixteen cores do a thousand
frames. So where there are many logs each worker takes one after the other, but for the largest,
which would keep one worker at it when all others have ended. A log that a worker can't do is left
for the first process, which tries again with all workers or reports what is wrong.
"""

import heapq
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from jaxdet.engine.device import OwnDevice
from jaxdet.engine.executors import InProcess, memory_plan
from jaxdet.engine.memory import Memory
from jaxdet.engine.process_log import no_report, process_log
from jaxdet.engine.settings import RunSettings
from jaxdet.engine.shared_slots import Slots
from jaxdet.engine.worker import report_alive, shared_device
from jaxdet.results.summary import LogSummary
from jaxdet.types import Calibration

if TYPE_CHECKING:
    from jaxdet.io import Log, LogFiles

OPENING_BYTES = 128 << 20
"""Fixed cost of a log, as bytes that a worker reads and works on in the same time."""
FEW_BYTES = 256 << 20
"""Less is done sooner by one process than workers have started."""


class LogContext(NamedTuple):
    """What the logs have in common that workers do."""

    settings: RunSettings
    memory: Memory
    devices: int
    """GPUs."""
    served: tuple[Slots, Calibration] | None
    """With GPUs: what workers are served in, and of what camera."""
    batch: int
    """With GPUs: frames computed together."""

    def open(self) -> "LogContext":
        """Return itself, in the worker."""
        return self

    def choose(self, log: "Log", memory: Memory) -> InProcess:
        """Return the executor of a worker, with its share of the memory.

        Raises:
            MemoryError: The log needs more.
        """
        if self.served and log.calibration != self.served[1]:
            raise _OtherCameraError(log.calibration)
        workers = memory.workers
        plan = memory_plan(self.settings, log, memory, workers, packing=workers)
        together = self.served[0].frames if self.served else 1
        if plan.workers < workers or plan.batch < together:
            raise MemoryError("not enough for as many at a time")
        config, backend = self.settings.config, self.settings.options.backend
        own = OwnDevice(config, backend, ahead=0)
        device = shared_device(self.served[0]) if self.served else own
        plan = plan._replace(batch=self.batch or plan.batch, read_ahead=0)
        together = together if self.served else plan.batch
        counts = {"together": together, "devices": self.devices, "others": workers - 1}
        return InProcess(self.settings, plan, device, alive=report_alive, **counts)


class OtherCamera(NamedTuple):
    """Returned instead of a log's summaries: the GPUs serve another camera."""

    calibration: Calibration


class _OtherCameraError(Exception):
    def __init__(self, calibration: Calibration) -> None:
        super().__init__()
        self.calibration = calibration


def process_log_in_worker(
    given: LogContext, files: "LogFiles", folder: Path
) -> list[LogSummary] | OtherCamera | None:
    """In a worker: write the results of a log, see :func:`jaxdet.engine.process_log.process_log`.

    Returns:
        Its summaries; None: the first process has to do it.
    """
    try:
        more = given.choose, no_report
        return process_log(given.settings, files, folder, given.memory, *more, keep_memory=True)
    except _OtherCameraError as error:
        return OtherCamera(error.calibration)
    except Exception:  # which is met again by the first process, which reports it
        return None


def choose_logs(sizes: Mapping[str, int], workers: int) -> set[str]:
    """Return the logs to be done one per worker, so that all are done soonest.

    These are the smallest: as many as it pays to do before the others are shared out one by one.

    Args:
        sizes: Bytes of each log.
        workers: Number of processes.
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
