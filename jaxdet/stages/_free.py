"""Free floor of obstacles made of surfaces. Twin of ``jaxdet/reference/_free.py``."""

from typing import NamedTuple

import jax
import numpy as np

from jaxdet.config import Config
from jaxdet.floor.plane import quadratic_table
from jaxdet.stages._teams import TeamKernel, kernel_table
from jaxdet.types import Array
from jaxdet_kernels import free_floor as kernels

_free_floor = TeamKernel(kernels.free_floor)


class FreeSettings(NamedTuple):
    """What the kernel is told of the configuration, in this order."""

    far: int  # end of the range [depth units]
    gap: int  # the floor ends where so much of it shows no measurement [depth units]


class FreeTables(NamedTuple):
    """Heights by z, each ``(65536,)`` int32 [depth units]."""

    bows: Array  # how far below the plane floor still is
    drops: Array  # how much lower than the floor before it the floor behind an edge lies


def free_settings(config: Config, depth_unit: float) -> np.ndarray:
    """:class:`FreeSettings` as ``(2,)`` int32, of a configuration."""
    lengths = (config.ground.max_depth_m, config.floor.gap_m)
    return kernel_table(np.array(FreeSettings(*(round(m / depth_unit) for m in lengths))))


def free_tables(config: Config, depth_unit: float) -> FreeTables:
    """The tables of a configuration, on the host."""
    floor = config.floor
    bows = quadratic_table(config.ground.step_height_m, floor.bow_per_m, depth_unit)
    drops = quadratic_table(floor.drop_m, floor.noise_per_m, depth_unit)
    return FreeTables(*map(kernel_table, (bows, drops)))


def free_floor(
    label: jax.Array,
    low: jax.Array,
    z: jax.Array,
    floor: tuple[jax.Array, jax.Array, jax.Array],
    tables: FreeTables,
    settings: jax.Array,
) -> tuple[jax.Array, jax.Array]:
    """Follows the floor in each column of cells, from the robot outward.

    Takes what the kernel takes; ``floor`` is right, forward and height of the cells.

    Returns:
        ``(B, C, 2, 2)`` int32, where the floor begins and where it ends, right and forward, and
        ``(B, C)`` int32, what ends it, see :class:`jaxdet.types.FreeEnd`.
    """
    batch, _, columns = label.shape
    inputs, words = (label, low, z, *floor, *tables, settings), kernels.scratch_words(columns)
    shapes = {"free_out": (batch, columns, 2, 2), "free_end_out": (batch, columns)}
    line, end = _free_floor(*inputs, batch=batch, shapes=shapes, scratch=words)
    return line, end
