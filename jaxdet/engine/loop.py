"""The local loop: logs in, a results folder out."""

import re
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from jaxdet.config import Config
from jaxdet.engine.batch import Done, LogJob, LogWork
from jaxdet.engine.ground import evenly
from jaxdet.engine.planes import decide_planes
from jaxdet.engine.processes import Processes
from jaxdet.errors import JaxdetError
from jaxdet.io import open_log
from jaxdet.pipeline import BackendName
from jaxdet.render import draw_map, write_png
from jaxdet.results.occupancy import OccupancyMap, save_map
from jaxdet.results.summary import LogSummary, Summary, plain
from jaxdet.results.writer import ResultWriter

if TYPE_CHECKING:
    from jaxdet.io import Log, LogFiles, LogOptions

MAX_FRAME_ERRORS = 20


@dataclass(frozen=True)
class RunOptions:
    """How to run; nothing here changes a byte of the two tables."""

    output: Path
    backend: BackendName = "jax"
    batch_size: int = 16
    pictures: int = 8
    """Pictures of frames of each log."""
    overwrite: bool = False
    truth: Path | None = None
    """A simulated log whose truth the results are compared with."""
    preset: str | None = None
    """Name of the preset the configuration started from, for config.json."""
    workers: int | None = None
    """Processes that share the frames; None: one a core on the CPU for logs long enough to be
    worth their start, else one."""


class Progress(NamedTuple):
    """Where a run stands, given to the progress callback after each batch."""

    log: str
    log_number: int
    num_logs: int
    done: int
    """Frames of this log."""
    total: int
    """Frames of this log."""
    bad: int
    """Frames of this log that are not ok."""
    frames_per_s: float | None


ProgressCallback = Callable[[Progress], None]


def run(
    logs: Sequence["LogFiles"],
    config: Config,
    log_options: "LogOptions",
    options: RunOptions,
    progress: ProgressCallback | None = None,
) -> Summary:
    """Finds the obstacles of every frame of every log and writes the results folder.

    A log that fails as a whole is in the summary with its error, and the others go on; when
    all fail, nothing is written.

    Args:
        logs: What :func:`jaxdet.io.find_logs` returns.
        config: The method.
        log_options: How to read.
        options: Where to write, and how to run.
        progress: Called after each batch.

    Returns:
        What is in ``summary.json``.

    Raises:
        ConfigError: The output folder holds results already, or the backend has no program for
            the configuration.
        InputError: The output folder can't be written to, or the truth can't be read.
    """
    start = time.perf_counter()
    summary = Summary(options.backend, options.batch_size)
    with (
        ResultWriter(options.output, overwrite=options.overwrite) as writer,
        Processes(options.workers, options.backend) as processes,
    ):
        ordered = sorted(logs, key=lambda log: log.name)
        for number, files in enumerate(ordered):
            part = LogSummary(files.name, tuple(map(str, files.paths)))
            summary.logs.append(part)
            one = _LogRun(part, config, options, writer, _file_names(ordered)[number])
            one.report = _reporter(progress, part, number, len(ordered))
            try:
                with open_log(files, log_options) as log:
                    one.run(log, processes)
            except JaxdetError as error:
                part.error = str(error)
        summary.seconds, summary.workers = time.perf_counter() - start, processes.used
        if len(summary.failed) < len(ordered):
            writer.commit(_resolved(config, log_options, options), summary.to_dict())
    return summary


def _resolved(config: Config, log_options: "LogOptions", options: RunOptions) -> dict:
    how = {"preset": options.preset, "backend": options.backend, "batch_size": options.batch_size}
    return {**how, **plain(config), "log": plain(log_options)}


def _reporter(
    progress: ProgressCallback | None, part: LogSummary, number: int, count: int
) -> Callable[[int], None]:
    def report(total: int) -> None:
        if progress:
            rate = part.frames_per_s
            progress(Progress(part.log, number, count, part.frames, total, part.num_bad, rate))

    return report


def _file_names(logs: Sequence["LogFiles"]) -> list[str]:
    """The logs' names with nothing that a file name should not have, each different."""
    names: list[str] = []
    for log in logs:
        name = stem = re.sub(r"[^\w.-]+", "_", log.name).strip(".")[:80] or "log"
        number = 2
        while name in names:
            name, number = f"{stem}_{number}", number + 1
        names.append(name)
    return names


@dataclass
class _LogRun:
    """One log of a run."""

    part: LogSummary
    config: Config
    options: RunOptions
    writer: ResultWriter
    file_name: str
    report: Callable[[int], None] = lambda total: None
    first: int = 0
    """Frames of the first batch."""

    def run(self, log: "Log", processes: Processes) -> None:
        part = self.part
        part.description, part.calibration = log.description, log.calibration
        part.warnings += log.description.warnings
        work = LogWork(log, self._job(log))
        occupancy, tallies = OccupancyMap(), []
        start = time.perf_counter()
        with closing(processes.work_through(work)) as batches:
            for done in batches:
                self.writer.add(done.frames, done.obstacles)
                self._count(done, time.perf_counter() - start)
                occupancy.add_path(done.T_world_camera)
                occupancy.add(done.obstacles["corners_world"])
                occupancy.add_free(done.free_world)
                tallies += [done.tally] if done.tally else []
                self.report(log.num_frames)
        if tallies:
            from jaxdet.engine.scoring import scores

            part.score = scores(tallies)
        part.warnings += [part.floor_warning] if part.floor_warning else []
        self._write_map(occupancy)

    def _job(self, log: "Log") -> LogJob:
        planes = decide_planes(log, self.config, self.options.backend)
        self.part.ground = planes.records
        self.part.warnings += planes.warnings
        return LogJob(
            self.part.log,
            self.config,
            self.options.backend,
            min(self.options.batch_size, max(1, log.num_frames)),
            planes,
            self._sample(log),
            self.writer.staging,
            self.file_name,
            self.options.truth,
        )

    def _count(self, done: Done, seconds: float) -> None:
        part = self.part
        count = len(done.frames["status"])
        if not part.frames:
            part.first_batch_s, self.first = seconds, count
        elif seconds > part.first_batch_s:
            rest = part.frames + count - self.first
            if rest >= 2 * self.first:
                part.frames_per_s = round(rest / (seconds - part.first_batch_s), 2)
        part.count(done.frames)
        part.seconds = seconds
        part.pictures += done.pictures
        part.frame_errors += done.errors[: MAX_FRAME_ERRORS - len(part.frame_errors)]

    def _sample(self, log: "Log") -> frozenset[int]:
        if not self.options.pictures:
            return frozenset()
        paired = np.flatnonzero(np.asarray(log.depth_stamp_ns) >= 0)
        return frozenset(evenly(paired, self.options.pictures).tolist())

    def _write_map(self, occupancy: OccupancyMap) -> None:
        if not any(path.size for path in occupancy.path):
            self.part.warnings.append("no map: the log has no poses")
            return
        if occupancy.skipped:
            self.part.warnings.append(
                f"{occupancy.skipped} outlines or views have no place on the map"
            )
        image = occupancy.image()
        if image is None:
            self.part.warnings.append("no map: nothing seen in the world, or too wide an area")
            return
        self.part.map = f"map_{self.file_name}"
        save_map(self.writer.path(f"{self.part.map}.npz"), image)
        write_png(self.writer.path(f"{self.part.map}.png"), draw_map(image, self.part.log))
