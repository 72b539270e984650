"""Processing of whole logs by single workers.

If a worker can't process a log, the first process tries it again, and reports the error if that
fails too.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from jaxdet.engine.executors import Host, InProcess
from jaxdet.engine.memory import Memory
from jaxdet.engine.placement import OtherCameraError, share_of_worker
from jaxdet.engine.process_log import process_log
from jaxdet.engine.settings import RunSettings
from jaxdet.engine.worker import WorkerProcess
from jaxdet.results.summary import LogSummary

if TYPE_CHECKING:
    from jaxdet.engine.slots import Served
    from jaxdet.io import Log, LogFiles


class LogTask(NamedTuple):
    """A log for a worker."""

    files: "LogFiles"
    folder: Path
    """New folder for its results."""


class LogJob(NamedTuple):
    """Job that processes logs; each worker processes one log at a time."""

    settings: RunSettings
    memory: Memory
    """Memory of the run, of which each worker takes its share."""
    served: "Served | None"
    """Format of the frames that GPUs compute; None if workers compute."""

    @contextmanager
    def open(self, process: WorkerProcess) -> Iterator[Callable[[LogTask], Any]]:
        """Return :meth:`process_log` for tasks."""
        yield partial(self.process_log, process)

    def process_log(
        self, process: WorkerProcess, task: LogTask
    ) -> list[LogSummary] | OtherCameraError | None:
        """Write the results of a log, see :func:`jaxdet.engine.process_log.process_log`.

        Returns:
            The summaries of its cameras; an error if GPUs don't compute for its camera; None if
            the first process has to process the log.
        """
        try:
            host = Host(self.memory, partial(self.executor, process), log_per_worker=True)
            return process_log(self.settings, *task, host)
        except OtherCameraError as error:
            return error
        except Exception:  # the first process tries the log again, and reports the error
            return None

    def executor(self, process: WorkerProcess, log: "Log", memory: Memory) -> InProcess:
        """Return the executor of a worker, with its share of the memory."""
        share = share_of_worker(self.settings, log, memory, self.served)
        device = process.device(self.served, self.settings)
        alive = process.report_progress
        return InProcess(self.settings, log, share, device, alive)
