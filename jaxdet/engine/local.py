"""The local loop: logs in, a results folder out."""

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from jaxdet.config import Config
from jaxdet.cores import cores
from jaxdet.engine.device import OwnDevice
from jaxdet.engine.floors import Planes, decide_planes, evenly
from jaxdet.engine.options import RunOptions
from jaxdet.engine.plan import LogPlan, Observer
from jaxdet.engine.pool import Pool, gpus
from jaxdet.engine.startup import start_up
from jaxdet.engine.unit import LogWork, Part, save_work
from jaxdet.errors import CamerasError, JaxdetError
from jaxdet.io import RescanError, open_log
from jaxdet.io.notes import total
from jaxdet.pipeline import BackendName
from jaxdet.render import draw_map, write_png
from jaxdet.results.names import camera_file_name, file_names
from jaxdet.results.occupancy import OccupancyMap, save_map
from jaxdet.results.summary import LogSummary, Summary, plain
from jaxdet.results.writer import ResultWriter

if TYPE_CHECKING:
    from pathlib import Path

    from jaxdet.io import Log, LogFiles, LogOptions, Notes

MAX_FRAME_ERRORS = 20
CPU_BATCH = 16
"""Frames computed together by a process of the CPU, unless the user says."""
FRAMES_WORTH_WORKERS = 500
"""Fewer are done sooner by this process than workers have started."""
UNIT_FRAMES = 256
"""Most frames of a unit; neighbouring frames share chunks of the log."""
READ_AHEAD = 2
"""Batches that wait, read, where one process has all cores."""


class Progress(NamedTuple):
    """Where a run stands, given to the progress callback after each unit, and before the first."""

    log: str
    """The log's name, and the camera's where the log has several."""
    log_number: int
    num_logs: int
    done: int
    """Frames of this log."""
    total: int
    """Frames of this log."""
    bad: int
    """Frames of this log that are not ok."""
    frames_per_s: float | None
    bottleneck: str = ""
    """The step that others wait for, see :attr:`jaxdet.results.summary.LogSummary.bottleneck`."""
    rates: Mapping[str, float] = MappingProxyType({})
    """Frames a second of each step alone."""
    doing: str = ""
    """What goes on before the first unit is through."""


ProgressCallback = Callable[[Progress], None]


def run(
    logs: Sequence["LogFiles"],
    config: Config,
    log_options: "LogOptions",
    options: RunOptions,
    progress: ProgressCallback | None = None,
    observers: Mapping[str, Observer] | None = None,
    preset: str | None = None,
) -> Summary:
    """Finds the obstacles of every frame of every log and writes the results folder.

    Args:
        logs: What :func:`jaxdet.io.find_logs` returns.
        config: The method.
        log_options: How to read.
        options: Where to write, and how to run.
        progress: Called after each unit.
        observers: See each batch of every log; what they say is in the summary under their names.
        preset: Name of the preset that the configuration started from, for config.json.

    Returns:
        What is in ``summary.json``.

    Raises:
        ConfigError: The output folder holds results already, or the backend has no program for
            the configuration.
        InputError: The output folder can't be written to.
    """
    start = time.perf_counter()
    summary = Summary(options.backend, options.batch_size or 0)
    ordered = sorted(logs, key=lambda log: log.name)
    devices = gpus() if options.backend == "jax" else ()
    workers = options.workers or max(1, cores() - bool(devices))
    with (
        ResultWriter(options.output, overwrite=options.overwrite) as writer,
        Pool(workers, options.backend, devices) as pool,
    ):
        names = file_names(files.name for files in ordered)
        for number, (files, name) in enumerate(zip(ordered, names, strict=True)):
            one = _LogRun(config, options, observers or {}, writer, pool, files.name, name)
            one.report = _reporter(progress, number, len(ordered))
            summary.logs += one.run(files, log_options)
            summary.workers = max(summary.workers, one.workers)
            summary.batch_size = max(summary.batch_size, one.batch)
        summary.seconds = time.perf_counter() - start
        if len(summary.failed) < len(ordered):
            how = {"preset": preset, "backend": options.backend, "batch_size": summary.batch_size}
            resolved = {**how, **plain(config), "log": plain(log_options)}
            writer.commit(resolved, summary.to_dict())
    return summary


def _reporter(
    progress: ProgressCallback | None, number: int, count: int
) -> Callable[[LogSummary, str, int, str], None]:
    def report(part: LogSummary, label: str, total: int, doing: str) -> None:
        if progress:
            state = part.frames, total, part.num_bad, part.frames_per_s, part.bottleneck
            progress(Progress(label, number, count, *state, part.rates, doing))

    return report


