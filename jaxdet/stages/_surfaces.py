"""Cells on the floor and in surfaces: twin of ``_surfaces`` in ``jaxdet/reference/_detect.py``."""

from typing import NamedTuple

import jax
import numpy as np

from jaxdet.config import Config
from jaxdet.floor.plane import depth_range, quadratic_table, step_table
from jaxdet.stages._teams import TeamKernel, kernel_table
from jaxdet.types import Array, Calibration
from jaxdet_kernels import surfaces as kernels

_surfaces = TeamKernel(kernels.surfaces)

MOST_STEP, MOST_LIMIT = 1 << 16, 1 << 17
"""Depths have 16 bits, bends 17: larger steps and limits mean the same."""


class SurfaceSettings(NamedTuple):
    """The numbers of the configuration, in the order of ``native/surfaces.h``."""

    nearest: int  # least depth [depth units]
    farthest: int  # depth up to which surfaces are followed [depth units]
    crease_cells: int
    min_cells: int
    crease_margin: int
    bent: int  # height up to which surfaces without a steep side are floor [depth units]


class SurfaceTables(NamedTuple):
    """Lengths by z, each ``(65536,)`` int32 [depth units]."""

    steps: Array  # largest step in depth between neighbouring cells of a surface
    limits: Array  # deeper bends are creases
    rises: Array  # what is no higher above the floor is floor


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
    """``(B,)`` int32, how many surfaces there are, those without a label included."""


def surface_settings(config: Config, depth_unit: float) -> np.ndarray:
    """The configuration's :class:`SurfaceSettings`, ``(6,)`` int32."""
    ground, surface = config.ground, config.surface
    nearest, farthest = depth_range(ground.min_depth_m, ground.max_depth_m, depth_unit)
    settings = SurfaceSettings(
        nearest,
        round(farthest * surface.beyond),
        surface.crease_cells,
        surface.min_cells,
        surface.crease_margin,
        round(surface.bent_m / depth_unit),
    )
    return kernel_table(np.array(settings))


def surface_tables(calibration: Calibration, config: Config) -> SurfaceTables:
    """The configuration's lengths by z, on the host; where they are larger than any length, cut."""
    surface, depth_unit = config.surface, calibration.depth_unit
    tables = (
        np.minimum(quadratic_table(surface.step_m, surface.step_per_m, depth_unit), MOST_STEP),
        np.minimum(quadratic_table(surface.crease_m, surface.crease_per_m, depth_unit), MOST_LIMIT),
        step_table(calibration, config),
    )
    return SurfaceTables(*map(kernel_table, tables))


def surfaces(
    x: Array, y: Array, z: Array, floor: Array, tables: SurfaceTables, settings: Array
) -> Surfaces:
    """Places the cells of a batch on the floor and groups those above it into surfaces.

    Takes what the kernel takes; ``tables`` and ``settings`` are made above.
    """
    batch, rows, columns = shape = z.shape
    shapes = {**dict.fromkeys(_surfaces.outputs, shape), "count_out": (batch,)}
    scratch = kernels.surfaces_words(rows, columns)
    out = _surfaces(x, y, z, floor, *tables, settings, batch=batch, shapes=shapes, scratch=scratch)
    return Surfaces(*out)
