"""A unit of work: a range of a log's frames in, a part of the results out."""

import pickle
import time
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from jaxdet.engine.device import Device, Found, OwnDevice
from jaxdet.engine.plan import LogPlan, Unit
from jaxdet.engine.station import Piped, SharedDevice, Slots
from jaxdet.render import draw_frame, write_png
from jaxdet.results.metric import rectangles
from jaxdet.results.occupancy import OccupancyMap
from jaxdet.results.rows import batch_rows
from jaxdet.results.summary import Counts
from jaxdet.results.writer import Tables, join_tables
from jaxdet.types import Detections, GroundPlane

if TYPE_CHECKING:
    from jaxdet.io import Batch, Log, Notes

Item = TypeVar("Item")
_END: Any = object()


class Part(NamedTuple):
    """What a unit leaves behind, whole or not at all, in the log's folder."""

    counts: Counts
    rows: Tables | None
    """In files of their own."""
    map: OccupancyMap
    errors: list[str]
    """Frames that could not be used, with the reason."""
    pictures: list[str]
    """Names of the pictures drawn."""
    seen: dict[str, list[Any]]
    """What each observer made of the batches."""
    notes: list["Notes"]
    """What reading told beside the frames."""

    @classmethod
    def load(cls, folder: Path, unit: Unit) -> "Part":
        """Reads the part of a unit."""
        stem = folder / f"{unit.number:08d}"
        part = pickle.loads(stem.with_suffix(".part").read_bytes())
        return part._replace(rows=Tables.load(stem))

    def save(self, folder: Path, unit: Unit) -> None:
        """Writes it, the rows first."""
        stem = folder / f"{unit.number:08d}"
        assert self.rows is not None
        self.rows.save(stem)
        rest = self._replace(rows=None)
        new = stem.with_suffix(".new")
        new.write_bytes(pickle.dumps(rest, 5))
        new.replace(stem.with_suffix(".part"))


class LogWork:
    """An open log and its plan.

    Args:
        log: The log, which this owns from now on.
        plan: What to do with it.
        device: What computes.
    """

    def __init__(self, log: "Log", plan: LogPlan, device: Device) -> None:
        self.log, self.plan, self.device = log, plan, device
        self._busy: Counter[str] = Counter()

    def work_through(
        self, units: Iterable[Unit], read_ahead: int = 0
    ) -> Generator[Counts, None, None]:
        """Leaves the part of each unit in the log's folder, in order.

        Args:
            units: Which.
            read_ahead: Batches that are read ahead in a thread; changes no result.

        Returns:
            The counts of each part.
        """
        pieces: deque[_Piece] = deque()
        building: list[_NewPart] = []
        try:
            with closing(_ahead(self._batches(units), read_ahead)) as batches:
                for unit, batch in batches:
                    pieces.append(self._start(unit, batch))
                    if len(pieces) > self.device.ahead:
                        yield from self._finish(pieces.popleft(), building)
                while pieces:
                    yield from self._finish(pieces.popleft(), building)
        finally:
            for piece in pieces:
                with suppress(Exception):
                    self.device.finish(piece.started)

    def _batches(self, units: Iterable[Unit]) -> Iterator[tuple[Unit, "Batch"]]:
        given = {"images": self.device.images} if self.device.images else {}
        for unit in units:
            batches = self.log.batches(self.plan.batch_size, unit.start, unit.stop, **given)
            while (batch := self._timed("read", next, batches, None)) is not None:
                self._busy["decode"] += batch.decoding_s  # pyright: ignore
                self._busy["read"] -= batch.decoding_s  # pyright: ignore
                yield unit, batch

    def _start(self, unit: Unit, batch: "Batch") -> "_Piece":
        numbers = batch.frames.number[: len(batch.status)].tolist()
        plane = self.plan.planes.of(batch.frames.stamp_ns)
        whole = bool(self.plan.observers) or not self.plan.drawn.isdisjoint(numbers)
        started = self._timed(
            self.device.doing, partial(self.device.start, batch, plane, whole=whole)
        )
        return _Piece(unit, numbers, batch, plane, started)

    def _finish(self, piece: "_Piece", building: list["_NewPart"]) -> Iterator[Counts]:
        """Waits for a batch; with the last one of a unit its part is whole."""
        if not building:
            building.append(_NewPart(self.plan))
        found = self._timed(self.device.doing, self.device.finish, piece.started)
        self._busy.update(found.busy_s)
        self._timed("write", building[0].add, piece, found)
        if piece.numbers[-1] + 1 == piece.unit.stop:
            part = building.pop().whole()
            self._timed("write", part.save, self.plan.folder, piece.unit)
            busy, self._busy = self._busy, Counter()
            part.counts.busy_s.update(busy)
            yield part.counts

    def _timed(self, what: str, function: Callable[..., Any], *args: Any) -> Any:
        start = time.perf_counter()
        try:
            return function(*args)
        finally:
            self._busy[what] += time.perf_counter() - start  # pyright: ignore


