"""Processing of a unit: a range of a log's frames is read, computed and converted to rows."""

import time
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import suppress
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from jaxdet.engine.color import method_frames, shown_color
from jaxdet.engine.device import Device, Found
from jaxdet.engine.plan import LogPlan, Unit
from jaxdet.engine.startup import computing
from jaxdet.engine.unit_result import UnitResult, rows_path
from jaxdet.floor.plane import join_planes
from jaxdet.pipeline import detect_on_cpu
from jaxdet.render import draw_frame, write_png
from jaxdet.results.durable import writing
from jaxdet.results.metric import rectangles
from jaxdet.results.occupancy import OccupancyMap
from jaxdet.results.rows import (
    batch_rows,
    joined_inputs,
    no_inputs,
    shown_planes,
    used_slots,
)
from jaxdet.results.summary import Counts
from jaxdet.results.tables import Tables
from jaxdet.types import Detections, Frames, GroundPlane

if TYPE_CHECKING:
    from jaxdet.engine.worker import Lost
    from jaxdet.io import Batch, Log


class UnitProcessor:
    """Processes units of an open log.

    Args:
        log: The log.
        plan: Plan of the log.
        device: Device that computes.
        batch_done: Called after each batch.
    """

    def __init__(
        self, log: "Log", plan: LogPlan, device: Device, batch_done: Callable[[], object]
    ) -> None:
        self.log, self.plan, self.device = log, plan, device
        self._batch_done = batch_done
        self._busy: Counter[str] = Counter()

    def process_unit(self, unit: Unit) -> UnitResult:
        """Return the result of a unit.

        Raises:
            JaxdetError: The log can't be read any more, or its index is wrong.
            OutputError: The disk is full or broken.
        """
        ((_, result),) = self.process_units([unit])
        return result

    def process_units(
        self, units: Iterable[Unit]
    ) -> Generator[tuple[Unit, UnitResult], None, None]:
        """Yield units with their results, in order; a batch is read while others are computed."""
        in_flight: deque[_InFlight] = deque()
        try:
            for builder, batch in self._batches(units):
                in_flight.append(self._start(builder, batch))
                if len(in_flight) > self.device.ahead:
                    yield from self._finish(in_flight.popleft())
            while in_flight:
                yield from self._finish(in_flight.popleft())
        finally:
            for one in in_flight:
                with suppress(Exception):
                    self.device.finish(one.started)

    def mark_lost(self, unit: Unit, lost: "Lost") -> UnitResult:
        """Return the result of a unit that can't be processed: rows with a status, no obstacles.

        No image is read.

        Args:
            unit: The unit.
            lost: Status of its frames, and the reason.
        """
        plan, builder = self.plan, _ResultBuilder(self.plan, unit)
        numbers = [number for number in plan.frames if unit.start <= number < unit.stop]
        for first in range(0, len(numbers), plan.batch_size):
            some = numbers[first : first + plan.batch_size]
            batch = self.log.without_images(some, lost.status, lost.reason)
            plane = plan.planes.of(batch.frames.stamp_ns)
            one = _InFlight(builder, some, batch, plane, None)
            builder.add(one, Found(no_inputs(len(some))))
        text = f"{plan.where(unit)}: {lost.status} ({lost.reason})"
        return builder.complete()._replace(errors=[], lost=text)

    def _batches(self, units: Iterable[Unit]) -> Iterator[tuple["_ResultBuilder", "Batch"]]:
        """Yield the batches of units, each with the builder of its unit's result."""
        plan = self.plan
        color = shown_color(plan.config, plan.observers.values(), plan.drawn)
        given = {"images": self.device.images, "color": color}
        given["need_color"] = plan.config.cluster.points
        for unit in units:
            builder = _ResultBuilder(plan, unit)
            batches = self.log.batches(plan.batch_size, unit.start, unit.stop, **given)
            while (batch := self._timed("read", next, batches, None)) is not None:
                self._busy["decode"] += batch.decoding_s
                self._busy["read"] -= batch.decoding_s
                yield builder, batch

    def _start(self, builder: "_ResultBuilder", batch: "Batch") -> "_InFlight":
        numbers = batch.frames.number[: len(batch.status)].tolist()
        plane = self.plan.planes.of(batch.frames.stamp_ns)
        started = self._timed(self.device.doing, self.device.start, batch, plane)
        return _InFlight(builder, numbers, batch, plane, started)

    def _finish(self, one: "_InFlight") -> Iterator[tuple[Unit, UnitResult]]:
        """Wait for a batch; if it is the last of its unit, yield the unit's result."""
        builder, unit = one.builder, one.builder.unit
        found = self._timed(self.device.doing, self.device.finish, one.started)
        self._busy.update(found.busy_s)
        self._timed("write", builder.add, one, found)
        self._timed("write", builder.show, one)
        self._batch_done()
        if one.numbers[-1] + 1 == unit.stop:
            result: UnitResult = self._timed("write", builder.complete)
            busy, self._busy = self._busy, Counter()
            result.counts.busy_s.update(busy)
            yield unit, result

    def _timed(self, what: str, function: Callable[..., Any], *args: Any) -> Any:
        start = time.perf_counter()
        try:
            return function(*args)
        finally:
            self._busy[what] += time.perf_counter() - start  # pyright: ignore


