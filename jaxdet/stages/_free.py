"""Free floor of obstacles made of surfaces. Twin of ``jaxdet/reference/_free.py``."""

import jax

from jaxdet.config import Config
from jaxdet.floor.plane import quadratic_table
from jaxdet.stages._teams import Tables, TeamKernel, kernel_tables
from jaxdet_kernels import free_floor as kernels

_free_floor = TeamKernel(kernels.free_floor)


def tables(config: Config, depth_unit: float) -> Tables:
    """The tables of a configuration, on the host."""
    floor, ground = config.floor, config.ground
    bows = quadratic_table(ground.step_height_m, floor.bow_per_m, depth_unit)
    drops = quadratic_table(floor.drop_m, floor.noise_per_m, depth_unit)
    settings = [round(m / depth_unit) for m in (ground.max_depth_m, floor.gap_m)]
    return kernel_tables(bows=bows, drops=drops, settings=settings)


def free_floor(
    label: jax.Array,
    low: jax.Array,
    z: jax.Array,
    floor: tuple[jax.Array, jax.Array, jax.Array],
    frame: jax.Array,
    shared: Tables,
) -> tuple[jax.Array, jax.Array]:
    """Follows the floor in each column of cells, from the robot outward.

    Takes what the kernel takes, ``shared`` as of :func:`tables`; ``floor`` is right, forward and
    height of the cells.

    Returns:
        ``(B, C, 2, 2)`` int32, where the floor begins and where it ends, right and forward, and
        ``(B, C)`` int32, what ends it, see :class:`jaxdet.types.FreeEnd`.
    """
    batch, _, columns = label.shape
    inputs = label, low, z, *floor, frame
    shapes = {"free_out": (batch, columns, 2, 2), "free_end_out": (batch, columns)}
    line, end = _free_floor(*inputs, **shared, batch=batch, shapes=shapes, scratch=columns)
    return line, end
