"""The strongest corners of Canny's edges under a mask: one kernel on the CPU, four on CUDA."""

import math
import struct
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxdet.config import FeaturesConfig
from jaxdet.stages._chain import FrameKernel, by_device
from jaxdet.stages._launch import BatchKernel
from jaxdet_kernels import features as kernels

_frames = FrameKernel(kernels.features_frames)
_suppress = BatchKernel(kernels.canny_suppress, kernels.SUPPRESS_THREADS)
_hysteresis = BatchKernel(kernels.canny_hysteresis, kernels.HYSTERESIS_THREADS)
_maxima = BatchKernel(kernels.corners_maxima, kernels.MAXIMA_THREADS)
_select = BatchKernel(kernels.corners_select, kernels.SELECT_THREADS)


def corner_settings(config: FeaturesConfig) -> np.ndarray:
    """What the kernels take of the configuration, ``(6,)`` int32.

    Canny's thresholds, the square of the distance rounded up (squares of whole distances below it
    are below the square itself), the quality level as the two words of a float64, the lower first,
    and whether corners may be everywhere.
    """
    distance, quality = config.min_distance, struct.pack("<d", config.quality_level)
    limit = math.ceil(distance * distance) if distance >= 1 else 0
    words = *config.canny_bounds, limit, *struct.unpack("<2i", quality), not config.use_mask
    return np.array(words, np.int32)


def mask_bits(mask: jax.Array) -> jax.Array:
    """A mask ``(B, H, W)`` bool as bits ``(B, H, words)`` uint32; see ``include/jaxdet/pixel_bits.h``."""
    batch, height, width = mask.shape
    whole = jnp.pad(mask, ((0, 0), (0, 0), (0, -width % 64)))
    octets = jnp.packbits(whole, axis=-1, bitorder="little")
    return lax.bitcast_convert_type(octets.reshape(batch, height, -1, 4), jnp.uint32)


def strongest_corners(
    color: jax.Array, mask: jax.Array, settings: jax.Array, slots: int
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """The strongest corners of the Canny edge images, as the reference selects them.

    Args:
        color: ``(B, H, W, 3)`` uint8, RGB.
        mask: ``(B, H, words)`` uint32, where corners may be; see :func:`mask_bits`.
        settings: From :func:`corner_settings`.
        slots: ``N``, the most corners of a frame; static.

    Returns:
        Columns and rows ``(B, N)`` int32, strongest first, zero in empty slots, and how many
        corners qualify ``(B,)`` int32, where they are more than N perhaps too few.
    """
    batch, height, width, _ = color.shape
    found = {"u_out": (batch, slots), "v_out": (batch, slots), "found_out": (batch,)}

    def by_steps() -> tuple[jax.Array, jax.Array, jax.Array]:
        tiles = -(-height // kernels.MAXIMA_ROWS) * -(-width // kernels.MAXIMA_COLUMNS)
        strongest, maxima, strength = _maxima(
            _edges(color, settings),
            mask,
            settings,
            jnp.zeros(batch, jnp.int32),
            jnp.zeros(mask.shape, jnp.uint32),
            launch_dims=(batch * tiles * kernels.MAXIMA_THREADS,),
            output_dims={
                "strongest_out": (batch,),
                "maxima_out": mask.shape,
                "strength_out": (batch, height, width),
            },
        )
        keys = batch, 2 << (slots - 1).bit_length()
        _, u, v, count, *_ = _select(
            strongest,
            strength,
            settings,
            maxima,
            launch_dims=(batch * kernels.SELECT_THREADS,),
            output_dims={
                **dict.fromkeys(("maxima_out", "open_out", "taken_out"), mask.shape),
                **found,
                "keys_out": keys,
            },
        )
        return u, v, count

    scratch = kernels.features_scratch(height, width)
    by_frames = partial(_frames, color, mask, settings, batch=batch, shapes=found, scratch=scratch)
    return by_device(by_frames, by_steps)


def _edges(color: jax.Array, settings: jax.Array) -> jax.Array:
    """Canny's edges on CUDA, ``(B, H, words)`` uint32."""
    batch, height, width, _ = color.shape
    rows = batch, height, kernels.row_words(width)
    tiles = -(-height // kernels.SUPPRESS_ROWS) * -(-width // kernels.SUPPRESS_COLUMNS)
    weak, strong = _suppress(
        color,
        settings,
        launch_dims=(batch * tiles * kernels.SUPPRESS_THREADS,),
        output_dims={"weak_out": rows, "strong_out": rows},
    )
    (edges,) = _hysteresis(
        width,
        weak,
        strong,
        launch_dims=(batch * kernels.HYSTERESIS_THREADS,),
        output_dims={"edges_out": rows},
    )
    return edges
