"""One log of a run: opened, planned, and its units worked through."""

import itertools
import os
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing
from dataclasses import replace
from functools import partial
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from jaxdet.config import Config
from jaxdet.engine import pool
from jaxdet.engine.device import OwnDevice
from jaxdet.engine.floors import Planes, decide_planes, evenly
from jaxdet.engine.join import WHOLE, add_rows, join_parts, map_files, parts_of
from jaxdet.engine.memory import BATCH, Allotment, Memory, Needs
from jaxdet.engine.options import RunOptions
from jaxdet.engine.part import load_parts, part_path
from jaxdet.engine.part_store import PartStore
from jaxdet.engine.plan import LogPlan, Observer, Unit, UnitSizes
from jaxdet.engine.pool import Pool
from jaxdet.engine.progress import Clock, Report
from jaxdet.engine.record import inputs_of
from jaxdet.engine.sharing import SIZES, SharedLog, send
from jaxdet.engine.slots import Slots
from jaxdet.engine.startup import start_up
from jaxdet.engine.unit import LogWork
from jaxdet.engine.watch import watched
from jaxdet.engine.worker import decide_floors, save_work
from jaxdet.engine.workspace import Workspace
from jaxdet.errors import CamerasError, ChunkMemoryError, InputError, JaxdetError, OutputError
from jaxdet.io import RescanError, open_log
from jaxdet.io.notes import total
from jaxdet.pipeline import BackendName
from jaxdet.results.durable import flush, writing
from jaxdet.results.fault import fault_text
from jaxdet.results.manifest import fingerprint
from jaxdet.results.names import camera_file_name
from jaxdet.results.summary import LogSummary, Summary
from jaxdet.results.writer import ROWS_PER_GROUP, ResultWriter

if TYPE_CHECKING:
    from jaxdet.io import Log, LogFiles, LogOptions

FRAMES_WORTH_WORKERS = 500
"""Fewer are done sooner by this process than workers have started."""
UNIT_FRAMES = 256
"""Most frames of a unit; neighbouring frames share chunks of the log."""
_ROW_BYTES, _COLUMN_BYTES = 4096, 9
"""Of a frame's rows, with the free floor of each pixel column, while they are packed: some are in
memory twice."""
PLAN = "plan"
"""In the folder of a log: how it is worked through."""

_numbers = itertools.count()
"""Of the files that workers are given."""


class RunContext(NamedTuple):
    """What the logs of a run have in common."""

    config: Config
    options: RunOptions
    observers: Mapping[str, Observer]
    work: Workspace
    summary: Summary
    files: dict[str, Path]
    """Of the results, by their names there."""
    memory: Memory
    pool: Pool
    writer: ResultWriter
    store: PartStore | None
    """Parts that other machines leave, or are left by this one for them."""
    say: Callable[[str], None]
    """Gets what is worth knowing."""