@dataclass
class _LogRun:
    """One log of a run."""

    config: Config
    options: RunOptions
    observers: Mapping[str, Observer]
    writer: ResultWriter
    pool: Pool
    name: str
    file_name: str
    report: Callable[[LogSummary, str, int, str], None] = lambda *_: None
    workers: int = 1
    """Processes that shared the frames."""
    batch: int = 0
    """Frames computed together."""

    def run(self, files: "LogFiles", log_options: "LogOptions") -> list[LogSummary]:
        """The rows and pictures of a log are in the results, or there are none and an error.

        Returns:
            One for each camera, all cameras or the one of the options.
        """
        about = LogSummary(files.name, tuple(map(str, files.paths)))
        camera = f", {log_options.camera}" if log_options.camera else ""
        self.report(about, files.name + camera, 0, "opening")
        try:
            with open_log(files, log_options) as log, self.writer.log_folder() as folder:
                about.camera, about.file_name = log.camera, self._stem(log)
                self._run(log, folder, about)
        except CamerasError as error:
            each = [replace(log_options, camera=camera) for camera in error.cameras]
            return [about for options in each for about in self.run(files, options)]
        except JaxdetError as error:
            if isinstance(error, RescanError) and not log_options.scan:
                return self.run(files, replace(log_options, scan=True))
            about.error = str(error)
        return [about]

    def _run(self, log: "Log", folder: "Path", about: LogSummary) -> None:
        about.description, about.calibration = log.description, log.calibration
        about.warnings += log.description.warnings
        frames = len(log.frames)
        alone, slots = self._alone(frames), None
        self.workers = about.workers = 1 if alone else self.pool.count
        about.devices = len(self.pool.devices)
        self.report(about, log.label, frames, "looking for the floor")
        if not alone:
            self.pool.start()
        elif self.options.backend == "jax":
            start_up()
        here = alone or bool(self.pool.devices)  # else this process has no need of JAX
        decide = decide_planes if here else partial(self.pool.call, decide_planes)
        planes = decide(log, self.config, self.options.backend)
        if self.pool.devices:
            slots, self.batch = self.pool.serve(log, self.config, self.options.batch_size)
            plan = self._plan(log, folder, slots.frames, planes)
        else:
            self.batch = self.options.batch_size or CPU_BATCH
            plan = self._plan(log, folder, min(self.batch, max(1, frames)), planes)
        self.report(about, log.label, frames, "starting")
        about.ground = plan.planes.records
        about.warnings += plan.planes.warnings
        clock = _Clock(about, self.workers)
        if alone:
            device = OwnDevice(self.config, self.options.backend, ahead=1)
            work = LogWork(log, plan, device).work_through(plan.units(), READ_AHEAD)
        else:
            save_work(folder / "work", log, plan, slots)
            work = self.pool.work_through(folder / "work", plan)
        with closing(work) as units:
            for counts in units:
                about.add(counts)
                clock.tick()
                self.report(about, log.label, frames, "")
        notes = self._merge(plan, about)
        about.description = log.described(total(notes))
        about.warnings += about.description.warnings[len(log.description.warnings) :]
        about.warnings += [about.floor_warning] if about.floor_warning else []
        about.seconds = clock.seconds

    def _stem(self, log: "Log") -> str:
        one = log.label == log.name
        return self.file_name if one else camera_file_name(self.file_name, log.camera)

    def _plan(self, log: "Log", folder: "Path", batch: int, planes: Planes) -> LogPlan:
        """How a log is worked through; ``batch`` frames at a time."""
        count, config = self.options.pictures, self.config
        drawn = evenly(np.array(log.frames), count) if count else np.zeros(0, int)
        return LogPlan(
            self.name,
            log.camera,
            log.label,
            log.frames,
            config,
            self.options.backend,
            batch,
            _unit_frames(len(log.frames), batch, self.workers, self.options.backend),
            planes,
            frozenset(drawn.tolist()),
            folder,
            self._stem(log),
            self.observers,
        )

    def _alone(self, frames: int) -> bool:
        """Whether this process does a log itself, as it has few frames."""
        if self.pool.devices or self.options.workers or self.pool.started:
            return self.pool.count == 1 and not self.pool.devices
        return self.pool.count == 1 or frames < FRAMES_WORTH_WORKERS

    def _merge(self, plan: LogPlan, about: LogSummary) -> list["Notes"]:
        """The parts of a log that is whole become rows, map and what observers say.

        Returns:
            What reading told beside the frames.
        """
        occupancy = OccupancyMap()
        seen: dict[str, list[Any]] = {name: [] for name in plan.observers}
        notes: list[Notes] = []
        for unit in plan.units():
            part = Part.load(plan.folder, unit)
            assert part.rows is not None
            self.writer.add(part.rows)
            occupancy.merge(part.map)
            notes += part.notes
            about.pictures += part.pictures
            about.frame_errors += part.errors[: MAX_FRAME_ERRORS - len(about.frame_errors)]
            for name, made in part.seen.items():
                seen[name] += made
        for name, observer in plan.observers.items():
            about.observed[name] = observer.summary(seen[name])
        self._write_map(occupancy, plan, about)
        return notes

    def _write_map(self, occupancy: OccupancyMap, plan: LogPlan, about: LogSummary) -> None:
        if not any(path.size for path in occupancy.path):
            about.warnings.append("no map: the log has no poses")
            return
        if occupancy.skipped:
            about.warnings.append(f"{occupancy.skipped} outlines or views have no place on the map")
        image = occupancy.image()
        if image is None:
            about.warnings.append("no map: nothing seen in the world, or too wide an area")
            return
        about.map = f"map_{plan.file_name}"
        save_map(self.writer.path(f"{about.map}.npz"), image)
        write_png(self.writer.path(f"{about.map}.png"), draw_map(image, plan.label))


def _unit_frames(frames: int, batch: int, workers: int, backend: BackendName) -> int:
    """Frames of a unit: whole batches, and enough units to keep all workers busy to the end."""
    most = UNIT_FRAMES if backend == "jax" else batch
    return max(1, min(most, frames // (4 * workers)) // batch) * batch


@dataclass
class _Clock:
    """Times of a log: the first units, and the rate after them."""

    about: LogSummary
    workers: int
    start: float = field(default_factory=time.perf_counter)
    units: int = 0
    first: int = 0
    """Frames of the first unit of each worker."""

    @property
    def seconds(self) -> float:
        return time.perf_counter() - self.start

    def tick(self) -> None:
        """A unit has been counted."""
        about, seconds = self.about, self.seconds
        rest, self.units = about.frames - self.first, self.units + 1
        if self.units <= self.workers:
            self.first, about.first_batch_s = about.frames, seconds
        elif rest >= 2 * self.first and seconds > about.first_batch_s:
            about.frames_per_s = round(rest / (seconds - about.first_batch_s), 2)
