"""The local loop: logs in, a results folder out."""

import itertools
import os
import signal
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

import jaxdet
from jaxdet.config import Config
from jaxdet.cores import cores
from jaxdet.engine.device import OwnDevice
from jaxdet.engine.floors import Planes, decide_planes, evenly
from jaxdet.engine.options import RunOptions
from jaxdet.engine.part import Part, part_path
from jaxdet.engine.plan import LogPlan, Observer
from jaxdet.engine.pool import Pool, gpus
from jaxdet.engine.record import make_record
from jaxdet.engine.signals import stops_held_back, stops_raised
from jaxdet.engine.startup import start_up
from jaxdet.engine.unit import LogWork, save_work
from jaxdet.engine.workspace import Workspace
from jaxdet.errors import CamerasError, Interrupted, JaxdetError, OutputError
from jaxdet.io import RescanError, open_log
from jaxdet.io.notes import total
from jaxdet.pipeline import BackendName
from jaxdet.render import draw_map, write_png
from jaxdet.results.durable import flush, writing
from jaxdet.results.manifest import MANIFEST, make_manifest
from jaxdet.results.names import camera_file_name, file_names
from jaxdet.results.occupancy import OccupancyMap, save_map
from jaxdet.results.summary import LogSummary, Summary, versions
from jaxdet.results.writer import ResultWriter, write_json

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
PLAN, WHOLE = "plan", "whole"
"""In the folder of a log: how it is worked through, and its summary."""
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
    say: Callable[[str], None] = lambda text: None,
) -> Summary:
    """Finds the obstacles of every frame of every log and writes the results folder.

    A run that was stopped goes on where it was, when it is asked for again; its results are the
    same bytes. A signal that ends it (Ctrl-C, SIGTERM, SIGHUP) keeps what is done. One log that
    fails, or some of its frames, costs no other.

    Args:
        logs: What :func:`jaxdet.io.find_logs` returns.
        config: The method.
        log_options: How to read.
        options: Where to write, and how to run.
        progress: Called after each unit.
        observers: See each batch of every log; what they say is in the summary under their names.
        preset: Name of the preset that the configuration started from, for config.json.
        say: Gets a line for each thing worth knowing at the start, such as a run that goes on.

    Returns:
        What is in ``summary.json``.

    Raises:
        ConfigError: The output folder holds results already, or an unfinished run with other
            inputs, configuration or versions; another run works there; or the backend has no
            program for the configuration.
        InputError: The output folder can't be written to.
        OutputError: The disk is full or broken; what is done is kept.
        Interrupted: A signal ended it; what is done is kept.
    """
    ordered = sorted(logs, key=lambda log: log.name)
    seen = observers or {}
    record = make_record(ordered, config, log_options, options, seen, preset)
    output, overwrite = options.output, options.overwrite
    with Workspace(output, record, overwrite=overwrite, say=say) as work:
        if work.done:
            return work.done.told[1]
        whole = _Run(ordered, config, log_options, options, seen, work)
        whole.progress = progress
        if there := whole.standing():
            say(f"continuing: {there} there")
        try:
            with stops_raised():
                return whole.run(record)
        except KeyboardInterrupt as stop:
            there = whole.standing()
            there = f"{there} done; the same command goes on" if there else "nothing is done yet"
            number = getattr(stop, "signal", signal.SIGINT)
            raise Interrupted(number, f"interrupted; {there}") from None
        except OutputError as error:
            if there := whole.standing():
                error.add_remedy(f"the same command goes on: {there} done")
            raise


_numbers = itertools.count()
"""Of the files that workers are given."""
Report = Callable[[LogSummary, str, int, str], None]
"""Gets where a log stands: summary, label, frames, and what goes on."""


def _reporter(progress: ProgressCallback | None, number: int, count: int) -> Report:
    def report(part: LogSummary, label: str, total: int, doing: str) -> None:
        if progress:
            state = part.frames, total, part.num_bad, part.frames_per_s, part.bottleneck
            progress(Progress(label, number, count, *state, part.rates, doing))

    return report


