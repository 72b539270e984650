"""Processing of a log, from its files to the folder of its results, by one or more processes."""

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from jaxdet.engine.device import out_of_memory
from jaxdet.engine.executors import Executor, Host, InProcess
from jaxdet.engine.floors import Planes, evenly
from jaxdet.engine.memory import Memory
from jaxdet.engine.own_body import own_body_note
from jaxdet.engine.placement import OtherCameraError, share_of_worker
from jaxdet.engine.plan import UNIT_FRAMES, LogPlan, divide
from jaxdet.engine.settings import RunSettings
from jaxdet.engine.unit_result import Assembly
from jaxdet.engine.worker import WorkerProcess
from jaxdet.errors import (
    CamerasError,
    ChunkMemoryError,
    InputError,
    JaxdetError,
    OutputError,
    RescanError,
    WorkerStartError,
)
from jaxdet.io import open_log
from jaxdet.io.timeline import total
from jaxdet.memory import size_text
from jaxdet.render import draw_map, write_png
from jaxdet.results.durable import flush_folder, remove, writing
from jaxdet.results.json_files import write_json
from jaxdet.results.layout import CONFIG, FAILED, REPORT, SUMMARY
from jaxdet.results.manifest import fingerprint, write_manifest
from jaxdet.results.names import camera_name, export_name
from jaxdet.results.occupancy import MAX_CELLS, OccupancyMap, save_map
from jaxdet.results.summary import LogSummary, Summary, failure_record
from jaxdet.results.versions import crash_report
from jaxdet.results.writer import TableWriter

if TYPE_CHECKING:
    from jaxdet.engine.slots import Served
    from jaxdet.io import Log, LogFiles, LogOptions
    from jaxdet.types import Calibration

_CELL_BYTES = 28
"""Memory per cell while a map is made and drawn: four numbers of 4 bytes, copies of some of them,
and a pixel [bytes]."""


def process_log(
    settings: RunSettings, files: "LogFiles", folder: Path, host: Host
) -> list[LogSummary]:
    """Write the results of a log into a new folder.

    When this returns, the folder is on the disk with ``manifest.json``, or with ``failed.json`` if
    every camera of the log failed.

    Args:
        settings: Settings of the run.
        files: The log.
        folder: New folder; temporary files are in ``FOLDER~CAMERA.rows`` next to it.
        host: The current process.

    Returns:
        Summaries of the log's cameras.

    Raises:
        OutputError: The disk is full or broken, or there is no memory for the rows.
    """
    with writing(folder):
        folder.mkdir()
    inputs = [fingerprint(path) for path in files.paths]
    given = settings, files, folder, host, inputs
    with ExitStack() as stack:

        def run(options: "LogOptions", camera: str = "") -> CameraRun:
            one = CameraRun(*given, camera)
            stack.callback(lambda: one.assembly.close())
            one.run(options)
            return one

        options = settings.log_options
        try:
            cameras = [run(options)]
        except CamerasError as error:
            cameras = [run(replace(options, camera=name), name) for name in error.cameras]
        done = [one for one in cameras if not one.about.error]
        if options.camera is None:
            for about in (one.about for one in done if one.about.description):
                about.cameras_left_out = list(about.description.cameras_left_out)
        abouts = [one.about for one in cameras]
        about = {"log": files.name, "inputs": inputs, **settings.about}
        if done:
            summary = Summary(
                settings.options.backend,
                batch_size=max(one.batch for one in cameras),
                logs=abouts,
                seconds=sum(about.seconds for about in abouts),
                workers=max(about.workers for about in abouts),
            )
            config = {**settings.record["config"], "batch_size": summary.batch_size}
            _write_results(folder, config, summary.to_dict(), done, about)
        else:
            remove(folder / "pictures")
            write_failure(folder, about, abouts)
    with writing(folder):
        flush_folder(folder)
    return abouts


def write_failure(folder: Path, about: dict[str, Any], logs: list[LogSummary]) -> None:
    """Write ``failed.json`` with the manifest's entries ``about`` and the cameras' summaries."""
    write_json(folder / FAILED, failure_record(about, logs))


def _write_results(
    folder: Path,
    config: dict[str, Any],
    summary: dict[str, Any],
    cameras: list["CameraRun"],
    about: dict[str, Any],
) -> None:
    """Write tables, JSON files and the manifest."""
    with TableWriter(folder) as writer:
        try:
            for one in cameras:
                for rows in one.assembly.rows():
                    writer.add(rows)
        except MemoryError as error:
            problem, remedy = "no memory for its rows", "end other programs"
            raise OutputError(problem, path=str(folder), remedy=remedy) from error
        writer.close(config, summary)
    write_json(folder / CONFIG, config)
    write_json(folder / SUMMARY, summary)
    with writing(folder):
        write_manifest(folder, about)


