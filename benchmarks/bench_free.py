"""The free floor in each column of cells, against the reference."""

import jax

from benchmarks.run import Case
from benchmarks.scene import BATCH, CONFIG, inputs, on_cells, repeated
from benchmarks.sweep import SIZES, Point
from jaxdet.reference._detect import _free
from jaxdet.stages._free import free_floor, tables

program = jax.jit(free_floor)


def cases() -> list[Case]:
    """Obstacles on the device; no other library has this step."""
    seen, unit = on_cells(SIZES[0]), inputs(SIZES[0]).calibration.depth_unit
    return [
        at(Point(SIZES[0], 0, BATCH))._replace(
            name="vs_reference",
            peer=lambda: _free(seen.obstacles, seen.floor, unit, CONFIG),
            equal=True,
            bytes_read=0,
        )
    ]


def at(point: Point) -> Case:
    """Obstacles on the device."""
    seen, unit = on_cells(point.size), inputs(point.size).calibration.depth_unit
    label, low = (seen.of(name, seen.obstacles) for name in ("label", "low"))
    given = jax.device_put(
        repeated((label, low, seen.cells.z, seen.places, seen.floor), point.batch)
    )
    shared = jax.device_put(tables(CONFIG, unit))
    return Case(
        name=point.name,
        run=lambda: program(*given, shared),
        frames=point.batch,
        bytes_read=sum(a.nbytes for a in jax.tree.leaves(given)),
    )
