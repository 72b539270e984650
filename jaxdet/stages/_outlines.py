"""Obstacles made of surfaces, measured and outlined on their cells.

Twin of ``jaxdet/reference/_outlines.py`` and of ``footprint_on_floor`` beside it.
"""

from functools import lru_cache
from typing import NamedTuple

import jax
import numpy as np

from jaxdet.config import FootprintConfig
from jaxdet.floor.plane import direction_table
from jaxdet.stages._teams import TeamKernel, kernel_table
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


class OutlineSettings(NamedTuple):
    """What the kernel is told of the configuration, in this order."""

    trim: int  # cells passed over at each side and in front before A, B and C
    vertex: int  # how much nearer than A and B a vertex is [depth units]
    long: int  # longer rectangles pass over a part of their cells at their long sides [depth units]


class Outlined(NamedTuple):
    """The obstacles of a batch, with ``M = MAX_OBSTACLES`` slots a frame."""

    obstacles: Obstacles
    contour: jax.Array
    """``(B, M, C, 2)`` int32, the nearest cell of each column, right and forward on the
    floor, from left to right [depth units]; then zeros."""
    contour_points: jax.Array  # (B, M) int32, how many of them are used
    bottom_top: jax.Array
    """``(B, M, 2)`` int32, lowest and highest cell above the floor [depth units]."""


def outline_settings(config: FootprintConfig, depth_unit: float) -> np.ndarray:
    """:class:`OutlineSettings` as ``(3,)`` int32, of a configuration."""
    vertex, long = (round(m / depth_unit) for m in (config.vertex_threshold_m, config.long_m))
    return kernel_table(np.array(OutlineSettings(config.trim, vertex, long)))


def outlines(
    label: jax.Array,
    count: jax.Array,
    cells: Cells,
    floor: tuple[jax.Array, jax.Array, jax.Array],
    bands: jax.Array,
    settings: jax.Array,
) -> Outlined:
    """Measures each obstacle on its cells in the colour image, and outlines it on all of them.

    Takes what the kernel takes; ``floor`` is right, forward and height of the cells. Obstacles from
    MAX_OBSTACLES on get no slot.
    """
    batch, rows, columns = label.shape
    places = cells.x, cells.y, cells.z, *floor, cells.in_view, cells.uv_min, cells.uv_max
    inputs = label, count, *places, bands, _directions(), settings
    shapes = {
        f"{name}_out": (batch, MAX_OBSTACLES, *shape)
        for name, shape in {**SHAPES, "contour": (max(columns, 1), 2)}.items()
    }
    words = kernels.scratch_words(rows, columns, MAX_OBSTACLES)
    named = _outlines(*inputs, batch=batch, shapes=shapes, scratch=words)
    fields = len(Obstacles._fields)
    return Outlined(Obstacles(*named[:fields]), *named[fields:])


@lru_cache(maxsize=1)
def _directions() -> np.ndarray:
    return direction_table().astype(np.int32)
