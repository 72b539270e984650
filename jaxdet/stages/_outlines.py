"""Obstacles made of surfaces, measured and outlined on their cells.

Twin of ``jaxdet/reference/_outlines.py`` and of ``footprint_on_floor`` in ``_footprint.py``.
"""

from typing import NamedTuple

import jax
import numpy as np

from jaxdet.camera import cell_side
from jaxdet.config import Config
from jaxdet.floor.plane import band_table, direction_table
from jaxdet.stages import _align
from jaxdet.stages._teams import Tables, TeamKernel, kernel_tables
from jaxdet.types import MAX_OBSTACLES, Calibration, Cells, Obstacles
from jaxdet_kernels import outlines as kernels
from jaxdet_kernels.align import PARAMETERS

_outlines = TeamKernel(kernels.outlines)

SHAPES = {
    **dict.fromkeys(("num_points", "has_vertex", "contour_points"), ()),
    **dict.fromkeys(("uv_min", "uv_max", "a", "b", "c", "direction", "bottom_top"), (2,)),
    **dict.fromkeys(("xyz_min", "xyz_max"), (3,)),
    "xyz_sum": (3, 2),
    "span": (4,),
}
"""Of each output but the contour, for one obstacle."""


class Outlined(NamedTuple):
    """The obstacles of a batch, with ``M = MAX_OBSTACLES`` slots a frame."""

    obstacles: Obstacles
    contour: jax.Array
    """``(B, M, C, 2)`` int32, the nearest cell of each column, right and forward on the
    floor, from left to right [depth units]; then zeros."""
    contour_points: jax.Array  # (B, M) int32, how many of them are used
    bottom_top: jax.Array  # (B, M, 2) int32, lowest and highest cell above the floor [depth units]


class Static(NamedTuple):
    """Constants of a compiled program."""

    side: int
    model: int
    aligned: int


def tables(calibration: Calibration, config: Config) -> tuple[Tables, Static]:
    """Return the tables and constants of a camera and a configuration, on the host."""
    unit, footprint = calibration.depth_unit, config.footprint
    vertex, long = (round(m / unit) for m in (footprint.vertex_threshold_m, footprint.long_m))
    side = cell_side(calibration.depth, config.surface.cell_rad)
    found = kernel_tables(
        bands=band_table(footprint, unit),
        directions=direction_table(),
        settings=(footprint.trim, vertex, long),
        last=(calibration.image.width - 1, calibration.image.height - 1),
    )
    model, x, parameters = 0, np.zeros((1, 1), np.float32), np.zeros(PARAMETERS, np.float32)
    y = x
    if not calibration.is_aligned:
        x, y, parameters, model, _ = _align.tables(calibration)
        counts = (size // side for size in (calibration.depth.height, calibration.depth.width))
        corners = tuple(slice(0, count * side + 1, side) for count in counts)
        x, y = x[corners], y[corners]
    found |= {"corner_x": x, "corner_y": y, "parameters": parameters}
    return found, Static(side, model, int(calibration.is_aligned))


def outlines(
    label: jax.Array,
    count: jax.Array,
    cells: Cells,
    floor: tuple[jax.Array, jax.Array, jax.Array],
    shared: Tables,
    static: Static,
) -> Outlined:
    """Measure and outline each obstacle on its cells.

    Takes the kernel's inputs, ``shared`` and ``static`` from :func:`tables`; ``floor`` is right,
    forward and height of the cells. Obstacles from MAX_OBSTACLES on get no slot.
    """
    batch, rows, columns = label.shape
    inputs = label, count, *cells, *floor
    shapes = {
        f"{name}_out": (batch, MAX_OBSTACLES, *shape)
        for name, shape in {**SHAPES, "contour": (columns, 2)}.items()
    }
    words = kernels.scratch_words(rows, columns, MAX_OBSTACLES)
    named = _outlines(
        *inputs, **shared, **static._asdict(), batch=batch, shapes=shapes, scratch=words
    )
    fields = len(Obstacles._fields)
    return Outlined(Obstacles(*named[:fields]), *named[fields:])
