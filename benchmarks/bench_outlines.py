"""Outlines of obstacles made of surfaces, against the reference."""

import jax

from benchmarks.run import Case
from benchmarks.scene import BATCH, CONFIG, inputs, on_cells, repeated
from benchmarks.sweep import SIZES, Point
from jaxdet.reference._detect import _outlines
from jaxdet.stages._outlines import outlines, tables

program = jax.jit(outlines, static_argnames="static")


def cases() -> list[Case]:
    """Obstacles on the device; no other library has this step."""
    seen, calibration = on_cells(SIZES[0]), inputs(SIZES[0]).calibration
    count = seen.of("label", seen.obstacles).max(axis=(1, 2)) + 1
    return [
        at(Point(SIZES[0], 0, BATCH))._replace(
            name="vs_reference",
            peer=lambda: _outlines(seen.cells, seen.obstacles, count, calibration, CONFIG),
            equal=True,
            bytes_read=0,
        )
    ]


def at(point: Point) -> Case:
    """Obstacles on the device."""
    seen, calibration = on_cells(point.size), inputs(point.size).calibration
    label = seen.of("label", seen.obstacles)
    given = jax.device_put(
        repeated((label, label.max(axis=(1, 2)) + 1, seen.cells, seen.places), point.batch)
    )
    shared, static = tables(calibration, CONFIG)
    shared = jax.device_put(shared)
    return Case(
        name=point.name,
        run=lambda: program(*given, shared, static=static),
        frames=point.batch,
        bytes_read=sum(a.nbytes for a in jax.tree.leaves(given)),
    )
