"""One log of a run made whole: opened, planned, its units worked through and its parts joined."""

from collections.abc import Callable, Generator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import replace
from functools import cached_property
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from jaxdet.config import Config
from jaxdet.engine.device import Device, OwnDevice
from jaxdet.engine.floors import Planes, decide_planes, evenly
from jaxdet.engine.join import WHOLE, join_parts, map_files
from jaxdet.engine.memory import BATCH, IN_HAND, READ_AHEAD, Allotment, Memory, Needs
from jaxdet.engine.options import RunOptions
from jaxdet.engine.part import load_parts, part_path
from jaxdet.engine.part_store import PartStore
from jaxdet.engine.plan import LogPlan, Observer, Unit, UnitSizes
from jaxdet.engine.progress import Clock, Report
from jaxdet.engine.record import inputs_of
from jaxdet.engine.sharing import SIZES, SharedLog, send
from jaxdet.engine.startup import start_up
from jaxdet.engine.unit import LogWork
from jaxdet.engine.workspace import WorkFolder
from jaxdet.errors import ChunkMemoryError, InputError
from jaxdet.io import RescanError, open_log
from jaxdet.io.notes import total
from jaxdet.pipeline import BackendName
from jaxdet.results.durable import flush, writing
from jaxdet.results.manifest import fingerprint
from jaxdet.results.names import camera_file_name
from jaxdet.results.summary import Counts, LogSummary
from jaxdet.results.writer import ROWS_PER_GROUP

if TYPE_CHECKING:
    from jaxdet.io import Log, LogFiles, LogOptions

UNIT_FRAMES = 256
"""Most frames of a unit; neighbouring frames share chunks of the log."""
_ROW_BYTES, _COLUMN_BYTES = 4096, 9
"""Of a frame's rows, with the free floor of each pixel column, while they are packed: some are in
memory twice."""
PLAN = "plan"
"""In the folder of a log: how it is worked through."""


class RunContext(NamedTuple):
    """What the logs of a run have in common."""

    config: Config
    options: RunOptions
    observers: Mapping[str, Observer]
    work: WorkFolder
    memory: Memory
    store: PartStore | None
    """Parts that other machines leave, or are left by this one for them."""
    say: Callable[[str], None]
    """Gets what is worth knowing."""


