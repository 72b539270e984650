"""Scheduling of the logs of a run, by the rules of :mod:`jaxdet.engine.placement`."""

import logging
import os
import signal
import time
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

from jaxdet.engine.executors import first_process
from jaxdet.engine.output import OutputFolder
from jaxdet.engine.placement import Machine, logs_for_workers
from jaxdet.engine.pool import Pool, TaskQueue
from jaxdet.engine.process_log import LogJob, LogTask, process_log
from jaxdet.engine.settings import Progress, ProgressCallback, RunOptions, RunSettings
from jaxdet.errors import InputError, Interrupted, OutputError
from jaxdet.io import LogFiles
from jaxdet.results.durable import remove
from jaxdet.results.summary import LogSummary, Summary
from jaxdet.signals import stops_held_back, stops_raised
from jaxdet.types import Calibration

LOGGER = logging.getLogger("jaxdet")


class _CallbackError(BaseException):
    """Exception of the progress callback, its only argument; it ends the run, not a log."""


def run_logs(
    settings: RunSettings,
    logs: Sequence[LogFiles],
    place: Path,
    pool: Pool,
    progress: ProgressCallback | None,
) -> Summary:
    """Process all logs of a run that are not done yet, and write their results to ``place``."""
    start, options, machine = time.perf_counter(), settings.options, None
    with OutputFolder(place, settings.record, options) as output:
        done = output.begin(logs)
        kept = frozenset(done)
        left = {log.name: log for log in logs if log.name not in kept}
        if kept and left:
            LOGGER.info("continuing: %d of %d logs are done", len(kept), len(logs))
        try:
            with stops_raised():
                if left:
                    machine = Machine(settings, pool, apart=output.taken_over)
                    Scheduler(machine, logs, output, done, progress).run(left)
        except KeyboardInterrupt as stop:
            pool.close()
            number = getattr(stop, "signal", signal.SIGINT)
            text = f"interrupted; {_standing(done, logs, options)}"
            raise Interrupted(number, text) from None
        except _CallbackError as failed:
            pool.close()
            raise failed.args[0] from failed.args[0].__cause__
        except BaseException as error:
            pool.close()
            if isinstance(error, InputError | OutputError) and done:
                error.add_remedy(_standing(done, logs, options))
            raise
    found = [about for log in logs for about in done[log.name]]
    return make_summary(settings, machine, found, start, kept)


def _standing(done: Collection[str], logs: Sequence[LogFiles], options: RunOptions) -> str:
    """Describe how many logs are done and how to continue the run."""
    some = "no log is done" if not done else f"{len(done)} of {len(logs)} logs are done"
    but = " without --overwrite" if options.overwrite else ""
    return f"{some}; the same command{but} goes on"


