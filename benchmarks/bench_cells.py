"""Benchmark of the cells of the depth image, against the reference."""

from benchmarks.program_steps import against_reference, step_at
from benchmarks.run import Case
from benchmarks.scene import CONFIG, inputs
from benchmarks.sweep import SIZES, Point
from jaxdet import reference

STEP, MADE = "find_cells", ("x", "y", "z")


def cases() -> list[Case]:
    """Process depth images on the device; no other library has this step."""
    given = inputs(SIZES[0])
    settings = given.depth, given.calibration, CONFIG.surface
    return [against_reference(STEP, lambda: list(reference.cells(*settings)), MADE)]


def at(point: Point) -> Case:
    """Process depth images on the device."""
    return step_at(point, STEP, MADE, images=True)
