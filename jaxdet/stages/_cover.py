"""Corners on cells, under ``jax.jit``."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxdet.stages._corners import strongest_corners
from jaxdet.stages._features import Rays
from jaxdet.stages._teams import TeamKernel
from jaxdet.types import Cells, Features
from jaxdet_kernels import cover as kernels
from jaxdet_kernels.features import row_words

_mask = TeamKernel(kernels.cover_mask, num_outputs=1)
_corners = TeamKernel(kernels.cover_corners, num_outputs=5)


class CellCorners(NamedTuple):
    """Corners, and what they take from their cells."""

    features: Features
    """``N`` slots a frame."""
    cell: jax.Array
    """``(B, N)`` int32, the corner's cell as index of the flattened grid; -1 where it has none."""
    label: jax.Array
    """``(B, N)`` int32, that cell's label, or -1."""


def corners_on_cells(
    color: jax.Array,
    grid: Cells,
    keep: jax.Array,
    label: jax.Array,
    rays: Rays,
    settings: jax.Array,
    slots: int,
) -> CellCorners:
    """The strongest corners, each with depth and label of the nearest kept cell over it.

    Args:
        color: ``(B, H, W, 3)`` uint8, RGB.
        grid: The cells.
        keep: ``(B, R, C)`` bool, those that corners may lie on, all of them in view.
        label: ``(B, R, C)`` int32.
        rays: The colour camera's.
        settings: From :func:`~jaxdet.stages._corners.corner_settings`.
        slots: ``N``, static.
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
        names = "cell_out", "label_out", "x_out", "y_out", "z_out"
        cell, label, x, y, z = _corners(
            *boxes, label, *rays, u, v, count,
            batch=batch,
            shapes=dict.fromkeys(names, u.shape),
            scratch=kernels.cover_scratch(cells, height, width, slots),
        )  # fmt: skip
        valid = jnp.arange(slots, dtype=jnp.int32)[None, :] < count[:, None]
        found = Features(u, v, x, y, z, valid, cell >= 0, overflow=count > slots)
        return CellCorners(found, cell, label)