@dataclass
class CameraRun:
    """Processing of one camera of a log; fields are arguments of :func:`process_log`."""

    settings: RunSettings
    files: "LogFiles"
    folder: Path
    host: Host
    inputs: list[dict[str, Any]]
    """Fingerprints of the log's files."""
    camera: str = ""
    """Name of the camera if the log has several."""
    batch: int = 0
    """Number of frames computed together."""

    def __post_init__(self) -> None:
        self.part = camera_name(self.camera) if self.camera else ""
        """Camera's part of file names if the log has several cameras."""
        self.scratch = self.folder.with_name(f"{self.folder.name}~{self.part}.rows")
        self.memory = self.host.memory
        self._begin()

    def _begin(self) -> None:
        """Begin with an empty summary and no rows."""
        # Paths are absolute, so that export and verify find the files from any folder.
        paths = (str(path.absolute()) for path in self.files.paths)
        self.about = LogSummary(self.files.name, tuple(paths))
        self.about.file_name = export_name(self.files.name, self.camera)
        self.assembly = Assembly(self.scratch, self.about)

    def run(self, options: "LogOptions") -> None:
        """Process all frames of the camera; an error of the log is recorded in the summary.

        Raises:
            CamerasError: There are several cameras, and the options don't choose one.
            OutputError: The disk is full or broken.
            WorkerStartError: Workers can't be started.
        """
        try:
            self._run_with_retries(options)
        except (OutputError, CamerasError, WorkerStartError):
            raise
        except Exception as error:
            if self.host.log_per_worker:
                raise
            if out_of_memory(error):
                remedy = "pass a smaller --batch-size or --memory, or end other programs"
                error = InputError("not enough memory", path=self.files.name, remedy=remedy)
            self._fail(error)

    @property
    def _prefix(self) -> str:
        return self.part and f"{self.part}_"

    def _fail(self, error: Exception) -> None:
        """Record why the log failed; write a crash report if the cause is a bug in jaxdet."""
        text = str(error)
        if not isinstance(error, JaxdetError):
            text = f"{self.files.name}: {type(error).__name__}: {error}"
        if not isinstance(error, JaxdetError) or hasattr(error, "__notes__"):
            path = self.folder / f"{self._prefix}{REPORT}"
            with writing(path):
                path.write_text(crash_report(error, self.files.paths), encoding="utf-8")
            where = f"{self.folder.name}/{path.name}"
            text += f"; a fault of jaxdet: please send its developers {where}"
        self.about.error = text

    def _run_with_retries(self, options: "LogOptions") -> None:
        """Process the log; scan it if its index is wrong, use fewer workers if chunks are large."""
        while True:
            try:
                label = ", ".join(filter(None, (self.files.name, self.camera)))
                self.host.report(self.about, label, 0, "opening")
                with open_log(self.files, options, self.memory.reading) as log:
                    self._check_unchanged()  # later changes are noticed by the open log
                    self._run(log)
                return
            except RescanError:
                if options.scan:
                    raise
                options = replace(options, scan=True)
            except ChunkMemoryError:
                fewer = None if self.host.log_per_worker else self.memory.with_fewer_workers()
                if fewer is None:
                    raise
                self.memory = fewer
            self.assembly.close()
            self._begin()

    def _check_unchanged(self) -> None:
        """Check that the files still have the fingerprints that the manifest will list.

        Raises:
            InputError: A file was changed or can't be read.
        """
        for path, was in zip(self.files.paths, self.inputs, strict=True):
            now = fingerprint(path)
            if "fingerprint" not in now:
                raise InputError("can't be read any more", path=str(path), remedy="check the disk")
            if now != was:
                problem = "was changed since the run began"
                remedy = "read it again when nothing writes to it"
                raise InputError(problem, path=str(path), remedy=remedy)

    def _run(self, log: "Log") -> None:
        about = self.about
        about.camera = log.camera
        if log.label != log.name:
            self.part = camera_name(log.camera)
            about.file_name = export_name(log.name, log.camera)
        about.description, about.calibration = log.description, log.calibration
        about.warnings += log.description.warnings
        about.notes += log.description.notes
        executor = self.host.executor(log, self.memory)
        about.workers, about.devices = executor.share.workers, self.memory.devices
        self.host.report(about, log.label, len(log.frames), "looking for the floor")
        planes = executor.find_planes()
        self.batch = executor.share.batch
        about.ground = planes.records
        about.warnings += planes.warnings
        plan = self._plan(log, min(executor.share.read, max(1, len(log.frames))), planes)
        self._work(log, plan, executor)
        notes = self.assembly.finish(self.settings.observers)
        source, *splits = self.files.paths
        source = str(source.parent if splits else source)
        body = own_body_note(log, self.settings.config, planes, self.assembly.rows(), source)
        about.notes += [body] if body else []
        if self.settings.options.map:
            self._write_map(self.assembly.map, log)
        before = len(log.description.warnings)
        about.description = log.described(total(notes))
        about.warnings += about.description.warnings[before:]
        own = about.color_warning, about.depth_warning, about.floor_warning, about.tilt_warning
        about.warnings += filter(None, own)

    def _plan(self, log: "Log", batch: int, planes: Planes) -> LogPlan:
        """Return the plan of the log, with ``batch`` frames per batch."""
        count = self.settings.options.pictures
        drawn = evenly(np.array(log.frames), count) if count else np.zeros(0, int)
        return LogPlan(
            settings=self.settings,
            batch_size=batch,
            planes=planes,
            drawn=frozenset(drawn.tolist()),
            folder=self.folder,
            scratch=self.scratch,
            picture=self._prefix,
        )

    def _work(self, log: "Log", plan: LogPlan, executor: Executor) -> None:
        """Process all units of the log, and collect their results."""
        about, workers, count = self.about, executor.share.workers, len(log.frames)
        most = UNIT_FRAMES if self.settings.options.backend == "jax" else plan.batch_size
        units = divide(log.frames, plan.batch_size, workers, most)
        start, first = time.perf_counter(), 0
        self.host.report(about, log.label, count, "starting")
        with closing(executor.work(plan, units)) as parts:
            for number, (unit, part) in enumerate(parts, 1):
                self.assembly.add(unit, part)
                seconds = time.perf_counter() - start
                if number <= workers:  # the first unit of a worker takes longer, as it compiles
                    first, about.first_batch_s = about.frames, seconds
                elif about.frames >= 3 * first and seconds > about.first_batch_s:
                    rate = (about.frames - first) / (seconds - about.first_batch_s)
                    about.frames_per_s = round(rate, 2)
                self.host.report(about, log.label, count, "")
        about.seconds = time.perf_counter() - start

    def _write_map(self, occupancy: OccupancyMap, log: "Log") -> None:
        """Write the map, or record why the log has no map."""
        about, size = self.about, _CELL_BYTES * occupancy.cells
        room = self.memory.room // (self.memory.workers if self.host.log_per_worker else 1)
        if not any(path.size for path in occupancy.path):
            about.notes.append("no map: no frame has a pose")
            return
        if occupancy.skipped:
            about.warnings.append(f"{occupancy.skipped} outlines or views have no place on the map")
        if size > room and occupancy.cells <= MAX_CELLS:
            if self.host.log_per_worker:
                raise MemoryError("not enough for as many maps at a time")
            about.warnings.append(f"no map: it takes {size_text(size)}; pass --memory more")
            return
        image = occupancy.image()
        if image is None:
            self._say_why(occupancy)
            return
        about.map = f"map_{self.part}" if self.part else "map"
        with writing(self.folder):
            save_map(self.folder / f"{about.map}.npz", image)
            write_png(self.folder / f"{about.map}.png", draw_map(image, log.label))

    def _say_why(self, occupancy: OccupancyMap) -> None:
        """Record why there is no map although frames have poses."""
        about, floors = self.about, self.about.floor_sources
        if occupancy.cells:
            about.warnings.append("no map: what was seen is too far apart for one")
        elif self.settings.config.ground.source == "none":
            about.notes.append("no map: no floor was looked for (--ground.source none)")
        elif floors and floors.total() == floors["none"]:
            about.warnings.append("no map: no frame's floor is known")
        else:
            about.warnings.append("no map: nothing was seen in the world")


