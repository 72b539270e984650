"""Benchmark of the free floor along rays, against the reference."""

from benchmarks.program_steps import against_reference, step_at
from benchmarks.run import Case
from benchmarks.scene import CONFIG, inputs, on_cells
from benchmarks.sweep import SIZES, Point
from jaxdet.camera import cell_side
from jaxdet.reference._cells import nearest_depths
from jaxdet.reference._detect import _free

STEP, MADE = "find_free_floor", ("free", "free_end")
READ = ("label", "low", "half", "z", "nearest_pixel", "right", "forward", "height", "frame")


def cases() -> list[Case]:
    """Process obstacles on the device; no other library has this step."""
    seen, frames = on_cells(SIZES[0]), inputs(SIZES[0])
    side = cell_side(frames.calibration.depth, CONFIG.surface.cell_rad)
    pixels = nearest_depths(frames.depth, side)
    given = seen.obstacles, seen.floor, pixels, frames.calibration, CONFIG
    return [against_reference(STEP, lambda: list(_free(*given)[2:]), MADE)]


def at(point: Point) -> Case:
    """Process obstacles on the device."""
    return step_at(point, STEP, (*READ, *MADE))