class _Piece(NamedTuple):
    """A batch of a unit that has been started."""

    unit: Unit
    numbers: list[int]
    """Of its frames."""
    batch: "Batch"
    plane: GroundPlane
    """The floor given to each frame."""
    started: Any
    """What the device knows it by."""


class _NewPart:
    """The part of a unit, batch by batch."""

    def __init__(self, plan: LogPlan) -> None:
        self.plan, self.rows = plan, []
        seen = {name: [] for name in plan.observers}
        self.part = Part(Counts(), None, OccupancyMap(), [], [], seen, [])

    def add(self, piece: _Piece, found: Found) -> None:
        """Uses what was found in a batch."""
        plan, part, batch = self.plan, self.part, piece.batch
        sources = plan.planes.sources(batch.frames.stamp_ns)
        rows = batch_rows(
            plan.log, plan.camera, batch, piece.plane, sources, found.inputs, plan.config
        )
        self.rows.append(Tables.of(rows.frames, rows.obstacles))
        part.counts.count(rows.frames)
        part.notes.append(batch.notes)
        part.map.add_path(batch.frames.T_world_camera)
        part.map.add(rows.obstacles["corners_world"])
        part.map.add_free(rows.free_world)
        errors = zip(piece.numbers, batch.errors, strict=True)
        part.errors.extend(f"frame {number}: {error}" for number, error in errors if error)
        if found.whole is not None:
            part.pictures.extend(self._draw(piece, found.whole, rows.plane))
            for name, observer in plan.observers.items():
                part.seen[name].append(observer(batch, found.whole))

    def whole(self) -> Part:
        """The part, when all batches are in it."""
        return self.part._replace(rows=join_tables(self.rows))

    def _draw(self, piece: _Piece, found: Detections, plane: GroundPlane) -> Iterator[str]:
        plan, frames = self.plan, piece.batch.frames._replace(plane=plane)
        corners = rectangles(found.obstacles, frames.calibration.depth_unit, plan.config.footprint)
        for row, number in enumerate(piece.numbers):
            if number in plan.drawn and frames.valid[row]:
                name = f"pictures/{plan.file_name}_{number:06d}.png"
                title = f"{plan.label}   frame {number}"
                picture = draw_frame(frames, found, corners, row, plan.config, title)
                (plan.folder / name).parent.mkdir(exist_ok=True)
                write_png(plan.folder / name, picture)
                yield name


def save_work(path: Path, log: "Log", plan: LogPlan, slots: Slots | None) -> None:
    """Writes what :func:`run_unit` needs in another process; the log's files are not in it."""
    path.write_bytes(pickle.dumps((log, plan, slots), 5))


_open: dict[Path, LogWork] = {}


def run_unit(path: Path, unit: Unit, piped: Piped | None = None) -> Counts:
    """Leaves the part of a unit in the log's folder: a function of its arguments alone.

    Args:
        path: What :func:`save_work` wrote; the log of the last call stays open.
        unit: One of the plan's.
        piped: The way to the process that computes; None: this one does.

    Returns:
        Its counts.

    Raises:
        JaxdetError: The log can't be read any more, or needs to be scanned as a whole.
    """
    if path not in _open:
        for work in _open.values():
            work.log.close()
        _open.clear()
        log, plan, slots = pickle.loads(path.read_bytes())
        own = OwnDevice(plan.config, plan.backend, ahead=0)
        _open[path] = LogWork(log, plan, SharedDevice(slots, piped) if slots and piped else own)
    (counts,) = _open[path].work_through([unit])
    return counts


def _ahead(items: Iterator[Item], depth: int) -> Generator[Item, None, None]:
    """Yields items in order, ``depth`` of them taken ahead in a thread.

    An exception is raised after the items before it. When the generator is closed the thread has
    ended, so that the source can be closed afterwards.
    """
    if not depth:
        yield from items
        return
    thread = ThreadPoolExecutor(1, "jaxdet-reader")
    try:
        waiting: deque[Future[Item]] = deque()
        while True:
            while len(waiting) <= depth:
                waiting.append(thread.submit(next, items, _END))
            item = waiting.popleft().result()
            if item is _END:
                return
            yield item
    finally:
        thread.shutdown(cancel_futures=True)