class LogRun:
    """One log of a run, or one camera of it after the other, worked through by this process.

    Args:
        run: What it has in common with others.
        files: Of the log.
        file_name: What the names of its files begin with.
        report: Gets where it stands.
        number: Of the log, among all of the run.
        waiting: Frames of other logs whose rows wait in this process.
    """

    def __init__(
        self,
        run: RunContext,
        files: "LogFiles",
        file_name: str,
        report: Report,
        number: int = 0,
        waiting: int = 0,
    ) -> None:
        self.run, self.files, self.file_name, self.report = run, files, file_name, report
        self.number, self.waiting = number, waiting
        self.shared: SharedLog | None = None
        """Where its parts are shared with other machines, as the run's are."""
        self.fetched = 0
        """Units that another machine had done."""
        self.config, self.options = run.config, run.options
        self.memory = run.memory
        """Fewer workers have it where the log's chunks are large."""
        self.workers = 1
        """Processes that shared the frames."""
        self.others = 0
        """Processes that do others in the same memory."""
        self.batch = 0
        """Frames computed together."""
        self.allotment = Allotment(1, 0, 0)
        self.batch_done: Callable[[], object] = lambda: None
        """Called after each batch."""

    def make_whole(self, folder: Path, options: "LogOptions") -> LogSummary:
        """All parts of the log are on the disk, and its summary.

        Args:
            folder: What is done lies here.
            options: How to read.

        Raises:
            CamerasError: There are several cameras, and the options choose none.
            JaxdetError: Something else is wrong with the log or the disk.
        """
        self.folder, self.about = folder, self._new()
        work = self.run.work
        plan: LogPlan | None = work.read(folder / PLAN)
        found = None if self.options.share else work.read(folder / WHOLE)
        if found and plan is not None:
            self.about, self.workers, self.batch = found
            return self.about
        if plan and self.run.store and plan.sizes != SIZES:
            text = "is done again: parts that machines share are of other frames"
            self.run.say(f"{plan.label} {text}")
            plan = None
        if plan is None:
            work.empty(folder)
        elif plan.scan:
            options = replace(options, scan=True)
        self._run_with_retries(options)
        if not self.options.share:
            work.write(folder / WHOLE, (self.about, self.workers, self.batch))
        return self.about

    def _new(self) -> LogSummary:
        paths = (str(path.absolute()) for path in self.files.paths)  # export and verify find them
        return LogSummary(self.files.name, tuple(paths))

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
                self._use_fewer(fewer)

    def _use_fewer(self, memory: Memory) -> None:
        """The memory for fewer workers."""
        self.memory = memory

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
        self.allotment = self._allot(log, 1)
        self.workers, self.batch, _ = self.allotment
        self.about.workers = self.workers

    def _allot(self, log: "Log", workers: int) -> Allotment:
        """What so many workers on the log get of the memory."""
        batch = min(self.options.batch_size or BATCH, max(BATCH, len(log.frames)))
        waiting = min(ROWS_PER_GROUP, self.waiting + len(log.frames))
        row = _ROW_BYTES + _COLUMN_BYTES * log.depth_shape[1]
        frame = 2 * prod(log.depth_shape) + self._color_bytes(log, batch)
        needs = Needs(frame, log.index_bytes, waiting * row)
        return self.memory.allot(needs, batch, workers, log.name)

    def _color_bytes(self, log: "Log", batch: int) -> int:
        """Return how much memory colour images take, per frame that is in memory [bytes].

        All frames of the preset ``paper`` have one, else all of a batch in which one is drawn.
        """
        if self.config.cluster.points:
            camera = log.calibration.image
            return 3 * camera.height * camera.width
        if not log.has_color or log.color_shape is None:
            return 0
        batches = IN_HAND + READ_AHEAD
        drawn = -(-self.options.pictures * batches * batch // max(1, len(log.frames)))
        return -(-prod(log.color_shape) * min(drawn, batches) // batches)

    def _begin(self, log: "Log", begun: LogPlan | None, *, scan: bool) -> LogPlan:
        """The plan, and whatever works on it started; with the parts that others have left."""
        shared, shares = self.shared, self.options.share is not None
        if begun is None and shared and (planes := shared.floors()):
            begun = self._plan(log, self.batch, planes, scan=scan)
        if begun is None:
            self.report(self.about, log.label, len(log.frames), "looking for the floor")
            together = self._start(log)
            planes = self._find_planes(log, together)
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
        if self.options.backend == "jax":
            start_up()
        return self._together(log)

    def _together(self, log: "Log") -> int:
        """Frames that are read together by who computes them."""
        return min(self.batch, max(1, len(log.frames)))

    @cached_property
    def device(self) -> Device:
        """What this process computes on."""
        return OwnDevice(self.config, self.options.backend, ahead=1)

    def _find_planes(self, log: "Log", at_once: int) -> Planes:
        """What is known of the floor of its frames before they are looked at."""
        given = log, self.config, self.options.backend, None, at_once
        return decide_planes(*given, alive=self.batch_done, find=self.device.find_floors)

    def _left(self, log: "Log") -> list[Unit]:
        """The units of this run's share that are not in the place for them."""
        assert self.shared is not None
        return self.shared.left(log.frames)

    def _work_through(self, log: "Log", plan: LogPlan) -> list[Path]:
        """Leaves the parts that are not there yet; these may not be on the disk so far."""
        about, clock = self.about, Clock(self.about, self.about.workers)
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
        with closing(self._counts(log, plan, units)) as work:
            for counts in work:
                about.add(counts)
                clock.tick()
                self.report(about, log.label, total, "")
        about.seconds = clock.seconds
        return [part_path(self.folder, unit) for unit in units]

    def _counts(
        self, log: "Log", plan: LogPlan, units: list[Unit]
    ) -> Generator[Counts, None, None]:
        """The counts of units, each as its part is there."""
        work = LogWork(log, plan, self.device)
        work.batch_done = self.batch_done
        return work.work_through(units, self.allotment.read_ahead)

    def _join(self, log: "Log", plan: LogPlan, parts: list[Path]) -> None:
        """The parts become the summary and the map, and are on the disk as these are."""
        about = self.about
        with ThreadPoolExecutor(1) as disk:  # units did not wait for it
            flushed = disk.submit(flush, *parts)
            notes = join_parts(plan, about, self.memory.room, self.others)
            files = (self.folder / name for name in about.pictures)
            with writing(self.folder):
                flush(*files, *map_files(about, self.folder).values())
                flushed.result()
        before = len(log.description.warnings)
        about.description = log.described(total(notes))
        about.warnings += about.description.warnings[before:]
        own = about.color_warning, about.depth_warning, about.floor_warning, about.tilt_warning
        about.warnings += filter(None, own)

    def _stem(self, log: "Log") -> str:
        one = log.label == log.name
        return self.file_name if one else camera_file_name(self.file_name, log.camera)

    def _plan(self, log: "Log", batch: int, planes: Planes, *, scan: bool) -> LogPlan:
        """How a log is worked through; ``batch`` frames at a time."""
        count, config, sizes = self.options.pictures, self.config, SIZES
        if self.shared is None:
            workers = self.about.workers
            sizes = _unit_sizes(len(log.frames), batch, workers, self.options.backend)
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


def _unit_sizes(frames: int, batch: int, workers: int, backend: BackendName) -> UnitSizes:
    """Whole batches, and enough units to keep all workers busy to the end."""
    most = UNIT_FRAMES if backend == "jax" else batch
    batches = max(1, min(most, frames // (4 * workers)) // batch)
    end_frames = workers * batches * batch if workers > 1 else 0
    return UnitSizes(batches * batch, end_frames, max(1, batches // 4) * batch)
