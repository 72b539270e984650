"""Benchmark of the outlines of obstacles made of surfaces, against the reference."""

import numpy as np

from benchmarks.program_steps import against_reference, step_at
from benchmarks.run import Case
from benchmarks.scene import CONFIG, inputs, on_cells
from benchmarks.sweep import SIZES, Point
from jaxdet.reference._detect import _outlines
from jaxdet.types import Obstacles

STEP = "find_outlines"
READ = ("x", "y", "z", "right", "forward", "height", "label", "num_obstacles")
MADE = (
    *(name for name in Obstacles._fields if name != "nearest"),
    "contour",
    "contour_points",
    "bottom_top",
)


def cases() -> list[Case]:
    """Process obstacles on the device; no other library has this step."""
    seen, calibration = on_cells(SIZES[0]), inputs(SIZES[0]).calibration
    count = seen.of("label", seen.obstacles).max(axis=(1, 2)) + 1

    def peer() -> list[np.ndarray]:
        found, shapes = _outlines(seen.cells, seen.obstacles, count, calibration, CONFIG)
        return [*(part for part in found if part is not None), *shapes]

    return [against_reference(STEP, peer, MADE)]


def at(point: Point) -> Case:
    """Process obstacles on the device."""
    return step_at(point, STEP, (*READ, *MADE))
