"""Corners on cells, under ``jax.jit``."""

import jax
import jax.numpy as jnp

from jaxdet.stages._corners import strongest_corners
from jaxdet.stages._features import Rays, lateral
from jaxdet.stages._teams import TeamKernel
from jaxdet.types import Cells, Features
from jaxdet_kernels import cover as kernels
from jaxdet_kernels.features import row_words

_mask = TeamKernel(kernels.cover_mask, num_outputs=1)
_corners = TeamKernel(kernels.cover_corners, num_outputs=1)


def corners_on_cells(
    color: jax.Array, grid: Cells, keep: jax.Array, rays: Rays, settings: jax.Array, slots: int
) -> tuple[Features, jax.Array]:
    """The strongest corners, each with the depth of the nearest kept cell over it.

    Args:
        color: ``(B, H, W, 3)`` uint8, RGB.
        grid: The cells.
        keep: ``(B, R, C)`` bool, those that corners may lie on, all of them in view.
        rays: The colour camera's.
        settings: From :func:`~jaxdet.stages._corners.corner_settings`.
        slots: ``N``, static.

    Returns:
        ``N`` slots a frame, and ``(B, N)`` int32, each corner's cell as index of the
        flattened grid, -1 where it lies on none.
    """
    with jax.named_scope("features"):
        batch, height, width, _ = color.shape
        boxes = keep, grid.z, grid.uv_min, grid.uv_max
        cells = keep.shape[1] * keep.shape[2]
        (mask,) = _mask(
            *boxes, height, width,
            batch=batch,
            shapes={"mask_out": (batch, height, row_words(width))},
            scratch=kernels.mask_scratch(cells),
        )  # fmt: skip
        u, v, count = strongest_corners(color, mask, settings, slots)
        (cell,) = _corners(
            *boxes, u, v, count, height, width,
            batch=batch,
            shapes={"cell_out": u.shape},
            scratch=kernels.cover_scratch(cells, height, width, slots),
        )  # fmt: skip
        valid = jnp.arange(slots, dtype=jnp.int32)[None, :] < count[:, None]
        cell = jnp.where(valid, cell, -1)
        z = jnp.take_along_axis(grid.z.reshape(batch, -1), jnp.maximum(cell, 0), axis=1)
        z = jnp.where(cell >= 0, z, 0)
        x, y = (lateral(ray[v, u], z) for ray in rays)
        overflow = count > slots
        return Features(u, v, x, y, z, valid, valid & (cell >= 0), overflow), cell