class LogRun:
    """One log of a run, or one camera of it after the other."""

    def __init__(
        self, run: RunContext, files: "LogFiles", file_name: str, report: Report, number: int = 0
    ) -> None:
        self.run, self.files, self.file_name, self.report = run, files, file_name, report
        self.number = number
        self.shared: SharedLog | None = None
        """Where its parts are shared with other machines, as the run's are."""
        self.fetched = 0
        """Units that another machine had done."""
        self.config, self.options, self.pool = run.config, run.options, run.pool
        self.memory = run.memory
        """Fewer workers have it where the log's chunks are large."""
        self.workers = 1
        """Processes that shared the frames."""
        self.batch = 0
        """Frames computed together."""
        self.alone = True
        """This process does the log itself."""
        self.allotment = Allotment(1, 0, 0)

    def take(self, folder: Path, log_options: "LogOptions") -> LogSummary:
        """The rows, pictures and map are in the results, or there is an error.

        Args:
            folder: What is done lies here.
            log_options: How to read.

        Raises:
            CamerasError: There are several cameras, and the options choose none.
            OutputError: The disk is full or broken, or there is no memory for the rows.
        """
        self.folder, self.about, summary = folder, self._new(), self.run.summary
        try:
            self._make_whole(log_options)
        except (OutputError, CamerasError):
            raise
        except Exception as error:
            self.about.error = str(error)
            if not isinstance(error, JaxdetError):
                self.about.error = f"{self.files.name}: {type(error).__name__}: {error}"
            if not isinstance(error, JaxdetError) or hasattr(error, "__notes__"):
                report = f"report_{self.about.file_name or self.file_name}.txt"
                self.about.error += f"; a fault of jaxdet: please send its developers {report}"
                self.run.files[report] = path = self.run.work.result / report
                with writing(path):
                    path.write_text(fault_text(error, self.files.paths), encoding="utf-8")
        # What fails from here on ends the run: rows that are once in a table stay there.
        if not (self.about.error or self.options.share):
            self._add_results()
        summary.workers = max(summary.workers, self.workers)
        summary.batch_size = max(summary.batch_size, self.batch)
        return self.about

    def _add_results(self) -> None:
        """Rows, pictures and map of a log that is whole go into the results."""
        plan: LogPlan = self.run.work.read(self.folder / PLAN)
        parts = parts_of(plan._replace(folder=self.folder))
        add_rows(self.run.writer, (part.rows for part in parts), self.files.name)
        self.run.files.update({name: self.folder / name for name in self.about.pictures})
        self.run.files.update(map_files(self.about, self.folder))

    def _new(self) -> LogSummary:
        paths = (str(path.absolute()) for path in self.files.paths)  # export and verify find them
        return LogSummary(self.files.name, tuple(paths))

    def _make_whole(self, options: "LogOptions") -> None:
        """All parts are on the disk, and the summary."""
        work = self.run.work
        plan: LogPlan | None = work.read(self.folder / PLAN)
        found = None if self.options.share else work.read(self.folder / WHOLE)
        if found and plan is not None:
            self.about, self.workers, self.batch = found
            return
        if plan and self.run.store and plan.sizes != SIZES:
            text = "is done again: parts that machines share are of other frames"
            self.run.say(f"{plan.label} {text}")
            plan = None
        if plan is None:
            work.empty(self.folder)
        elif plan.scan:
            options = replace(options, scan=True)
        self._run_with_retries(options)
        if not self.options.share:
            work.write(self.folder / WHOLE, (self.about, self.workers, self.batch))

    def _run_with_retries(self, options: "LogOptions") -> None:
        """Scans it where its index is wrong, and takes fewer workers where its chunks are large."""
        while True:
            try:
                self._open_and_run(self.run.work.read(self.folder / PLAN), options)
                return
            except RescanError:
                if options.scan:
                    raise
                self.run.work.empty(self.folder)
                options = replace(options, scan=True)
            except ChunkMemoryError:
                fewer = self.memory.with_fewer_workers()
                if fewer is None:
                    raise
                self.memory = fewer
                self.pool.resize(fewer.workers)

    def _open_and_run(self, plan: LogPlan | None, options: "LogOptions") -> None:
        self.about = about = self._new()
        camera = f", {options.camera}" if options.camera else ""
        self.report(about, f"{self.files.name}{camera}", 0, "opening")
        if self.run.store:
            share = self.number, *self.options.share_numbers
            self.shared = SharedLog(self.run.store, self.folder, share, scan=options.scan)
        with open_log(self.files, options, self.memory.reading) as log:
            self._check_unchanged()  # from now on the open log sees a change itself
            about.camera, about.file_name = log.camera, self._stem(log)
            if not self.options.share or self._left(log):
                self._run(log, plan, scan=options.scan)

    def _check_unchanged(self) -> None:
        """Makes sure that the files are those that the manifest names.

        Raises:
            InputError: One is not.
        """
        for path, was in inputs_of(self.run.work.record, self.files):
            if fingerprint(path) != was:
                problem = "was changed since the run began"
                remedy = "read it again when nothing writes to it"
                raise InputError(problem, path=str(path), remedy=remedy)

    def _run(self, log: "Log", begun: LogPlan | None, *, scan: bool) -> None:
        about = self.about
        about.description, about.calibration = log.description, log.calibration
        about.warnings += log.description.warnings
        about.notes += log.description.notes
        self._decide_how(log)
        plan = self._begin(log, begun, scan=scan)
        about.ground = plan.planes.records
        about.warnings += plan.planes.warnings
        parts = self._work_through(log, plan)
        if self.options.share:
            about.lost += [f"{plan.where(unit)}: not in {plan.store}" for unit in self._left(log)]
        else:
            self._join(log, plan, parts)

    def _decide_how(self, log: "Log") -> None:
        """Who works on the log, and on how much of it at a time."""
        alone = self._alone(len(log.frames))
        self.allotment = self._allot(log, 1 if alone else self.memory.workers)
        self.workers, self.batch, _ = self.allotment
        self.alone = alone or (self.workers == 1 and not self._kept_apart)
        self.pool.resize(self.workers)
        self.about.workers, self.about.devices = self.workers, len(self.pool.devices)

    def _join(self, log: "Log", plan: LogPlan, parts: list[Path]) -> None:
        """The parts become the summary and the map, and are on the disk as these are."""
        about = self.about
        with ThreadPoolExecutor(1) as disk:  # units did not wait for it
            flushed = disk.submit(flush, *parts)
            notes = join_parts(plan, about, self.memory.room)
            files = (self.folder / name for name in about.pictures)
            with writing(self.folder):
                flush(*files, *map_files(about, self.folder).values())
                flushed.result()
        before = len(log.description.warnings)
        about.description = log.described(total(notes))
        about.warnings += about.description.warnings[before:]
        own = about.pairs_warning, about.depth_warning, about.floor_warning, about.tilt_warning
        about.warnings += filter(None, own)

    def _begin(self, log: "Log", begun: LogPlan | None, *, scan: bool) -> LogPlan:
        """The plan, and whatever works on it started; with the parts that others have left."""
        shared, shares = self.shared, self.options.share is not None
        if begun is None and shared and (planes := shared.floors()):
            begun = self._plan(log, self.batch, planes, scan=scan)
        if begun is None:
            self.report(self.about, log.label, len(log.frames), "looking for the floor")
            together = self._start(log)
            here = self.alone or bool(self.pool.devices)  # else this process has no need of JAX
            decide = decide_planes if here else partial(self.pool.call, decide_floors)
            planes = decide(log, self.config, self.options.backend, None, self.batch)
            begun = self._plan(log, together, planes, scan=scan)
            if shared and shares:
                shared.keep_floors(planes)
        begun = begun._replace(folder=self.folder)
        if shared and not shares:
            self.fetched += shared.fetch(begun)
            if all(part for _, part in load_parts(self.folder, begun.units())):
                return begun
        together = self._start(log)
        store = shared.store if shared and shares else None
        return begun._replace(batch_size=together, store=store)

    def _start(self, log: "Log") -> int:
        """Starts what computes, if it isn't there; returns how many frames are read together."""
        if not self.alone:
            self.pool.start()
        elif self.options.backend == "jax":
            start_up()
        if self.pool.devices:
            slots, self.batch = self._serve(log)
            return slots.frames
        return min(self.batch, max(1, len(log.frames)))

    def _left(self, log: "Log") -> list[Unit]:
        """The units of this run's share that are not in the place for them."""
        assert self.shared is not None
        return self.shared.left(log.frames)

    def _work_through(self, log: "Log", plan: LogPlan) -> list[Path]:
        """Leaves the parts that are not there yet; these may not be on the disk so far."""
        about, clock = self.about, Clock(self.about, self.workers)
        units, mine = [], self._left(log) if plan.store else list(plan.units())
        for unit, part in load_parts(plan.folder, mine):
            if part is None:
                units.append(unit)
            else:
                about.add(part.counts)
                if plan.store:
                    send(plan.store, plan, unit)
        clock.before = about.frames
        total = sum(len(range(unit.start, unit.stop, log.frames.step)) for unit in mine)
        self.report(about, log.label, total, "starting")
        with ExitStack() as ends:
            if self.alone:
                device = OwnDevice(self.config, self.options.backend, ahead=1)
                own = LogWork(log, plan, device)
                late = partial(self._say_late, log.label)
                own.batch_done = ends.enter_context(watched(pool.NO_PROGRESS_S, late))
                work = own.work_through(units, self.allotment.read_ahead)
            else:
                work = self.pool.work_through(plan, units, partial(self._save, log))
            ends.enter_context(closing(work))
            for counts in work:
                about.add(counts)
                clock.tick()
                self.report(about, log.label, total, "")
        about.seconds = clock.seconds
        return [part_path(self.folder, unit) for unit in units]

    def _say_late(self, label: str) -> None:
        """What a user can do whose run hangs, but wait."""
        self.run.say(
            f"{label}: no frame was finished for {pool.NO_PROGRESS_S:g} s; if that is not the "
            f"disk, kill this process (kill -9 {os.getpid()}) and repeat the command: workers, "
            "which have a time limit, do the log then"
        )

    def _save(self, log: "Log", plan: LogPlan) -> Path:
        """What workers need, in a file of its own."""
        slots = self._serve(log)[0] if self.pool.devices else None
        path = self.folder / f"{os.getpid()}-{next(_numbers)}.work"
        save_work(path, log, plan, slots)
        return path

    def _allot(self, log: "Log", workers: int) -> Allotment:
        """What so many workers on the log get of the memory."""
        color, depth = log.image_shapes
        batch = min(self.options.batch_size or BATCH, max(BATCH, len(log.frames)))
        waiting = min(ROWS_PER_GROUP, self.run.summary.frames + len(log.frames))
        row = _ROW_BYTES + _COLUMN_BYTES * depth[1]
        needs = Needs(prod(color) + 2 * prod(depth), log.index_bytes, waiting * row)
        return self.memory.allot(needs, batch, workers, log.name)

    def _serve(self, log: "Log") -> tuple[Slots, int]:
        return self.pool.serve(log, self.config, self.options.batch_size, self.allotment.batch)

    def _stem(self, log: "Log") -> str:
        one = log.label == log.name
        return self.file_name if one else camera_file_name(self.file_name, log.camera)

    def _plan(self, log: "Log", batch: int, planes: Planes, *, scan: bool) -> LogPlan:
        """How a log is worked through; ``batch`` frames at a time."""
        count, config, sizes = self.options.pictures, self.config, SIZES
        if self.shared is None:
            sizes = _unit_sizes(len(log.frames), batch, self.workers, self.options.backend)
        drawn = evenly(np.array(log.frames), count) if count else np.zeros(0, int)
        plan = LogPlan(
            self.files.name,
            log.camera,
            log.label,
            log.frames,
            config,
            self.options.backend,
            batch,
            sizes,
            planes,
            frozenset(drawn.tolist()),
            self.folder,
            self._stem(log),
            self.run.observers,
            scan,
        )
        self.run.work.write(self.folder / PLAN, plan)
        return plan

    @property
    def _kept_apart(self) -> bool:
        """Whether this process leaves logs to others, whatever their size.

        So after a run that ended without a word: what ended it may be in the log.
        """
        return bool(self.pool.devices) or self.memory.apart

    def _alone(self, frames: int) -> bool:
        """Whether this process does a log itself, as it has few frames."""
        if self._kept_apart:
            return False
        one = self.memory.workers == 1
        return one or not (
            self.options.workers or self.pool.started or frames >= FRAMES_WORTH_WORKERS
        )


def _unit_sizes(frames: int, batch: int, workers: int, backend: BackendName) -> UnitSizes:
    """Whole batches, and enough units to keep all workers busy to the end."""
    most = UNIT_FRAMES if backend == "jax" else batch
    batches = max(1, min(most, frames // (4 * workers)) // batch)
    end_frames = workers * batches * batch if workers > 1 else 0
    return UnitSizes(batches * batch, end_frames, max(1, batches // 4) * batch)
