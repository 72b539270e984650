"""Obstacles made of surfaces, measured and outlined on their cells.

Twin of ``jaxdet/reference/_outlines.py`` and of ``footprint_on_floor`` beside it.
"""

from typing import NamedTuple

import jax

from jaxdet.config import FootprintConfig
from jaxdet.floor.plane import band_table, direction_table
from jaxdet.stages._teams import Tables, TeamKernel, kernel_tables
from jaxdet.types import MAX_OBSTACLES, Cells, Obstacles
from jaxdet_kernels import outlines as kernels

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


def tables(config: FootprintConfig, depth_unit: float) -> Tables:
    """The tables of a configuration, on the host."""
    vertex, long = (round(m / depth_unit) for m in (config.vertex_threshold_m, config.long_m))
    return kernel_tables(
        bands=band_table(config, depth_unit),
        directions=direction_table(),
        settings=(config.trim, vertex, long),
    )


def outlines(
    label: jax.Array,
    count: jax.Array,
    cells: Cells,
    floor: tuple[jax.Array, jax.Array, jax.Array],
    shared: Tables,
) -> Outlined:
    """Measures each obstacle on its cells in the colour image, and outlines it on all of them.

    Takes what the kernel takes, ``shared`` as of :func:`tables`; ``floor`` is right, forward and
    height of the cells. Obstacles from MAX_OBSTACLES on get no slot.
    """
    batch, rows, columns = label.shape
    places = cells.x, cells.y, cells.z, *floor, cells.in_view, cells.uv_min, cells.uv_max
    inputs = label, count, *places
    shapes = {
        f"{name}_out": (batch, MAX_OBSTACLES, *shape)
        for name, shape in {**SHAPES, "contour": (columns, 2)}.items()
    }
    words = kernels.scratch_words(rows, columns, MAX_OBSTACLES)
    named = _outlines(*inputs, **shared, batch=batch, shapes=shapes, scratch=words)
    fields = len(Obstacles._fields)
    return Outlined(Obstacles(*named[:fields]), *named[fields:])