@dataclass
class Scheduler:
    """Scheduler of the logs of a run; moves their results to the output folder."""

    machine: Machine
    logs: Sequence[LogFiles]
    """All logs of the run."""
    output: OutputFolder
    done: dict[str, list[LogSummary]]
    """Summaries of the cameras of each log that is done, by its name; :meth:`run` adds logs."""
    progress: ProgressCallback | None

    def __post_init__(self) -> None:
        self.settings, self.pool = self.machine.settings, self.machine.pool
        self.numbers = {log.name: number for number, log in enumerate(self.logs)}

    def run(self, left: dict[str, LogFiles]) -> None:
        """Process small logs, each by a single worker, then the other logs, each by all workers.

        GPUs compute for the camera of the last log that all workers shared. If a worker gets a log
        of another camera, it only returns that camera, and the log waits until GPUs compute for it.
        """
        cameras: dict[str, Calibration | None] = dict.fromkeys(logs_for_workers(left, self.machine))
        """Camera of each log for single workers, by log name; None until a worker returns it."""
        while left:
            ready = [left[name] for name, camera in cameras.items() if self._ready(camera)]
            for log, answer in self._by_workers(ready) if ready else ():
                if isinstance(answer, Calibration):
                    cameras[log.name] = answer
                    continue
                del cameras[log.name]
                if isinstance(answer, list):
                    self._take(left.pop(log.name), answer)
            if not ready:
                name = next(chain((name for name in left if name not in cameras), cameras))
                cameras.pop(name, None)
                self._do_here(left.pop(name))

    def _ready(self, camera: Calibration | None) -> bool:
        """Return whether a single worker can process a log now; its camera may be unknown."""
        if not self.pool.devices:
            return True
        served = self.pool.serving
        if served is None or self.pool.count != self.machine.memory.workers:
            return False  # from the next shared log on, GPUs compute for all workers
        return served.config == self.settings.config and camera in (None, served.calibration)

    def _by_workers(
        self, logs: Sequence[LogFiles]
    ) -> Iterator[tuple[LogFiles, list[LogSummary] | Calibration | None]]:
        """Let each worker process complete logs; yield the logs with the answers of the workers."""
        self.pool.resize(self.machine.memory.workers)
        self.machine.workers = self.pool.count
        job = LogJob(self.settings, self.machine.memory, self.pool.serving)
        tasks = [LogTask(log, self.output.staged(log.name)) for log in logs]
        for task in tasks:
            remove(task.folder)  # left by a worker that was ended
        first = logs[0].name
        self._report(LogSummary(first, ()), first, 0, "opening")
        for task, answer in self.pool.each(job, TaskQueue(tasks)):
            if not isinstance(answer, list):
                remove(task.folder)
            yield task.files, answer

    def _do_here(self, log: LogFiles) -> None:
        """Process a log in this process, or divide it among all workers."""
        staged = self.output.staged(log.name)
        remove(staged)  # left by a worker that was lost
        done = process_log(self.settings, log, staged, first_process(self.machine, self._report))
        if any(about.error for about in done):
            self._check_there(log)
        self._take(log, done)

    def _take(self, log: LogFiles, done: list[LogSummary]) -> None:
        """Move the results of a log to the output folder."""
        with stops_held_back():
            self.output.publish(log.name)
            self.done[log.name] = done
        for about in done:
            self._report(about, about.log, about.frames, "")
            if about.error:
                LOGGER.info("%s: failed: %s", about.log, about.error)
            else:
                counts = about.frames, about.obstacles
                LOGGER.info("%s: done, %d frames, %d obstacles", about.log, *counts)

    def _report(self, about: LogSummary, label: str, total: int, doing: str) -> None:
        """Report progress to the log and to the callback."""
        stands = doing or f"{about.frames} of {total} frames"
        LOGGER.debug("%s: %s", label, stands)
        if self.progress is None:
            return
        failed = sum(any(one.error for one in done) for done in self.done.values())
        now = Progress(
            log=label,
            log_number=self.numbers[about.log],
            num_logs=len(self.logs),
            done=about.frames,
            total=total,
            bad=about.num_bad,
            frames_per_s=about.frames_per_s,
            bottleneck=about.bottleneck,
            rates=about.rates,
            doing=doing,
            logs_done=len(self.done),
            logs_failed=failed,
        )
        try:
            self.progress(now)
        except Exception as error:
            raise _CallbackError(error) from error

    def _check_there(self, failed: LogFiles) -> None:
        """Check that the disk of a log that failed is still available.

        If other logs are missing too, the disk itself is missing. If only this log is missing, it
        was removed, and the run continues.

        Raises:
            InputError: The disk is missing; logs that are done are kept.
        """
        others = [log for log in self.logs if log is not failed and log.name not in self.done]
        if _gone(failed) and (not others or any(map(_gone, others))):
            path, remedy = str(failed.paths[0]), "see that its disk is there"
            raise InputError("is not there any more", path=path, remedy=remedy)


def make_summary(
    settings: RunSettings,
    machine: Machine | None,
    logs: list[LogSummary],
    start: float,
    kept: frozenset[str] = frozenset(),
) -> Summary:
    """Return the summary of a run.

    Args:
        settings: Settings of the run.
        machine: Memory and processes; None if all logs were done before.
        logs: Summaries of the cameras of all logs.
        start: Time at which the run began, by ``time.perf_counter`` [s].
        kept: Names of the logs that were done before.
    """
    batch = machine.batch if machine else settings.options.batch_size or 0
    seconds = time.perf_counter() - start
    workers = max([machine.workers if machine else 1, *(log.workers for log in logs)])
    return Summary(settings.options.backend, batch, logs, seconds, workers, kept)


def _gone(log: LogFiles) -> bool:
    return not all(map(os.path.exists, log.paths))