class LogTask(NamedTuple):
    """Task of a worker: one log."""

    files: "LogFiles"
    folder: Path
    """New folder for its results."""


class LogJob(NamedTuple):
    """Job whose tasks are logs; each worker processes one log at a time.

    If a worker can't process a log, the first process tries it again, and reports the error if that
    fails too.
    """

    settings: RunSettings
    memory: Memory
    """Memory of the run, of which each worker takes its share."""
    served: "Served | None"
    """Format of the frames that GPUs compute; None if workers compute."""

    @contextmanager
    def open(self, process: WorkerProcess) -> Iterator[Callable[[LogTask], Any]]:
        """Return :meth:`process` for tasks."""
        yield partial(self.process, process)

    def process(
        self, process: WorkerProcess, task: LogTask
    ) -> "list[LogSummary] | Calibration | None":
        """Write the results of a log, see :func:`process_log`.

        Returns:
            The summaries of its cameras; its calibration if GPUs compute for another camera; None
            if the first process has to process the log.
        """
        try:
            host = Host(self.memory, partial(self.executor, process), log_per_worker=True)
            return process_log(self.settings, *task, host)
        except OtherCameraError as error:
            return error.calibration
        except Exception:
            return None

    def executor(self, process: WorkerProcess, log: "Log", memory: Memory) -> InProcess:
        """Return the executor of a worker, with its share of the memory."""
        share = share_of_worker(self.settings, log, memory, self.served)
        device = process.device(self.served, self.settings)
        alive = process.report_progress
        return InProcess(self.settings, log, share, device, alive)
