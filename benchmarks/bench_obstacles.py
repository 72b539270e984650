"""Benchmark of the clustering of surfaces into obstacles, against the reference."""

import numpy as np

from benchmarks.program_steps import against_reference, step_at
from benchmarks.run import Case
from benchmarks.scene import CONFIG, inputs, on_cells
from benchmarks.sweep import SIZES, Point
from jaxdet.floor.plane import depth_range
from jaxdet.reference._lower_parts import with_lower_parts
from jaxdet.reference._obstacles import obstacles as grouped

STEP, MADE = "find_obstacles", ("label", "num_obstacles")
READ = ("x", "y", "z", "right", "forward", "height", "surface", "free_cell", "half", "frame")


def cases() -> list[Case]:
    """Process surfaces on the device; no other library has this step."""
    seen, unit = on_cells(SIZES[0]), inputs(SIZES[0]).calibration.depth_unit
    _, far = depth_range(CONFIG.ground.min_depth_m, CONFIG.ground.max_depth_m, unit)
    shared = far, unit, CONFIG.obstacle

    def peer() -> list[np.ndarray]:
        found = []
        for one, floor in zip(seen.surfaces, seen.floor, strict=True):
            label = grouped(one.label, one.free, one.view, *shared)
            found.append(with_lower_parts(label, one.half, one.view, floor))
        return [np.stack(found), np.max(found, axis=(1, 2)) + 1]

    return [against_reference(STEP, peer, MADE)]


def at(point: Point) -> Case:
    """Process surfaces on the device."""
    return step_at(point, STEP, (*READ, *MADE))
