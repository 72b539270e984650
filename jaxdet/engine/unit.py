"""Processing of a unit, a range of frames: read images, find obstacles, make table rows."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxdet.engine.device import (
    Device,
    Found,
    color_to_read,
    detected,
    method_frames,
    timed,
)
from jaxdet.engine.plan import LogPlan, Unit
from jaxdet.engine.startup import computing
from jaxdet.engine.unit_result import UnitResult, UnitResults, rows_path
from jaxdet.errors import FrameStatus
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
    from jaxdet.io import Batch, Log


def process_units(
    log: "Log",
    plan: LogPlan,
    device: Device,
    units: Iterable[Unit],
    batch_done: Callable[[], object],
) -> UnitResults:
    """Yield units of an open log with their results, in order.

    Args:
        log: The log.
        plan: Plan of the log.
        device: Device that computes.
        units: The units.
        batch_done: Called after each batch.

    Raises:
        JaxdetError: The log can't be read any more, or its index is wrong.
        OutputError: The disk is full or broken.
    """
    busy: Counter[str] = Counter()
    read = _batches(log, plan, device, units, busy)
    with closing(detected(read, plan.planes, device, busy)) as batches:
        for builder, batch, found in batches:
            unit = builder.unit
            with timed(busy, "write"):
                builder.add(batch, found)
                builder.show(batch)
            batch_done()
            if batch.frames.number[len(batch.status) - 1] + 1 == unit.stop:
                with timed(busy, "write"):
                    result = builder.complete()
                result.counts.busy_s.update(busy)
                busy.clear()
                yield unit, result


def _batches(
    log: "Log", plan: LogPlan, device: Device, units: Iterable[Unit], busy: Counter[str]
) -> Iterator[tuple["_ResultBuilder", "Batch"]]:
    """Yield the batches of units, each with the builder of its unit's result."""
    config, observers = plan.settings.config, plan.settings.observers
    observed = any(getattr(one, "needs_color", False) for one in observers.values())
    color = color_to_read(config, observed or plan.drawn)
    for unit in units:
        builder = _ResultBuilder(log, plan, unit)
        given = plan.batch_size, unit.start, unit.stop
        batches = log.batches(*given, images=device.images, **color)
        while True:
            with timed(busy, "read"):
                batch = next(batches, None)
            if batch is None:
                break
            busy["decode"] += batch.decoding_s  # pyright: ignore
            busy["read"] -= batch.decoding_s  # pyright: ignore
            yield builder, batch


def lost_unit(
    log: "Log", plan: LogPlan, unit: Unit, status: FrameStatus, reason: str
) -> UnitResult:
    """Return the result of a unit whose workers were lost: rows with a status, no obstacles.

    No image is read.

    Args:
        log: Open log.
        plan: Plan of the log.
        unit: The unit.
        status: Status of its frames.
        reason: Reason of the status.

    Raises:
        OutputError: The disk is full or broken.
    """
    numbers = [number for number in log.frames if unit.start <= number < unit.stop]
    batch, builder = log.without_images(numbers, status, reason), _ResultBuilder(log, plan, unit)
    plane = plan.planes.of(batch.frames.stamp_ns)
    batch = batch._replace(frames=batch.frames._replace(plane=plane))
    builder.add(batch, Found(no_inputs(len(numbers))))
    text = f"{unit.where(log.label)}: {status} ({reason})"
    return builder.complete()._replace(errors=[], lost=text)


class _ResultBuilder:
    """Builder of the result of a unit: collects its batches, then makes all rows at once."""

    def __init__(self, log: "Log", plan: LogPlan, unit: Unit) -> None:
        self.log, self.plan, self.unit = log, plan, unit
        self.held: list[tuple[Batch, GroundPlane, Detections]] = []
        """Inputs of the rows of each batch."""
        self.errors: list[str] = []
        self.pictures: list[str] = []
        self.seen: dict[str, list[Any]] = {name: [] for name in plan.settings.observers}

    def add(self, batch: "Batch", found: Found) -> None:
        """Add a batch, which has floor priors, and its detections."""
        count, plane = len(batch.status), batch.frames.plane
        assert plane is not None
        plane = GroundPlane(*(part[:count] for part in plane))
        self.held.append((batch.without_images(), plane, used_slots(found.inputs, count)))
        errors = zip(batch.frames.number.tolist(), batch.errors, strict=False)  # without padding
        self.errors += [f"frame {number}: {error}" for number, error in errors if error]

    def show(self, batch: "Batch") -> None:
        """Draw the pictures of a batch, and pass the batch to the observers."""
        self.pictures += self._draw(batch)
        if observers := self.plan.settings.observers:
            detections = self._detect(batch.frames)
            for name, observer in observers.items():
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
        given = batch, join_planes(planes), sources, joined_inputs(inputs), plan.settings.config
        rows = batch_rows(self.log.name, self.log.camera, *given)
        counts.count(rows.frames, rows.obstacles)
        if plan.settings.options.map:
            occupancy.add_path(rows.T_world_camera)
            occupancy.add(rows.obstacles["corners_world"])
            occupancy.add_free(rows.free_world)
        path = rows_path(plan.scratch, self.unit)
        Tables.of(rows.frames, rows.obstacles).save(path)
        return UnitResult(
            counts, path, occupancy, self.errors, self.pictures, self.seen, batch.notes
        )

    def _draw(self, batch: "Batch") -> Iterator[str]:
        """Draw the frames of a batch that have pictures; yield the names of the pictures."""
        plan, config, frames = self.plan, self.plan.settings.config, batch.frames
        rows = [row for row, number in enumerate(frames.number.tolist()) if number in plan.drawn]
        rows = [row for row in rows if frames.valid[row]]
        if not rows:
            return
        assert frames.plane is not None
        arrays = {k: a[rows] for k, a in frames._asdict().items() if isinstance(a, np.ndarray)}
        plane = GroundPlane(*(part[rows] for part in frames.plane))
        frames = frames._replace(**arrays, plane=plane)
        found = self._detect(frames)
        frames = frames._replace(plane=shown_planes(found, plane, frames.calibration))
        corners = rectangles(found.obstacles, frames.calibration.depth_unit, config.footprint)
        for row, number in enumerate(frames.number.tolist()):
            name = f"pictures/{plan.picture}{number:06d}.png"
            title = f"{self.log.label}   frame {number}"
            picture = draw_frame(frames, found, corners, row, config, title)
            path = plan.folder / name
            with writing(path):
                path.parent.mkdir(parents=True, exist_ok=True)
                write_png(path, picture)
            yield name

    def _detect(self, frames: Frames) -> Detections:
        """Return the complete detections of frames, not only the inputs of rows.

        This process computes them, since GPUs of the main process return only the inputs of rows.
        """
        config, backend = self.plan.settings.config, self.plan.settings.options.backend
        with computing():
            return detect_on_cpu(method_frames(frames, config), config, backend=backend)
