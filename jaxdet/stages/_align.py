"""Stage 1, align: a Warp kernel under ``jax.jit``."""

from functools import lru_cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import warp as wp

from jaxdet.camera import corner_rays, splat_parameters
from jaxdet.types import AlignedDepth, Array, Calibration, Distortion
from jaxdet_kernels import align as kernels
from jaxdet_kernels import align_lines as line_kernels
from jaxdet_kernels import align_tiles as tile_kernels

_MODELS = {
    Distortion.NONE: kernels.PINHOLE,
    Distortion.PLUMB_BOB: kernels.PLUMB_BOB,
    Distortion.RATIONAL: kernels.RATIONAL,
    Distortion.EQUIDISTANT: kernels.EQUIDISTANT,
}

_splat = wp.jax_kernel(kernels.align_splat, in_out_argnames=["keys_out"])
_splat_tiles = wp.jax_kernel(
    tile_kernels.align_splat_tiles,
    in_out_argnames=["keys_out"],
    block_dim=tile_kernels.TILE_BLOCK,
)
_splat_lines = wp.jax_kernel(line_kernels.align_splat_lines, in_out_argnames=["keys_out"])
_splat_rows = wp.jax_kernel(kernels.align_splat_rows, in_out_argnames=["keys_out"])


def align(depth: Array, calibration: Calibration) -> AlignedDepth:
    """Moves each depth pixel into the colour image; the nearest wins (Eq. 1-4).

    Equals :func:`jaxdet.reference.align`. On CUDA each depth pixel is a thread that lowers the
    keys it covers atomically; on the CPU, where Warp runs threads one after the other, each row
    is one.

    Args:
        depth: ``(B, Hd, Wd)`` uint16 [depth units], 0 = no measurement.
        calibration: The log's calibration; the tables made from it are cached.

    Returns:
        ``(B, H, W)`` uint16 depth and z, as the reference.
    """
    depth = jnp.asarray(depth)
    if calibration.is_aligned:
        return AlignedDepth(depth, depth)
    size = calibration.color.height, calibration.color.width
    return AlignedDepth(*align_arrays(depth, *tables(calibration), size))


@partial(jax.jit, static_argnames=("model", "fills", "separable", "size"))
def align_arrays(
    depth: jax.Array,
    x: jax.Array,
    y: jax.Array,
    parameters: jax.Array,
    model: int,
    fills: int,
    separable: bool,
    size: tuple[int, int],
) -> tuple[jax.Array, jax.Array]:
    """Depth and z at the colour pixels, from :func:`tables` and the colour image's size."""
    with jax.named_scope("align"):
        nothing = jnp.uint32(0xFFFFFFFF)
        keys = jnp.full((depth.shape[0], *size), nothing)

        def on_cuda(keys: jax.Array) -> jax.Array:
            if separable:
                return _splat_in_tiles(depth, x, y, parameters, fills, keys)
            out = _splat(depth, x, y, parameters, model, fills, keys, launch_dims=depth.shape)
            return out[0]

        def on_cpu(keys: jax.Array) -> jax.Array:
            rows = depth.shape[:2]
            if separable and depth.shape[2] <= line_kernels.MAX_WIDTH:
                return _splat_lines(depth, x, y, parameters, fills, keys, launch_dims=rows)[0]
            return _splat_rows(depth, x, y, parameters, model, fills, keys, launch_dims=rows)[0]

        keys = jax.lax.platform_dependent(keys, cpu=on_cpu, cuda=on_cuda)
        keys = jnp.where(keys == nothing, jnp.uint32(0), keys)
        return (keys >> 16).astype(jnp.uint16), (keys & 0xFFFF).astype(jnp.uint16)


def _splat_in_tiles(
    depth: jax.Array, x: jax.Array, y: jax.Array, parameters: jax.Array, fills: int, keys: jax.Array
) -> jax.Array:
    batch, height, width = depth.shape
    tiles = -(-height // tile_kernels.TILE_ROWS) * -(-width // tile_kernels.TILE_COLUMNS)
    threads = batch * tiles * tile_kernels.TILE_BLOCK
    return _splat_tiles(depth, x, y, parameters, fills, keys, launch_dims=(threads,))[0]


@lru_cache(maxsize=8)
def tables(calibration: Calibration) -> tuple[jax.Array, jax.Array, jax.Array, int, int, bool]:
    """The calibration's arrays on the device, and the kernel's static arguments."""
    assert calibration.depth is not None  # splat_parameters says so with an error
    splat = splat_parameters(calibration)
    parameters = np.concatenate(
        [splat.rotation, splat.translation, splat.pinhole, splat.lens]
        + [np.array([splat.max_r2, splat.depth_unit], np.float32)]
    )
    x, y = corner_rays(calibration.depth)
    return (
        jnp.asarray(x),
        jnp.asarray(y),
        jnp.asarray(parameters),
        _MODELS[splat.model],
        int(splat.fills_corners),
        Distortion.NONE is splat.model is calibration.depth.distortion,
    )
