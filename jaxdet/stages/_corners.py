"""The strongest corners of Canny's edges under a mask: a kernel for the CPU and one for CUDA."""

import math
import struct
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import warp as wp
from jax import lax

from jaxdet.config import FeaturesConfig
from jaxdet.runtime.calls import by_device, jax_callable
from jaxdet.runtime.launch import most_teams, on_cores, reported_words
from jaxdet_kernels import features as kernels


def corner_settings(config: FeaturesConfig) -> np.ndarray:
    """Return the settings as the kernels take them, ``(6,)`` int32.

    Canny's thresholds, the square of the distance rounded up (squares of whole distances below it
    are below the square itself), the quality level as the two words of a float64, the lower first,
    and whether corners may be everywhere.
    """
    distance, quality = config.min_distance, struct.pack("<d", config.quality_level)
    limit = math.ceil(distance * distance) if distance >= 1 else 0
    words = *config.canny_bounds, limit, *struct.unpack("<2i", quality), not config.use_mask
    return np.array(words, np.int32)


def mask_bits(mask: jax.Array) -> jax.Array:
    """Pack a mask ``(B, H, W)`` bool into bits ``(B, H, words)`` uint32; see ``pixel_bits.h``."""
    batch, height, width = mask.shape
    whole = jnp.pad(mask, ((0, 0), (0, 0), (0, -width % 64)))
    octets = jnp.packbits(whole, axis=-1, bitorder="little")
    return lax.bitcast_convert_type(octets.reshape(batch, height, -1, 4), jnp.uint32)


def strongest_corners(
    color: jax.Array, mask: jax.Array, settings: jax.Array, slots: int
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return the strongest corners of the Canny edge images, as the reference selects them.

    Args:
        color: ``(B, H, W, 3)`` uint8, RGB.
        mask: ``(B, H, words)`` uint32, where corners may be; see :func:`mask_bits`.
        settings: From :func:`corner_settings`.
        slots: ``N``, the most corners of a frame; static.

    Returns:
        Columns and rows ``(B, N)`` int32, strongest first, zero in empty slots, and the number of
        corners ``(B,)`` int32, at most ``N + 1``.
    """
    batch, height, width, _ = color.shape

    def corners(scratch: int) -> tuple[jax.Array, jax.Array, jax.Array]:
        found = dict.fromkeys(("u_out", "v_out"), (batch, slots))
        dims = {**found, "found_out": (batch,), "scratch": (scratch,)}
        return _corners(color, mask, settings, output_dims=dims)[:3]

    words = _words(height, width)
    teams = most_teams(batch, words, kernels.BLOCKS)
    return by_device(lambda: corners(1), lambda: corners(teams * words))


@lru_cache(maxsize=64)
def _words(height: int, width: int) -> int:
    return reported_words(kernels, [height, width])


@jax_callable(kernels, kernels.TYPES, outputs=4)
def _corners(
    color: Any, mask: Any, settings: Any, u_out: Any, v_out: Any, found_out: Any, scratch: Any
) -> None:
    """Launch the kernel of the arrays' device; the scratch memory is not used on the CPU."""
    batch, height, width, _ = color.shape
    arrays = [color, mask, settings, u_out, v_out, found_out]
    words = _words(height, width)
    if color.device.is_cpu:
        on_cores(kernels.corners, arrays, batch, words)
        return
    given, teams = [*arrays, scratch, settings], len(scratch) // words
    block, device = kernels.WIDTH, color.device
    wp.launch(kernels.corners, teams * block, given, device=device, block_dim=block)
