"""Cells on the floor and in surfaces: twin of ``_surfaces`` in ``jaxdet/reference/_detect.py``."""

from typing import NamedTuple

import jax
import numpy as np

from jaxdet.config import Config
from jaxdet.floor.plane import depth_range, max_height, quadratic_table, step_height
from jaxdet.stages._teams import Tables, TeamKernel, kernel_tables
from jaxdet.types import Array, Calibration
from jaxdet_kernels import surfaces as kernels

_surfaces = TeamKernel(kernels.surfaces)

MOST_STEP, MOST_LIMIT = 1 << 16, 1 << 17
"""Depths have 16 bits, bends 17: larger steps and limits mean the same."""


class Surfaces(NamedTuple):
    """The cells of a batch on the floor and in surfaces."""

    right: jax.Array  # (B, R, C) int32, on the floor [depth units]
    forward: jax.Array  # (B, R, C) int32, on the floor [depth units]
    height: jax.Array  # (B, R, C) int32, above the floor [depth units]
    label: jax.Array  # (B, R, C) int32, below MAX_SURFACES, -1 = none
    keep: jax.Array  # (B, R, C) bool, in range and above the floor
    free: jax.Array  # (B, R, C) bool, measured to be free: floor, or beyond the range
    low: jax.Array  # (B, R, C) bool, measured and no higher than the step
    num_surfaces: jax.Array
    """``(B,)`` int32, number of surfaces, those without a label included."""
    has_depth: jax.Array  # (B,) bool, some depth is in range


def tables(calibration: Calibration, config: Config) -> Tables:
    """The tables of a configuration, on the host; what is larger than any length is cut."""
    ground, surface, unit = config.ground, config.surface, calibration.depth_unit
    nearest, farthest = depth_range(ground.min_depth_m, ground.max_depth_m, unit)
    steps = quadratic_table(surface.step_m, surface.step_per_m, unit)
    limits = quadratic_table(surface.crease_m, surface.crease_per_m, unit)
    step = step_height(calibration, config)
    beyond, bent = round(farthest * surface.beyond), round(surface.bent_m / unit)
    creases = surface.crease_cells, surface.min_cells, surface.crease_margin
    return kernel_tables(
        steps=np.minimum(steps, MOST_STEP),
        limits=np.minimum(limits, MOST_LIMIT),
        rises=step.table,
        settings=(nearest, beyond, *creases, bent, step.noise, max_height(ground, unit), farthest),
    )


def surfaces(x: Array, y: Array, z: Array, floor: Array, shared: Tables) -> Surfaces:
    """Places the cells of a batch on the floor and groups those above it into surfaces.

    Takes what the kernel takes, ``shared`` as of :func:`tables`.
    """
    batch, rows, columns = shape = z.shape
    shapes = {
        **dict.fromkeys(_surfaces.outputs, shape),
        "count_out": (batch,),
        "has_depth_out": (batch,),
    }
    scratch = kernels.surfaces_words(rows, columns)
    out = _surfaces(x, y, z, floor, **shared, batch=batch, shapes=shapes, scratch=scratch)
    return Surfaces(*out)
