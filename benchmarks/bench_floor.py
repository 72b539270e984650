"""Benchmark of the floor fit of each frame, against the reference."""

from functools import partial

from benchmarks.program_steps import against_reference, step_at
from benchmarks.run import Case
from benchmarks.scene import CONFIG, inputs, on_cells
from benchmarks.sweep import SIZES, Point
from jaxdet import reference

STEP, MADE = "find_floor", ("floor",)


def cases() -> list[Case]:
    """Process cells on the device with a known mount; no other library has this step."""
    given, seen = inputs(SIZES[0]), on_cells(SIZES[0])
    settings = given.plane, CONFIG.floor, given.calibration.depth_unit
    found = partial(reference.find_floor, *seen.cells, *settings)
    return [against_reference(STEP, lambda: [found().found], MADE)]


def at(point: Point) -> Case:
    """Process cells on the device."""
    return step_at(point, STEP, ("x", "y", "z", *MADE))