class _Run:
    """The logs of a run, one after the other."""

    def __init__(
        self,
        logs: Sequence["LogFiles"],
        config: Config,
        log_options: "LogOptions",
        options: RunOptions,
        observers: Mapping[str, Observer],
        work: Workspace,
    ) -> None:
        self.logs, self.config, self.log_options = logs, config, log_options
        self.options, self.observers, self.work = options, observers, work
        self.progress: ProgressCallback | None = None
        self.summary = Summary(options.backend, options.batch_size or 0)
        self.files: dict[str, Path] = {}
        """Of the results, by their names."""
        self._start = time.perf_counter()
        self._names = file_names(log.name for log in logs)

    def run(self, record: Mapping[str, Any]) -> Summary:
        """All logs are in the results, but those that have failed."""
        summary, result = self.summary, self.work.result
        with ResultWriter(result) as writer:
            self._run_logs(writer)
            summary.seconds = time.perf_counter() - self._start
            if not summary.whole:
                self.work.drop(self.files)
                return summary
            how = {"preset": None, "backend": None, "batch_size": summary.batch_size}
            config, told = {**how, **record["config"]}, summary.to_dict()
            self.files |= writer.close(config, told)
        self.files |= write_json(result / "config.json", config)
        self.files |= write_json(result / "summary.json", told)
        with writing(result):
            manifest = make_manifest(record["about"], self.files)
        self.files |= write_json(result / MANIFEST, manifest)
        with stops_held_back(drop=True):
            self.work.commit(self.files, summary)
        return summary

    def standing(self) -> str:
        """How much is on the disk, for people; empty: nothing."""
        logs = sorted(self.work.folder.glob("logs/*"))
        done = sum((log / WHOLE).exists() for log in logs)
        text = f"{done} of {len(self.logs)} logs"
        for folder in sorted(self.work.folder.glob("logs/*/*/"), reverse=True):
            parts = len(list(folder.glob("*.part")))
            plan: LogPlan | None = self.work.read(folder / PLAN)
            if parts and plan and not (folder / WHOLE).exists():
                text += f" and {parts} of {len(list(plan.units()))} units of {plan.label}"
                return f"{text} are"
        return f"{text} are" if done else ""

    def _run_logs(self, writer: ResultWriter) -> None:
        devices = gpus() if self.options.backend == "jax" else ()
        workers = self.options.workers or max(1, cores() - bool(devices))
        with Pool(workers, self.options.backend, devices) as pool:
            for number, files in enumerate(self.logs):
                one = _LogRun(self, pool, files, self._names[number])
                one.report = _reporter(self.progress, number, len(self.logs))
                one.writer = writer
                folder, options = self.work.log_folder(number), self.log_options
                try:
                    found = [one.run(folder / "0", options)]
                except CamerasError as error:
                    each = [replace(options, camera=camera) for camera in error.cameras]
                    found = [one.run(folder / f"{i + 1}", each[i]) for i in range(len(each))]
                self.summary.logs += found
                if not any(about.error for about in found):
                    self.work.write(folder / WHOLE, None)


def _report(files: "LogFiles") -> str:
    """What the people who can repair it want to know of an exception that is being handled."""
    where = "\n".join(str(path) for path in files.paths)
    about = "\n".join(f"{name} {version}" for name, version in versions().items())
    return f"{where}\n\njaxdet {jaxdet.__version__}\n{about}\n\n{traceback.format_exc()}"


