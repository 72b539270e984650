"""The strongest corners of Canny's edges under a mask: one kernel on the CPU, four on CUDA."""

import math
import struct
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import warp as wp
from jax import lax

from jaxdet.config import FeaturesConfig
from jaxdet.runtime.calls import by_device, jax_callable
from jaxdet.runtime.launch import on_cores
from jaxdet.runtime.layout import Layout
from jaxdet_kernels import features as kernels


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
    """A mask ``(B, H, W)`` bool as bits ``(B, H, words)`` uint32; see ``pixel_bits.h``."""
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

    def corners(words: int) -> tuple[jax.Array, jax.Array, jax.Array]:
        found = dict.fromkeys(("u_out", "v_out"), (batch, slots))
        dims = {**found, "found_out": (batch,), "scratch_out": (words,)}
        return _corners(color, mask, settings, output_dims=dims)[:3]

    words = _scratch(batch, height, width, slots).words
    return by_device(lambda: corners(1), lambda: corners(words))


def _scratch(batch: int, height: int, width: int, slots: int) -> Layout:
    """What the kernels on CUDA hand on."""
    bits = batch, height, kernels.row_words(width)
    names = "weak", "strong", "edges", "maxima", "open", "taken"
    keys = batch, 2 << (slots - 1).bit_length()
    images = {"strength": (batch, height, width), "strongest": (batch,), "keys": keys}
    return Layout({**dict.fromkeys(names, bits), **images})


@jax_callable(kernels, kernels.TYPES, outputs=4)
def _corners(
    color: Any,
    mask: Any,
    settings: Any,
    u_out: Any,
    v_out: Any,
    found_out: Any,
    scratch_out: Any,
) -> None:
    """Launches the kernels; the scratch memory is not used on the CPU."""
    batch, height, width, _ = color.shape
    if color.device.is_cpu:
        arrays = [color, mask, settings, u_out, v_out, found_out]
        words = kernels.features_scratch(height, width)
        on_cores(kernels.features_frames, arrays, batch, words)
        return
    layout = _scratch(batch, height, width, u_out.shape[1])

    def of(name: str, dtype: Any = wp.uint32) -> Any:
        place, shape = scratch_out.ptr + 4 * layout.begin[name], layout.shapes[name]
        return wp.array(ptr=place, shape=shape, dtype=dtype, device=color.device)

    def launch(kernel: Any, blocks: int, width: int, arrays: Sequence[Any]) -> None:
        size = batch * blocks * width
        wp.launch(kernel, size, arrays, device=color.device, block_dim=width)

    def tiles(rows: int, columns: int) -> int:
        return -(-height // rows) * -(-width // columns)

    weak, strong, edges, maxima = map(of, ("weak", "strong", "edges", "maxima"))
    strength, strongest = of("strength", wp.float32), of("strongest", wp.int32)
    maxima.zero_()
    strongest.zero_()
    number = tiles(kernels.SUPPRESS_ROWS, kernels.SUPPRESS_COLUMNS)
    launch(
        kernels.canny_suppress, number, kernels.SUPPRESS_THREADS, [color, settings, weak, strong]
    )
    launch(kernels.canny_hysteresis, 1, kernels.HYSTERESIS_THREADS, [width, weak, strong, edges])
    number = tiles(kernels.MAXIMA_ROWS, kernels.MAXIMA_COLUMNS)
    found = [strongest, maxima, strength]
    launch(kernels.corners_maxima, number, kernels.MAXIMA_THREADS, [edges, mask, settings, *found])
    more = [of(name) for name in ("open", "taken", "keys")]
    given = [strongest, strength, settings, maxima]
    launch(
        kernels.corners_select, 1, kernels.SELECT_THREADS, [*given, u_out, v_out, found_out, *more]
    )
