"""Benchmark of cell positions on the floor and of surfaces, against the reference."""

import numpy as np

from benchmarks.program_steps import against_reference, step_at
from benchmarks.run import Case
from benchmarks.scene import BATCH, CONFIG, inputs, on_cells
from benchmarks.sweep import SIZES, Point
from jaxdet.floor.plane import step_height
from jaxdet.reference._detect import _surfaces

STEP, MADE = "find_surfaces", ("right", "forward", "height", "surface", "keep", "low", "half")
FIELDS = ("right", "forward", "height", "label", "keep", "low", "half")


def cases() -> list[Case]:
    """Process cells and floors on the device; no other library has this step."""
    seen, calibration = on_cells(SIZES[0]), inputs(SIZES[0]).calibration
    shared = step_height(calibration, CONFIG), calibration.depth_unit, CONFIG

    def peer() -> list[np.ndarray]:
        found = [_surfaces(seen.cells, b, seen.floor[b], *shared) for b in range(BATCH)]
        return [seen.of(name, found) for name in FIELDS]

    return [against_reference(STEP, peer, MADE)]


def at(point: Point) -> Case:
    """Process cells and floors on the device."""
    return step_at(point, STEP, ("x", "y", "z", *MADE))