class _LogRun:
    """One log of a run, or one camera of it after the other."""

    writer: ResultWriter
    report: Report

    def __init__(self, whole: _Run, pool: Pool, files: "LogFiles", file_name: str) -> None:
        self.whole, self.pool, self.files, self.file_name = whole, pool, files, file_name
        self.config, self.options, self.observers = whole.config, whole.options, whole.observers
        self.workers = 1
        """Processes that shared the frames."""
        self.batch = 0
        """Frames computed together."""

    def run(self, folder: "Path", log_options: "LogOptions") -> LogSummary:
        """The rows, pictures and map are in the results, or there is an error.

        Args:
            folder: What is done lies here.
            log_options: How to read.

        Raises:
            CamerasError: There are several cameras, and the options choose none.
            OutputError: The disk is full or broken.
        """
        self.folder, self.about, summary = folder, self._new(), self.whole.summary
        files = self.whole.files
        try:
            self._make_whole(log_options)
            for part in self._parts(self.whole.work.read(folder / PLAN)):
                self.writer.add(part.rows)
            files.update({name: folder / name for name in self.about.pictures})
            for end in ("npz", "png") if self.about.map else ():
                files[f"{self.about.map}.{end}"] = folder / f"map.{end}"
        except (OutputError, CamerasError):
            raise
        except Exception as error:
            self.about.error = str(error)
            if not isinstance(error, JaxdetError):
                self.about.error = f"{self.files.name}: {type(error).__name__}: {error}"
            if not isinstance(error, JaxdetError) or hasattr(error, "__notes__"):
                report = f"report_{self.about.file_name or self.file_name}.txt"
                self.about.error += f"; a fault of jaxdet: please send its developers {report}"
                files[report] = self.whole.work.result / report
                with writing(files[report]):
                    files[report].write_text(_report(self.files), encoding="utf-8")
        summary.workers = max(summary.workers, self.workers)
        summary.batch_size = max(summary.batch_size, self.batch)
        return self.about

    def _new(self) -> LogSummary:
        return LogSummary(self.files.name, tuple(map(str, self.files.paths)))

    def _make_whole(self, options: "LogOptions") -> None:
        """All parts are on the disk, and the summary."""
        work = self.whole.work
        plan: LogPlan | None = work.read(self.folder / PLAN)
        if plan is None:
            work.empty(self.folder)
        elif found := work.read(self.folder / WHOLE):
            self.about, self.workers, self.batch = found
            return
        elif plan.scan:
            options = replace(options, scan=True)
        try:
            self._open_and_run(plan, options)
        except RescanError:
            if options.scan:
                raise
            work.empty(self.folder)
            self._open_and_run(None, replace(options, scan=True))
        work.write(self.folder / WHOLE, (self.about, self.workers, self.batch))

    def _open_and_run(self, plan: LogPlan | None, options: "LogOptions") -> None:
        self.about = about = self._new()
        camera = f", {options.camera}" if options.camera else ""
        self.report(about, f"{self.files.name}{camera}", 0, "opening")
        with open_log(self.files, options) as log:
            about.camera, about.file_name = log.camera, self._stem(log)
            self._run(log, plan, scan=options.scan)

    def _run(self, log: "Log", begun: LogPlan | None, *, scan: bool) -> None:
        about, frames = self.about, len(log.frames)
        about.description, about.calibration = log.description, log.calibration
        about.warnings += log.description.warnings
        alone = self._alone(frames)
        self.workers = about.workers = 1 if alone else self.pool.count
        about.devices = len(self.pool.devices)
        if begun is None:
            self.report(about, log.label, frames, "looking for the floor")
        if not alone:
            self.pool.start()
        elif self.options.backend == "jax":
            start_up()
        if self.pool.devices:
            slots, self.batch = self.pool.serve(log, self.config, self.options.batch_size)
            together = slots.frames
        else:
            self.batch = self.options.batch_size or CPU_BATCH
            together = min(self.batch, max(1, frames))
        if begun is None:
            here = alone or bool(self.pool.devices)  # else this process has no need of JAX
            decide = decide_planes if here else partial(self.pool.call, decide_planes)
            planes = decide(log, self.config, self.options.backend)
            begun = self._plan(log, together, planes, scan=scan)
            self.whole.work.write(self.folder / PLAN, begun)
        plan = begun._replace(batch_size=together, folder=self.folder)
        about.ground = plan.planes.records
        about.warnings += plan.planes.warnings
        self._work_through(log, plan, alone=alone)
        notes = self._join(plan)
        about.description = log.described(total(notes))
        about.warnings += about.description.warnings[len(log.description.warnings) :]
        about.warnings += [about.floor_warning] if about.floor_warning else []

    def _work_through(self, log: "Log", plan: LogPlan, *, alone: bool) -> None:
        """Leaves the parts that are not there yet."""
        about, clock = self.about, _Clock(self.about, self.workers)
        units = []
        for unit in plan.units():
            part = Part.load(plan.folder, unit)
            if part is None:
                units.append(unit)
            else:
                about.add(part.counts)
        clock.before = about.frames
        self.report(about, log.label, len(log.frames), "starting")
        if alone:
            device = OwnDevice(self.config, self.options.backend, ahead=1)
            work = LogWork(log, plan, device).work_through(units, READ_AHEAD)
        else:
            work = self.pool.work_through(plan, units, partial(self._save, log))
        with closing(work):
            for counts in work:
                about.add(counts)
                clock.tick()
                self.report(about, log.label, len(log.frames), "")
        with writing(self.folder), ThreadPoolExecutor() as disk:  # units did not wait for it
            deque(disk.map(flush, (part_path(self.folder, unit) for unit in units)), 0)
        about.seconds = clock.seconds

    def _save(self, log: "Log", plan: LogPlan) -> "Path":
        """What workers need, in a file of its own."""
        slots = None
        if self.pool.devices:
            slots, _ = self.pool.serve(log, self.config, self.options.batch_size)
        path = self.folder / f"{os.getpid()}-{next(_numbers)}.work"
        save_work(path, log, plan, slots)
        return path

    def _stem(self, log: "Log") -> str:
        one = log.label == log.name
        return self.file_name if one else camera_file_name(self.file_name, log.camera)

    def _plan(self, log: "Log", batch: int, planes: Planes, *, scan: bool) -> LogPlan:
        """How a log is worked through; ``batch`` frames at a time."""
        count, config = self.options.pictures, self.config
        drawn = evenly(np.array(log.frames), count) if count else np.zeros(0, int)
        return LogPlan(
            self.files.name,
            log.camera,
            log.label,
            log.frames,
            config,
            self.options.backend,
            batch,
            _unit_frames(len(log.frames), batch, self.workers, self.options.backend),
            planes,
            frozenset(drawn.tolist()),
            self.folder,
            self._stem(log),
            self.observers,
            scan,
        )

    def _alone(self, frames: int) -> bool:
        """Whether this process does a log itself, as it has few frames.

        Not after a run that ended without a word: what ended it may be in the log.
        """
        if self.pool.devices or self.whole.work.taken_over:
            return False
        if self.options.workers or self.pool.started:
            return self.pool.count == 1
        return self.pool.count == 1 or frames < FRAMES_WORTH_WORKERS

    def _parts(self, plan: LogPlan) -> Iterator[Part]:
        """All parts, in order; they are there."""
        for unit in plan.units():
            part = Part.load(self.folder, unit)
            if part is None:
                (self.folder / WHOLE).unlink(missing_ok=True)  # so that the unit is done again
                path = str(part_path(self.folder, unit))
                remedy = "run the command again"
                raise OutputError("was changed or removed", path=path, remedy=remedy)
            yield part

    def _join(self, plan: LogPlan) -> list["Notes"]:
        """The parts of a log that is whole become its summary, map and what observers say.

        Returns:
            What reading told beside the frames.
        """
        about, occupancy = self.about, OccupancyMap()
        seen: dict[str, list[Any]] = {name: [] for name in plan.observers}
        notes: list[Notes] = []
        busy = about.busy_s
        about.clear()
        for part in self._parts(plan):
            about.add(part.counts)
            occupancy.merge(part.map)
            notes += part.notes
            about.pictures += part.pictures
            about.lost += [part.lost] if part.lost else []
            about.frame_errors += part.errors[: MAX_FRAME_ERRORS - len(about.frame_errors)]
            for name, made in part.seen.items():
                seen[name] += made
        about.busy_s = busy
        for name, observer in plan.observers.items():
            about.observed[name] = observer.summary(seen[name])
        self._write_map(occupancy, plan)
        return notes

    def _write_map(self, occupancy: OccupancyMap, plan: LogPlan) -> None:
        about = self.about
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
        with writing(self.folder):
            save_map(self.folder / "map.npz", image)
            write_png(self.folder / "map.png", draw_map(image, plan.label))


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
    before: int = 0
    """Frames that were there at the start."""
    units: int = 0
    first: int = 0
    """Frames of the first unit of each worker."""

    @property
    def seconds(self) -> float:
        return time.perf_counter() - self.start

    def tick(self) -> None:
        """A unit has been counted."""
        about, seconds = self.about, self.seconds
        done = about.frames - self.before
        rest, self.units = done - self.first, self.units + 1
        if self.units <= self.workers:
            self.first, about.first_batch_s = done, seconds
        elif rest >= 2 * self.first and seconds > about.first_batch_s:
            about.frames_per_s = round(rest / (seconds - about.first_batch_s), 2)
