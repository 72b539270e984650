"""The local loop: logs in, a results folder out."""

import re
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from jaxdet.config import Config
from jaxdet.engine.occupancy import OccupancyMap, save_map
from jaxdet.engine.planes import Planes, decide_planes, evenly
from jaxdet.engine.prefetch import prefetch
from jaxdet.engine.rows import Rows, batch_rows
from jaxdet.engine.scoring import Scorer
from jaxdet.engine.summary import LogSummary, Summary, plain
from jaxdet.errors import JaxdetError
from jaxdet.io import open_log
from jaxdet.io.results import ResultWriter
from jaxdet.pipeline import BackendName, detect
from jaxdet.render import draw_frame, draw_map, write_png
from jaxdet.types import Detections, GroundPlane

if TYPE_CHECKING:
    from jaxdet.io import Batch, Log, LogFiles, LogOptions

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
        ConfigError: The output folder holds results already.
        InputError: The output folder can't be written to, or the truth can't be read.
    """
    start = time.perf_counter()
    summary = Summary(options.backend, options.batch_size)
    with ResultWriter(options.output, overwrite=options.overwrite) as writer:
        ordered = sorted(logs, key=lambda log: log.name)
        for number, files in enumerate(ordered):
            part = LogSummary(files.name, tuple(map(str, files.paths)))
            summary.logs.append(part)
            job = _LogJob(part, config, options, writer, _file_names(ordered)[number])
            job.report = _reporter(progress, part, number, len(ordered))
            try:
                with open_log(files, log_options) as log:
                    job.run(log)
            except JaxdetError as error:
                part.error = str(error)
        summary.seconds = time.perf_counter() - start
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


class _Work(NamedTuple):
    batch: "Batch"
    plane: GroundPlane
    detections: Detections


@dataclass
class _LogJob:
    """One log of a run."""

    part: LogSummary
    config: Config
    options: RunOptions
    writer: ResultWriter
    file_name: str
    report: Callable[[int], None] = lambda total: None
    first: int = 0
    """Frames of the first batch."""

    def run(self, log: "Log") -> None:
        part = self.part
        part.description, part.calibration = log.description, log.calibration
        part.warnings += log.description.warnings
        planes = decide_planes(log, self.config, self.options.backend)
        part.ground = planes.records
        part.warnings += planes.warnings
        sample = self._sample(log)
        scorer = Scorer(self.options.truth, self.config) if self.options.truth else None
        occupancy = OccupancyMap()
        start = time.perf_counter()
        for work in self._one_behind(log, planes):
            rows = batch_rows(part.log, work.batch, work.plane, work.detections, self.config)
            self.writer.add(rows.frames, rows.obstacles)
            self._count(work.batch, rows, time.perf_counter() - start)
            occupancy.add_path(work.batch.frames.T_world_camera)
            occupancy.add(rows.obstacles["corners_world"])
            self._draw(work, rows, sample)
            if scorer:
                scorer.add(work.batch, rows.detections)
            self.report(log.num_frames)
        part.score = scorer.result() if scorer else None
        self._write_map(occupancy)

    def _one_behind(self, log: "Log", planes: Planes) -> Iterator[_Work]:
        """Starts each batch before the one before it is waited for."""
        pending = None
        with closing(prefetch(log.batches(self.options.batch_size))) as batches:
            for batch in batches:
                plane = planes.of(batch.frames.stamp_ns)
                frames = batch.frames._replace(plane=plane)
                detections = detect(frames, self.config, backend=self.options.backend)
                if pending:
                    yield pending
                pending = _Work(batch, plane, detections)
            if pending:
                yield pending

    def _count(self, batch: "Batch", rows: Rows, seconds: float) -> None:
        part = self.part
        count = len(batch.status)
        if not part.frames:
            part.first_batch_s, self.first = seconds, count
        elif seconds > part.first_batch_s:
            rest = part.frames + count - self.first
            if rest >= 2 * self.first:
                part.frames_per_s = round(rest / (seconds - part.first_batch_s), 2)
        part.count(rows.frames)
        part.seconds = seconds
        for index, error in zip(batch.frames.number.tolist(), batch.errors, strict=False):
            if error and len(part.frame_errors) < MAX_FRAME_ERRORS:
                part.frame_errors.append(f"frame {index}: {error}")

    def _sample(self, log: "Log") -> set[int]:
        paired = np.flatnonzero(np.asarray(log.depth_stamp_ns) >= 0)
        return (
            set(evenly(paired, self.options.pictures).tolist()) if self.options.pictures else set()
        )

    def _draw(self, work: _Work, rows: Rows, sample: set[int]) -> None:
        frames = work.batch.frames
        for row, index in enumerate(frames.number[: len(work.batch.status)].tolist()):
            if index in sample and frames.valid[row]:
                name = f"pictures/{self.file_name}_{index:06d}.png"
                one = work.batch.frames._replace(plane=work.plane)
                title = f"{self.part.log}   frame {index}"
                picture = draw_frame(one, rows.detections, rows.corners, row, self.config, title)
                write_png(self.writer.path(name), picture)
                self.part.pictures.append(name)

    def _write_map(self, occupancy: OccupancyMap) -> None:
        if not any(path.size for path in occupancy.path):
            self.part.warnings.append("no map: the log has no poses")
            return
        if occupancy.skipped:
            self.part.warnings.append(f"{occupancy.skipped} outlines have no place on the map")
        image = occupancy.image()
        if image is None:
            self.part.warnings.append("no map: no obstacle in the world, or too wide an area")
            return
        self.part.map = f"map_{self.file_name}"
        save_map(self.writer.path(f"{self.part.map}.npz"), image)
        write_png(self.writer.path(f"{self.part.map}.png"), draw_map(image, self.part.log))
