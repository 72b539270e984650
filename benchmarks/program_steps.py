"""Single steps of the default, on arrays computed by the steps before them."""

from functools import partial
from typing import Any, NamedTuple

import numpy as np
import warp as wp

from benchmarks.run import Case
from benchmarks.scene import BATCH, CONFIG, frames_of
from benchmarks.sweep import SIZES, Point
from jaxdet.runtime.calls import device_of_jax, most_teams
from jaxdet.stages._program import (
    STEPS,
    Static,
    floors,
    launch,
    packed_tables,
    record_layout,
    work_layout,
)
from jaxdet_kernels import program as kernels


class Program(NamedTuple):
    """Arrays of the program on the default device, after all steps have run once."""

    arrays: list[wp.array]
    """Depth, floors, tables, record, contour and work."""
    scratch: wp.array
    static: Static

    def run(self, step: str) -> None:
        """Run a step again and wait for it."""
        number = STEPS.index(step)
        launch(self.arrays, self.scratch, number, number + 1, self.static)
        wp.synchronize_device(self.arrays[0].device)

    def take(self, name: str) -> np.ndarray:
        """Return an array of all frames by its name, on the host."""
        static, (depth, *_, record, contour, work) = self.static, self.arrays
        if name == "contour":
            return contour.numpy().reshape(len(depth), -1, static.columns, 2)
        layouts = (record_layout(), record), (work_layout(*static[:2]), work)
        return next(lay.take(rows.numpy(), name) for lay, rows in layouts if name in lay.shapes)


def program(point: Point) -> Program:
    """Run the program on depth images of the scene; return its arrays on the device."""
    frames = frames_of(point.size, point.batch)
    unit, plane = frames.calibration.depth_unit, frames.plane
    assert plane is not None
    device = device_of_jax(kernels)
    tables = packed_tables(frames.calibration, CONFIG, str(device))
    static = Static.of(tables)
    given = frames.depth, floors(plane, CONFIG, unit), tables
    arrays = [wp.array(a, dtype=wp.dtype_from_numpy(a.dtype), device=device) for a in given]
    rows = [(point.batch, words) for words in static.words()]
    arrays += [wp.zeros(shape, dtype=wp.int32, device=device) for shape in rows]
    teams = 1 if device.is_cpu else most_teams(point.batch, static.own_words)
    scratch = wp.zeros((teams, static.own_words), dtype=wp.int32, device=device)
    launch(arrays, scratch, 0, len(STEPS), static)
    return Program(arrays, scratch, static)


def step_at(point: Point, step: str, names: tuple[str, ...], images: bool = False) -> Case:
    """Return a case for one step on the device.

    Args:
        point: Sizes.
        step: Name in :data:`jaxdet.stages._program.STEPS`.
        names: Arrays that it reads and writes; their bytes are counted.
        images: Whether it also reads the depth images.
    """
    own = program(point)
    moved = sum(own.take(name).nbytes for name in names)
    moved += point.batch * np.prod(own.arrays[0].shape[1:]) * 2 if images else 0
    run = partial(own.run, step)
    return Case(name=point.name, run=run, frames=point.batch, bytes_read=int(moved))


def against_reference(step: str, peer: Any, names: tuple[str, ...]) -> Case:
    """Return a case for one step, in which the named arrays must equal those of the reference."""
    point = Point(SIZES[0], 0, BATCH)
    own = program(point)

    def run() -> list[np.ndarray]:
        own.run(step)
        return [own.take(name) for name in names]

    case = Case("vs_reference", partial(own.run, step), BATCH, peer, equal=True)
    return case._replace(compared=lambda _: run())
