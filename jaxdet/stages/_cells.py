"""Cells of the depth image, under ``jax.jit``."""

from functools import lru_cache
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxdet.camera import cell_rays, cell_side
from jaxdet.config import SurfaceConfig
from jaxdet.floor.plane import quadratic_table
from jaxdet.stages import _align
from jaxdet.stages._teams import Tables, TeamKernel, kernel_tables
from jaxdet.types import Calibration, Cells
from jaxdet_kernels import cells as kernels
from jaxdet_kernels.align import PARAMETERS

_cells = TeamKernel(kernels.cells)


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
    rays, offset = cell_rays(calibration, side)
    last = color.width - 1, color.height - 1
    if calibration.is_aligned:
        model, x, y = 0, *2 * [jnp.zeros((1, 1), jnp.float32)]
        parameters = jnp.zeros(PARAMETERS, jnp.float32)
    else:
        x, y, parameters, model, *_ = _align.tables(calibration)
        corners = tuple(slice(0, count * side + 1, side) for count in rays.shape[1:])
        x, y = x[corners], y[corners]
    found = kernel_tables(near=steps, rays=rays, offset=offset, last=last)
    found |= {"corner_x": x, "corner_y": y, "parameters": parameters}
    return jax.tree.map(jnp.asarray, found), Static(side, model, int(calibration.is_aligned))


def cells(depth: jax.Array, arrays: Tables, static: Static) -> Cells:
    """The cells of depth images, equal to :func:`jaxdet.reference.cells`.

    Args:
        depth: ``(B, Hd, Wd)`` uint16 [depth units], 0 = no measurement.
        arrays: From :func:`tables`.
        static: Likewise.
    """
    with jax.named_scope("cells"):
        shape = (depth.shape[0], *arrays["rays"].shape[1:])
        shapes: dict[str, tuple[int, ...]] = {
            **dict.fromkeys(_cells.outputs, shape),
            **dict.fromkeys(("uv_min_out", "uv_max_out"), (*shape, 2)),
        }
        given = arrays | static._asdict()
        return Cells(*_cells(depth, **given, batch=shape[0], shapes=shapes, scratch=1))