class _InFlight(NamedTuple):
    """A batch of a unit that has been started."""

    builder: "_ResultBuilder"
    """Builder of the unit's result."""
    numbers: list[int]
    """Numbers of the frames in the batch."""
    batch: "Batch"
    plane: GroundPlane
    """Prior of each frame's floor."""
    started: Any
    """Handle that :meth:`jaxdet.engine.device.Device.start` returned."""


class _ResultBuilder:
    """Collects the batches of a unit and makes its rows together, as arrays of all frames."""

    def __init__(self, plan: LogPlan, unit: Unit) -> None:
        self.plan, self.unit = plan, unit
        self.held: list[tuple[Batch, GroundPlane, Detections]] = []
        """Inputs of the rows of each batch."""
        self.errors: list[str] = []
        self.pictures: list[str] = []
        self.seen: dict[str, list[Any]] = {name: [] for name in plan.observers}

    def add(self, one: _InFlight, found: Found) -> None:
        """Add a batch and its detections."""
        batch, count = one.batch, len(one.batch.status)
        plane = GroundPlane(*(part[:count] for part in one.plane))
        self.held.append((batch.without_images(), plane, used_slots(found.inputs, count)))
        errors = zip(one.numbers, batch.errors, strict=True)
        self.errors += [f"frame {number}: {error}" for number, error in errors if error]

    def show(self, one: _InFlight) -> None:
        """Draw the pictures of a batch, and pass the batch to the observers."""
        batch = one.batch
        self.pictures += self._draw(one)
        if self.plan.observers:
            detections = self._detect(batch.frames._replace(plane=one.plane))
            for name, observer in self.plan.observers.items():
                self.seen[name].append(observer(batch, detections))

    def complete(self) -> UnitResult:
        """Return the result of the unit after its last batch; its rows are in a temporary file.

        Raises:
            OutputError: The disk is full or broken.
        """
        plan, counts, occupancy = self.plan, Counts(), OccupancyMap()
        batches, planes, inputs = zip(*self.held, strict=True)
        batch = batches[0].joined(batches)
        sources = plan.planes.sources(batch.frames.stamp_ns)
        given = batch, join_planes(planes), sources, joined_inputs(inputs), plan.config
        rows = batch_rows(plan.log, plan.camera, *given)
        counts.count(rows.frames, rows.obstacles)
        if plan.maps:
            occupancy.add_path(rows.T_world_camera)
            occupancy.add(rows.obstacles["corners_world"])
            occupancy.add_free(rows.free_world)
        path = rows_path(plan.scratch, self.unit)
        Tables.of(rows.frames, rows.obstacles).save(path)
        return UnitResult(
            counts, path, occupancy, self.errors, self.pictures, self.seen, batch.notes
        )

    def _draw(self, one: _InFlight) -> Iterator[str]:
        """Draw the frames of a batch that have pictures; yield the names of the pictures."""
        plan, frames = self.plan, one.batch.frames
        rows = [row for row, number in enumerate(one.numbers) if number in plan.drawn]
        rows = [row for row in rows if frames.valid[row]]
        if not rows:
            return
        arrays = {k: a[rows] for k, a in frames._asdict().items() if isinstance(a, np.ndarray)}
        plane = GroundPlane(*(part[rows] for part in one.plane))
        frames = frames._replace(**arrays, plane=plane)
        found = self._detect(frames)
        frames = frames._replace(plane=shown_planes(found, plane, frames.calibration))
        corners = rectangles(found.obstacles, frames.calibration.depth_unit, plan.config.footprint)
        for row, number in enumerate(frames.number.tolist()):
            name = f"pictures/{plan.picture}{number:06d}.png"
            title = f"{plan.label}   frame {number}"
            picture = draw_frame(frames, found, corners, row, plan.config, title)
            path = plan.folder / name
            with writing(path):
                path.parent.mkdir(parents=True, exist_ok=True)
                write_png(path, picture)
            yield name

    def _detect(self, frames: Frames) -> Detections:
        """Return all detections of frames, not only those that rows are made of.

        This process computes them: the device server returns only what all frames need.
        """
        config = self.plan.config
        with computing():
            return detect_on_cpu(method_frames(frames, config), config, backend=self.plan.backend)
