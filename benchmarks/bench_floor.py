"""The floor of each frame, against the reference."""

import jax
import numpy as np

from benchmarks.run import Case
from benchmarks.scene import BATCH, CONFIG, inputs, on_cells, repeated
from benchmarks.sweep import SIZES, Point
from jaxdet import reference
from jaxdet.floor.units import Scale, prior_units
from jaxdet.stages._floor import find_floor, floor_settings, scratch_words

program = jax.jit(find_floor, static_argnames="words")


def cases() -> list[Case]:
    """Cells on the device, the mount known; no other library has this step."""
    given, seen = inputs(SIZES[0]), on_cells(SIZES[0])
    x, y, z = seen.cells
    unit = given.calibration.depth_unit

    def peer() -> np.ndarray:
        return reference.find_floor(x, y, z, given.plane, CONFIG.floor, unit).found

    ours = at(Point(SIZES[0], 0, BATCH))
    return [ours._replace(name="vs_reference", peer=peer, equal=True, bytes_read=0)]


def at(point: Point) -> Case:
    """Cells on the device."""
    given, seen = inputs(point.size), on_cells(point.size)
    unit = given.calibration.depth_unit
    prior = prior_units(given.plane, Scale(unit, CONFIG.floor.noise_per_m))
    _, rows, columns = seen.cells.z.shape
    settings = floor_settings(rows * columns, CONFIG.floor, unit)
    words = scratch_words(rows, columns, CONFIG.floor, unit)
    *xyz, known = jax.device_put(repeated((*seen.cells, prior), point.batch))
    return Case(
        name=point.name,
        run=lambda: program(*xyz, known, settings, words=words),
        frames=point.batch,
        bytes_read=sum(a.nbytes for a in xyz),
    )
