"""Cells of the depth image, against the reference."""

import jax

from benchmarks.run import Case
from benchmarks.scene import BATCH, CONFIG, inputs, repeated
from benchmarks.sweep import SIZES, Point
from jaxdet import reference
from jaxdet.stages import _cells

program = jax.jit(_cells.cells, static_argnames="static")


def cases() -> list[Case]:
    """Depth images on the device; no other library has this step."""
    given = inputs(SIZES[0])
    return [
        at(Point(SIZES[0], 0, BATCH))._replace(
            name="vs_reference",
            peer=lambda: reference.cells(given.depth, given.calibration, CONFIG.surface),
            equal=True,
            bytes_read=0,
        )
    ]


def at(point: Point) -> Case:
    """Depth images on the device."""
    given = inputs(point.size)
    arrays, static = _cells.tables(given.calibration, CONFIG.surface)
    depth = jax.device_put(repeated(given.depth, point.batch))
    return Case(
        name=point.name,
        run=lambda: program(depth, arrays, static=static),
        frames=point.batch,
        bytes_read=depth.nbytes,
    )
