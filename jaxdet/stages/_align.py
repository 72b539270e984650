"""Stage 1, align: a Warp kernel under ``jax.jit``."""

from functools import lru_cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import warp as wp

from jaxdet.camera import corner_rays, splat_parameters
from jaxdet.checks import check_size
from jaxdet.runtime.calls import by_device, jax_callable, uninterrupted
from jaxdet.runtime.launch import on_cores
from jaxdet.types import AlignedDepth, Array, Calibration, Distortion
from jaxdet_kernels import align as kernels

_MODELS = Distortion.NONE, Distortion.PLUMB_BOB, Distortion.RATIONAL, Distortion.EQUIDISTANT
"""In the order of ``projection.h``."""


def align(depth: Array, calibration: Calibration) -> AlignedDepth:
    """Equals :func:`jaxdet.reference.align`.

    On the CPU, images whose memory starts at a multiple of 64 bytes are read where they are, so
    leave them alone until the results are ready. Tables made from the calibration are cached.

    Raises:
        CalibrationError: The images are not of the depth camera's size.
    """
    check_size("depth", np.shape(depth), calibration.depth)
    if calibration.is_aligned:
        depth = jnp.asarray(depth)
        return AlignedDepth(depth, depth)
    depth = jax.device_put(depth)
    size = calibration.image.height, calibration.image.width
    return AlignedDepth(*uninterrupted(align_arrays, depth, *tables(calibration), size))


@partial(jax.jit, static_argnames="size")
def align_arrays(
    depth: jax.Array, x: jax.Array, y: jax.Array, parameters: jax.Array, size: tuple[int, int]
) -> tuple[jax.Array, jax.Array]:
    """Depth and z at the colour pixels, from :func:`tables` and the colour image's size."""
    with jax.named_scope("align"):
        images, unused = (len(depth), *size), (1, 1, 1)

        def call(found: tuple[int, ...], keys: tuple[int, ...]) -> Any:
            dims = {"depth_out": found, "z_out": found, "keys_out": keys}
            return _align(depth, x, y, parameters, output_dims=dims)

        def on_cuda() -> tuple[jax.Array, jax.Array]:
            keys = call(unused, images)[2]
            keys = jnp.where(keys == jnp.uint32(kernels.NOTHING), jnp.uint32(0), keys)
            return (keys >> 16).astype(jnp.uint16), (keys & 0xFFFF).astype(jnp.uint16)

        return by_device(lambda: tuple(call(images, unused)[:2]), on_cuda)


@jax_callable(kernels, kernels.TYPES, outputs=3)
def _align(
    depth: Any, x: Any, y: Any, parameters: Any, depth_out: Any, z_out: Any, keys_out: Any
) -> None:
    """Launches a kernel: on CUDA it makes the keys alone, on the CPU all but these."""
    given = [depth, x, y, parameters]
    if depth.device.is_cpu:
        frames, *size = depth_out.shape
        words = kernels.lines_words(*size)
        on_cores(kernels.align_lines, [*given, depth_out, z_out], frames, words)
        return
    frames, rows, columns = depth.shape
    tiles = -(-rows // kernels.TILE_ROWS) * -(-columns // kernels.TILE_COLUMNS)
    keys_out.fill_(kernels.NOTHING)
    dims, block = (frames * tiles, kernels.TILE_BLOCK), kernels.TILE_BLOCK
    wp.launch(kernels.align_tiles, dims, [*given, keys_out], device=depth.device, block_dim=block)


@lru_cache(maxsize=8)
def tables(calibration: Calibration) -> tuple[jax.Array, jax.Array, jax.Array]:
    """The rays of the depth pixels' corners, and the parameters, on the device."""
    x, y = corner_rays(calibration.depth)
    return jnp.asarray(x), jnp.asarray(y), jnp.asarray(parameters(calibration))


def parameters(calibration: Calibration) -> np.ndarray:
    """The projection into the colour image, as the kernels take it, ``(PARAMETERS + 2,)``."""
    splat = splat_parameters(calibration)
    more = splat.max_r2, splat.depth_unit, _MODELS.index(splat.model), splat.fills_corners
    return np.concatenate(
        [splat.rotation, splat.translation, splat.pinhole, splat.lens, np.array(more, np.float32)]
    )
