"""One log of a run, its units shared out to the pool's workers, and its rows in the results."""

import os
from collections.abc import Generator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from jaxdet.engine import pool
from jaxdet.engine.floors import Planes
from jaxdet.engine.join import add_rows, map_files, parts_of
from jaxdet.engine.log_run import PLAN, LogRun, RunContext
from jaxdet.engine.memory import Memory
from jaxdet.engine.plan import LogPlan, Unit
from jaxdet.engine.pool import Pool
from jaxdet.engine.progress import Report
from jaxdet.engine.slots import Slots
from jaxdet.engine.watch import watched
from jaxdet.engine.worker import UnitWork, decide_floors, save_work
from jaxdet.engine.workspace import Workspace
from jaxdet.errors import CamerasError, JaxdetError, OutputError
from jaxdet.results.durable import writing
from jaxdet.results.fault import fault_text
from jaxdet.results.summary import Counts, LogSummary, Summary
from jaxdet.results.writer import ResultWriter

if TYPE_CHECKING:
    from jaxdet.io import Log, LogFiles, LogOptions

FRAMES_WORTH_WORKERS = 500
"""Fewer are done sooner by this process than workers have started."""


class Results(NamedTuple):
    """Where the rows of logs go."""

    work: Workspace
    summary: Summary
    files: dict[str, Path]
    """Of the results, by their names there."""
    writer: ResultWriter


class PooledLogRun(LogRun):
    """A log that the pool's workers share, or this process does itself where it has few frames.

    Args:
        run: What it has in common with others.
        pool: The workers.
        results: Where its rows go.
        files: Of the log.
        file_name: What the names of its files begin with.
        report: Gets where it stands.
        number: Of the log, among all of the run.
    """

    def __init__(
        self,
        run: RunContext,
        pool: Pool,
        results: Results,
        files: "LogFiles",
        file_name: str,
        report: Report,
        number: int = 0,
    ) -> None:
        super().__init__(run, files, file_name, report, number, results.summary.frames)
        self.pool, self.results = pool, results
        self.alone = True
        """This process does the log itself."""

    def take(self, folder: Path, log_options: "LogOptions") -> LogSummary:
        """The rows, pictures and map are in the results, or there is an error.

        Args:
            folder: What is done lies here.
            log_options: How to read.

        Raises:
            CamerasError: There are several cameras, and the options choose none.
            OutputError: The disk is full or broken, or there is no memory for the rows.
        """
        results = self.results
        try:
            self.make_whole(folder, log_options)
        except (OutputError, CamerasError):
            raise
        except Exception as error:
            self.about.error = str(error)
            if not isinstance(error, JaxdetError):
                self.about.error = f"{self.files.name}: {type(error).__name__}: {error}"
            if not isinstance(error, JaxdetError) or hasattr(error, "__notes__"):
                report = f"report_{self.about.file_name or self.file_name}.txt"
                self.about.error += f"; a fault of jaxdet: please send its developers {report}"
                results.files[report] = path = results.work.result / report
                with writing(path):
                    path.write_text(fault_text(error, self.files.paths), encoding="utf-8")
        # What fails from here on ends the run: rows that are once in a table stay there.
        if not (self.about.error or self.options.share):
            self._add_results()
        results.summary.workers = max(results.summary.workers, self.workers)
        results.summary.batch_size = max(results.summary.batch_size, self.batch)
        return self.about

    def _add_results(self) -> None:
        """Rows, pictures and map of a log that is whole go into the results."""
        plan: LogPlan = self.run.work.read(self.folder / PLAN)
        parts = parts_of(plan._replace(folder=self.folder))
        add_rows(self.results.writer, (part.rows for part in parts), self.files.name)
        files = self.results.files
        files.update({name: self.folder / name for name in self.about.pictures})
        files.update(map_files(self.about, self.folder))

    def _use_fewer(self, memory: Memory) -> None:
        super()._use_fewer(memory)
        self.pool.resize(memory.workers)

    def _decide_how(self, log: "Log") -> None:
        alone = self._alone(len(log.frames))
        self.allotment = self._allot(log, 1 if alone else self.memory.workers)
        self.workers, self.batch, _ = self.allotment
        self.alone = alone or (self.workers == 1 and not self._kept_apart)
        self.pool.resize(self.workers)
        self.about.workers, self.about.devices = self.workers, len(self.pool.devices)

    def _alone(self, frames: int) -> bool:
        """Whether this process does a log itself, as it has few frames."""
        if self._kept_apart:
            return False
        one = self.memory.workers == 1
        return one or not (
            self.options.workers or self.pool.started or frames >= FRAMES_WORTH_WORKERS
        )

    @property
    def _kept_apart(self) -> bool:
        """Whether this process leaves logs to others, whatever their size.

        So after a run that ended without a word: what ended it may be in the log.
        """
        return bool(self.pool.devices) or self.memory.apart

    def _start(self, log: "Log") -> int:
        if self.alone:
            return super()._start(log)
        self.pool.start()
        if self.pool.devices:
            slots, self.batch = self._serve(log)
            return slots.frames
        return self._together(log)

    def _serve(self, log: "Log") -> tuple[Slots, int]:
        return self.pool.serve(log, self.config, self.options.batch_size, self.allotment.batch)

    def _find_planes(self, log: "Log", at_once: int) -> Planes:
        if self.alone or self.pool.devices:
            return super()._find_planes(log, at_once)
        # This process has no need of JAX.
        given = log, self.config, self.options.backend, None, at_once
        return self.pool.call(decide_floors, *given)

    def _counts(
        self, log: "Log", plan: LogPlan, units: list[Unit]
    ) -> Generator[Counts, None, None]:
        if not self.alone:
            yield from self.pool.work_through(plan, units, partial(self._save, log))
            return
        with watched(pool.NO_PROGRESS_S, partial(self._say_late, log.label)) as heard:
            self.batch_done = heard
            yield from super()._counts(log, plan, units)

    def _save(self, log: "Log", plan: LogPlan) -> Path:
        """What workers need, in a file of its own."""
        slots = self._serve(log)[0] if self.pool.devices else None
        return save_work(self.folder, UnitWork(log, plan, slots))

    def _say_late(self, label: str) -> None:
        """What a user can do whose run hangs, but wait."""
        self.run.say(
            f"{label}: no frame was finished for {pool.NO_PROGRESS_S:g} s; if that is not the "
            f"disk, kill this process (kill -9 {os.getpid()}) and repeat the command: workers, "
            "which have a time limit, do the log then"
        )
