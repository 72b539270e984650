"""Features on cells, under ``jax.jit``: corners, and a sample of the cells."""

from typing import NamedTuple

import jax

from jaxdet.stages._corners import strongest_corners
from jaxdet.stages._features import Rays
from jaxdet.stages._teams import TeamKernel
from jaxdet.types import MAX_OBSTACLES, SAMPLED_CELLS, Cells
from jaxdet_kernels import cover as kernels
from jaxdet_kernels.features import row_words

_mask = TeamKernel(kernels.cover_mask)
_features = TeamKernel(kernels.cover_features)


class CellFeatures(NamedTuple):
    """The features of a batch, and what they take from their cells."""

    slots: tuple[jax.Array, ...]
    """:class:`~jaxdet.types.Features` but for ``overflow``: ``N`` slots of corners a frame, then
    the sample."""
    label: jax.Array  # (B, N + S) int32, the cells' labels below MAX_OBSTACLES, or -1
    has_depth: jax.Array  # (B,) bool, some cell in view is in range


def features_on_cells(
    color: jax.Array,
    grid: Cells,
    keep: jax.Array,
    label: jax.Array,
    rays: Rays,
    settings: jax.Array,
    depth_range: jax.Array,
    slots: int,
) -> CellFeatures:
    """The strongest corners on kept cells, then a sample of the cells.

    A corner has the depth and the label of the nearest cell over it, of those that are kept, in
    view and in range.

    Args:
        color: ``(B, H, W, 3)`` uint8, RGB.
        grid: The cells.
        keep: ``(B, R, C)`` bool, above the floor and not too near.
        label: ``(B, R, C)`` int32, -1 = none.
        rays: The colour camera's.
        settings: From :func:`~jaxdet.stages._corners.corner_settings`.
        depth_range: ``(2,)`` int32, least and largest depth [depth units].
        slots: ``N``, static.
    """
    with jax.named_scope("features"):
        batch, height, width, _ = color.shape
        cells = keep.shape[1] * keep.shape[2]
        boxes = keep, grid.in_view, grid.z, grid.uv_min, grid.uv_max, depth_range
        mask, has_depth, *taken = _mask(
            *boxes, height, width,
            batch=batch,
            shapes={
                "mask_out": (batch, height, row_words(width)),
                "has_depth_out": (batch,),
                "num_taken_out": (batch,),
                "taken_out": (batch, cells),
            },
            scratch=1,
        )  # fmt: skip
        u, v, count = strongest_corners(color, mask, settings, slots)
        _, *sampled = (len(range(n)[of]) for n, of in zip(keep.shape, SAMPLED_CELLS, strict=True))
        *places, of_cells, valid, kept = _features(
            *boxes, *taken, grid.x, grid.y, label, MAX_OBSTACLES, *rays, u, v, count,
            batch=batch,
            shapes=dict.fromkeys(_features.outputs, (batch, slots + sampled[0] * sampled[1])),
            scratch=kernels.cover_scratch(height, width, slots),
        )  # fmt: skip
        return CellFeatures((*places, valid, kept), of_cells, has_depth)
