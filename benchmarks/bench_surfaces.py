"""Cells on the floor and in surfaces, against the reference."""

import jax
import numpy as np

from benchmarks.run import Case
from benchmarks.scene import BATCH, CONFIG, inputs, on_cells, repeated
from benchmarks.sweep import SIZES, Point
from jaxdet.floor.plane import step_height
from jaxdet.reference._detect import _surfaces
from jaxdet.stages._surfaces import surfaces, tables

FIELDS = ("right", "forward", "height", "label", "keep", "low")
program = jax.jit(surfaces)


def cases() -> list[Case]:
    """Cells and floors on the device; no other library has this step."""
    seen, calibration = on_cells(SIZES[0]), inputs(SIZES[0]).calibration
    shared = step_height(calibration, CONFIG), calibration.depth_unit, CONFIG

    def peer() -> list[np.ndarray]:
        found = [_surfaces(seen.cells, b, seen.floor[b], *shared) for b in range(BATCH)]
        return [seen.of(name, found) for name in FIELDS]

    return [
        at(Point(SIZES[0], 0, BATCH))._replace(
            name="vs_reference",
            peer=peer,
            equal=True,
            compared=lambda result: [getattr(result, name) for name in FIELDS],
            bytes_read=0,
        )
    ]


def at(point: Point) -> Case:
    """Cells and floors on the device."""
    seen, calibration = on_cells(point.size), inputs(point.size).calibration
    shared = jax.device_put(tables(calibration, CONFIG))
    *xyz, floor = jax.device_put(repeated((*seen.cells, seen.floor), point.batch))
    return Case(
        name=point.name,
        run=lambda: program(*xyz, floor, shared),
        frames=point.batch,
        bytes_read=sum(a.nbytes for a in xyz),
    )
