"""Cells of the depth image, under ``jax.jit``."""

from functools import lru_cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxdet.camera import cell_rays, cell_side
from jaxdet.config import SurfaceConfig
from jaxdet.floor.plane import quadratic_table
from jaxdet.stages import _align
from jaxdet.stages._teams import TeamKernel, kernel_table
from jaxdet.types import Calibration, Cells
from jaxdet_kernels import cells as kernels
from jaxdet_kernels.align import PARAMETERS

_cells = TeamKernel(kernels.cells)


class Tables(NamedTuple):
    """A calibration's arrays on the device, as the kernel takes them."""

    near: jax.Array
    rays: jax.Array
    offset: jax.Array
    corner_x: jax.Array
    corner_y: jax.Array
    parameters: jax.Array
    last: jax.Array


class Static(NamedTuple):
    """What a compiled program is for."""

    side: int
    model: int
    aligned: int


@lru_cache(maxsize=8)
def tables(calibration: Calibration, config: SurfaceConfig) -> tuple[Tables, Static]:
    """What :func:`cells` takes beside the images.

    Raises:
        CalibrationError: The calibration can't be used.
    """
    camera, color = calibration.depth or calibration.color, calibration.color
    side = cell_side(camera, config.cell_rad)
    steps = quadratic_table(config.step_m, config.step_per_m, calibration.depth_unit)
    near = jnp.asarray(kernel_table(steps))
    rays, offset = (jnp.asarray(a.astype(np.int32)) for a in cell_rays(calibration, side))
    last = jnp.array([color.width - 1, color.height - 1], jnp.int32)
    if calibration.is_aligned:
        none, parameters = jnp.zeros((1, 1), jnp.float32), jnp.zeros(PARAMETERS, jnp.float32)
        return Tables(near, rays, offset, none, none, parameters, last), Static(side, 0, 1)
    x, y, parameters, model, *_ = _align.tables(calibration)
    corners = tuple(slice(0, count * side + 1, side) for count in rays.shape[1:])
    return Tables(near, rays, offset, x[corners], y[corners], parameters, last), Static(
        side, model, 0
    )


def cells(depth: jax.Array, arrays: Tables, static: Static) -> Cells:
    """The cells of depth images, equal to :func:`jaxdet.reference.cells`.

    Args:
        depth: ``(B, Hd, Wd)`` uint16 [depth units], 0 = no measurement.
        arrays: From :func:`tables`.
        static: Likewise.
    """
    with jax.named_scope("cells"):
        shape = (depth.shape[0], *arrays.rays.shape[1:])
        shapes: dict[str, tuple[int, ...]] = {
            **dict.fromkeys(_cells.outputs, shape),
            **dict.fromkeys(("uv_min_out", "uv_max_out"), (*shape, 2)),
        }
        found = _cells(depth, *arrays, *static, batch=shape[0], shapes=shapes, scratch=1)
        return Cells(*found)
