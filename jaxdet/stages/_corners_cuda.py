"""Corners on the device: Canny, Shi-Tomasi and the selection as Warp kernels, for CUDA."""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import warp as wp
from jax import lax

from jaxdet.config import FeaturesConfig
from jaxdet_kernels.features_canny import (
    SUPPRESS_BLOCK,
    SUPPRESS_COLUMNS,
    SUPPRESS_ROWS,
    canny_suppress,
)
from jaxdet_kernels.features_corners import EIGENVALUE_BLOCK, corners_eigenvalue
from jaxdet_kernels.features_hysteresis import HYSTERESIS_BLOCK, canny_hysteresis
from jaxdet_kernels.features_maxima import MAXIMA_BLOCK, corners_maxima
from jaxdet_kernels.features_select import SPREAD_BLOCK, corners_spread

CANDIDATES = 8192
"""Most maxima of a frame that are listed, a multiple of 256; a frame with more takes longer."""

_suppress = wp.jax_kernel(canny_suppress, num_outputs=2, block_dim=SUPPRESS_BLOCK)
_hysteresis = wp.jax_kernel(canny_hysteresis, block_dim=HYSTERESIS_BLOCK)
_eigenvalue = wp.jax_kernel(
    corners_eigenvalue,
    num_outputs=5,
    in_out_argnames=["best_out", "count_out"],
    block_dim=EIGENVALUE_BLOCK,
)
_maxima = wp.jax_kernel(corners_maxima, block_dim=MAXIMA_BLOCK)
_spread = wp.jax_kernel(corners_spread, num_outputs=5, block_dim=SPREAD_BLOCK)


def edges(color: jax.Array, low: int, high: int) -> jax.Array:
    """``cv2.Canny`` of the grey images.

    Args:
        color: ``(B, H, W, 3)`` uint8, RGB.
        low: Lower bound, from -1 to 2047.
        high: Upper bound, from -1 to 2047.

    Returns:
        ``(B, H, 2 ceil(W / 64))`` uint32, a bit a pixel.
    """
    batch, height, width, _ = color.shape
    words = 2 * -(-width // 64)
    tiles = -(-height // SUPPRESS_ROWS) * -(-width // SUPPRESS_COLUMNS)
    rows = (batch, height, words)
    candidates, strong = _suppress(
        color,
        low,
        high,
        launch_dims=(batch * tiles * SUPPRESS_BLOCK,),
        output_dims={"candidates_out": rows, "strong_out": rows},
    )
    (found,) = _hysteresis(
        candidates,
        strong,
        launch_dims=(batch * HYSTERESIS_BLOCK,),
        output_dims={"edges_out": rows},
    )
    return found


class Strengths(NamedTuple):
    """The minimum eigenvalue of edge images; strengths as integers have the same order."""

    strength: jax.Array
    """``(B, H, W)`` float32."""
    best: jax.Array
    """``(B,)`` int32, the strongest of each frame, of those allowed."""
    peak: jax.Array
    """``(B, H, words)`` int32, the strongest of each 32 columns of a row."""
    maxima: jax.Array
    """``(B,)`` int32, how many pixels may be 3x3 maxima above 0, at least."""
    listed: jax.Array
    """``(B, CANDIDATES)`` int32, their places ``v W + u`` as far as there is room, in no order."""


def strongest_corners(
    color: jax.Array, mask: jax.Array, config: FeaturesConfig
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """The strongest corners of the Canny edge images, as the reference selects them.

    Args:
        color: ``(B, H, W, 3)`` uint8, RGB.
        mask: ``(B, H, W)`` bool, where corners may be.
        config: Canny's bounds and the corner selection, static.

    Returns:
        Columns and rows ``(B, N)`` int32, strongest first, zero in empty slots, and how many
        corners qualify ``(B,)`` int32, which may be more than there are slots.
    """
    found = strengths(color, mask, config)
    rows = found.peak.shape
    (maxima,) = _maxima(
        found.strength,
        mask,
        found.best,
        found.peak,
        float(config.quality_level),
        launch_dims=(-(-math.prod(rows) // MAXIMA_BLOCK) * MAXIMA_BLOCK,),
        output_dims={"maxima_out": rows},
    )
    return select(found.strength, maxima, config)


def strengths(color: jax.Array, mask: jax.Array | None, config: FeaturesConfig) -> Strengths:
    """The strength of each pixel as a corner of the edge image; ``mask`` None allows all."""
    batch, height, width, _ = color.shape
    edge = edges(color, *config.canny_bounds)
    blocks = batch * -(-width // EIGENVALUE_BLOCK)
    best, count, strength, peak, listed = _eigenvalue(
        edge,
        jnp.ones((1, 1, 1), bool) if mask is None else mask,
        int(mask is not None),
        jnp.full(batch, jnp.iinfo(jnp.int32).min, jnp.int32),
        jnp.zeros(batch, jnp.int32),
        launch_dims=(blocks * EIGENVALUE_BLOCK,),
        output_dims={
            "best_out": (batch,),
            "count_out": (batch,),
            "strength_out": (batch, height, width),
            "peak_out": edge.shape,
            "list_out": (batch, CANDIDATES),
        },
    )
    return Strengths(strength, best, peak, count, listed)


def select(
    strength: jax.Array, maxima: jax.Array, config: FeaturesConfig
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """The corners among ``maxima``, a bit a pixel; see :func:`strongest_corners`."""
    batch, _, width = strength.shape
    slots = (batch, config.max_corners)
    strength_key, place_key, found, _, _ = _spread(
        strength,
        maxima,
        float(config.min_distance),
        launch_dims=(batch * SPREAD_BLOCK,),
        output_dims={
            "strength_key_out": slots,
            "place_key_out": slots,
            "found_out": (batch,),
            "undecided_out": maxima.shape,
            "taken_out": maxima.shape,
        },
    )
    _, place_key = lax.sort((strength_key, place_key), num_keys=2)
    place = (~place_key).astype(jnp.int32)
    v, u = place // width, place % width
    return u, v, found
