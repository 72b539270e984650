"""Cells of the depth image, under ``jax.jit``."""

from functools import lru_cache
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxdet.camera import cell_rays, cell_side
from jaxdet.config import SurfaceConfig
from jaxdet.floor.plane import quadratic_table
from jaxdet.stages._teams import Tables, TeamKernel, kernel_tables
from jaxdet.types import Calibration, Cells
from jaxdet_kernels import cells as kernels

_cells = TeamKernel(kernels.cells)


class Static(NamedTuple):
    """Constants of a compiled program."""

    side: int


@lru_cache(maxsize=8)
def tables(calibration: Calibration, config: SurfaceConfig) -> tuple[Tables, Static]:
    """Return the arrays and constants that :func:`cells` takes besides the images.

    Raises:
        CalibrationError: The calibration can't be used.
    """
    side = cell_side(calibration.depth, config.cell_rad)
    steps = quadratic_table(config.step_m, config.step_per_m, calibration.depth_unit)
    found = kernel_tables(near=steps, rays=cell_rays(calibration.depth, side))
    return jax.tree.map(jnp.asarray, found), Static(side)


def cells(depth: jax.Array, arrays: Tables, static: Static) -> Cells:
    """Return the cells of depth images, equal to :func:`jaxdet.reference.cells`.

    Args:
        depth: ``(B, Hd, Wd)`` uint16 [depth units], 0 = no measurement.
        arrays: From :func:`tables`.
        static: From :func:`tables`.
    """
    with jax.named_scope("cells"):
        shape = (depth.shape[0], *arrays["rays"].shape[1:])
        shapes: dict[str, tuple[int, ...]] = dict.fromkeys(_cells.outputs, shape)
        given = arrays | static._asdict()
        return Cells(*_cells(depth, **given, batch=shape[0], shapes=shapes, scratch=1))
