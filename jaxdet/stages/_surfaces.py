"""Cells on the floor and in surfaces: twin of ``_surfaces`` in ``jaxdet/reference/_detect.py``."""

import numpy as np

from jaxdet.config import Config
from jaxdet.floor.plane import depth_range, max_height, quadratic_table, step_height
from jaxdet.stages._tables import Tables, kernel_tables
from jaxdet.types import Calibration

MOST_STEP, MOST_LIMIT = 1 << 16, 1 << 17
"""Depths have 16 bits, bends 17: larger steps and limits mean the same."""


def tables(calibration: Calibration, config: Config) -> Tables:
    """The tables of a configuration, on the host; what is larger than any length is cut."""
    ground, surface, unit = config.ground, config.surface, calibration.depth_unit
    nearest, farthest = depth_range(ground.min_depth_m, ground.max_depth_m, unit)
    steps = quadratic_table(surface.step_m, surface.step_per_m, unit)
    limits = quadratic_table(surface.crease_m, surface.crease_per_m, unit)
    step = step_height(calibration, config)
    beyond, bent = round(farthest * surface.beyond), round(surface.bent_m / unit)
    creases = surface.crease_cells, surface.min_cells, surface.crease_margin
    lengths = nearest, beyond, *creases, bent, step.noise
    return kernel_tables(
        steps=np.minimum(steps, MOST_STEP),
        limits=np.minimum(limits, MOST_LIMIT),
        rises=step.table,
        surface_settings=(*lengths, max_height(ground, unit), farthest, surface.hole_cells),
    )
