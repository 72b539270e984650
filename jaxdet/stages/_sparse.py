"""Stages 1 to 3 without a dense alignment: depth is looked up where features are; for CUDA.

Equal to align, ground and features one after the other, at every feature.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import warp as wp

from jaxdet.camera import grid_pixels
from jaxdet.config import FeaturesConfig
from jaxdet.stages import _align_points, _corners_cuda
from jaxdet.stages._features import Tables, lateral
from jaxdet.types import Features
from jaxdet_kernels import features as kernels

PROBE_COLUMNS = 16
"""Pixels of a grid this wide tell whether a frame has depth at all, where no grid is asked for."""

_corners_check = wp.jax_kernel(
    kernels.corners_check,
    num_outputs=2,
    in_out_argnames=["best_out"],
    block_dim=kernels.CANDIDATES_BLOCK,
)
_corners_strongest = wp.jax_kernel(
    kernels.corners_strongest,
    in_out_argnames=["best_out"],
    block_dim=kernels.CANDIDATES_BLOCK,
)
_corners_lookup = wp.jax_kernel(kernels.corners_lookup, block_dim=kernels.LOOKUP_BLOCK)
_has_depth = wp.jax_kernel(kernels.ground_has_depth, block_dim=kernels.LOOKUP_BLOCK)


class Floor(NamedTuple):
    """What :func:`jaxdet.stages._ground.tables` returns."""

    limits: jax.Array
    which: jax.Array
    nearest: jax.Array
    farthest: jax.Array


class Source(NamedTuple):
    """Where depth is looked up: the images and what the kernels take with them."""

    depth: jax.Array
    tiles: jax.Array
    ranges: jax.Array
    corner_x: jax.Array
    corner_y: jax.Array
    parameters: jax.Array
    search: jax.Array


def features(
    color: jax.Array,
    depth: jax.Array,
    align: tuple[jax.Array, ...],
    fills: int,
    floor: Floor,
    tables: Tables,
    config: FeaturesConfig,
) -> tuple[Features, jax.Array]:
    """The features, and whether a frame has any depth in range.

    Args:
        color: ``(B, H, W, 3)`` uint8, RGB.
        depth: ``(B, Hd, Wd)`` uint16 [depth units].
        align: The arrays of :func:`jaxdet.stages._align_points.tables`.
        fills: Its last value.
        floor: The floor's limits and the range of depth.
        tables: From :func:`jaxdet.stages._features.tables`.
        config: Canny's bounds and the corner selection, static.

    Returns:
        What :func:`jaxdet.stages.features` returns, and ``has_depth`` ``(B,)`` of
        :class:`jaxdet.types.Keep`.
    """
    batch, height, width, _ = color.shape
    source = Source(depth, *_align_points.depth_ranges(depth), *align)
    u, v, count = _corners(color, source, fills, floor, config)
    n, points = u.shape[1], len(tables.grid_u)
    used = jnp.arange(n, dtype=jnp.int32)[None, :] < count[:, None]
    with jax.named_scope("features"):
        extra = tables.grid_u, tables.grid_v
        if not points:
            extra = tuple(map(jnp.asarray, grid_pixels(width, height, PROBE_COLUMNS)))
        more_u, more_v = (jnp.broadcast_to(a[None, :], (batch, len(a))) for a in extra)
        asked_u = jnp.concatenate([jnp.where(used, u, -1), more_u], axis=1)
        v = jnp.concatenate([v, more_v], axis=1)
        _, z = _align_points.look_up(source.depth, asked_u, v, *source[1:3], source[3:], fills)
        in_range = (z >= floor.nearest) & (z <= floor.farthest)
        has_depth = _any_depth(in_range.any(axis=1), source, fills, floor, (height, width))
        u = jnp.concatenate([u, more_u], axis=1)
        u, v, z, in_range = (a[:, : n + points] for a in (u, v, z, in_range))
        keep = in_range & (z <= floor.limits[floor.which[:, None], v, u])
        grid = jnp.arange(n + points, dtype=jnp.int32)[None, :] >= n
        used = jnp.pad(used, ((0, 0), (0, points)))
        valid = jnp.where(grid, keep, used)
        z = jnp.where(grid | used, z.astype(jnp.int32), 0)
        x, y = (lateral(ray[v, u], z) for ray in (tables.ray_x, tables.ray_y))
        found = Features(u, v, x, y, z, valid, valid & keep, overflow=count > n)
    return found, has_depth


def _corners(
    color: jax.Array, source: Source, fills: int, floor: Floor, config: FeaturesConfig
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """The corners as :func:`jaxdet.stages._corners_cuda.strongest_corners` returns them."""
    with jax.named_scope("features"):
        found = _corners_cuda.strengths(color, None, config)
        places = floor.limits, floor.which, jnp.stack([floor.nearest, floor.farthest]), fills
        best, allowed = found.best, found.listed
        if config.use_mask:
            best, allowed = _allowed(found, source, places)
        (maxima,) = _corners_lookup(
            found.strength,
            found.peak,
            found.best,
            allowed,
            found.maxima,
            best,
            *source,
            *places,
            float(config.quality_level),
            int(config.use_mask),
            launch_dims=(color.shape[0] * kernels.LOOKUP_BLOCK,),
            output_dims={"maxima_out": found.peak.shape},
        )
        return _corners_cuda.select(found.strength, maxima, config)


def _allowed(
    found: _corners_cuda.Strengths, source: Source, places: tuple
) -> tuple[jax.Array, jax.Array]:
    """The strongest allowed pixel ``(B,)``, 0 for none, and the listed ones, -1 if not allowed."""
    batch, _ = lists = found.listed.shape
    best, allowed = _corners_check(
        found.strength,
        found.listed,
        found.maxima,
        *source,
        *places,
        jnp.zeros(batch, jnp.int32),
        launch_dims=(math.prod(lists),),
        output_dims={"best_out": (batch,), "allowed_out": lists},
    )
    block = kernels.CANDIDATES_BLOCK
    blocks = -(-math.prod(found.peak.shape) // (4 * block))
    (best,) = _corners_strongest(
        found.strength, found.peak, *source, *places, best, launch_dims=(blocks * block,)
    )
    return best, allowed


def _any_depth(
    known: jax.Array, source: Source, fills: int, floor: Floor, size: tuple[int, int]
) -> jax.Array:
    """Whether any pixel of a frame has a depth in range: ``known``, or by a look at all."""
    (found,) = _has_depth(
        known,
        *source,
        jnp.stack([floor.nearest, floor.farthest]),
        fills,
        *size,
        launch_dims=(known.shape[0] * kernels.LOOKUP_BLOCK,),
        output_dims={"has_depth_out": known.shape},
    )
    return found
