"""Stage 1, align: a Warp kernel under ``jax.jit``."""

from functools import lru_cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import warp as wp

from jaxdet.camera import corner_rays, splat_parameters
from jaxdet.checks import check_depth
from jaxdet.stages._threads import FrameKernel, shares_of
from jaxdet.types import AlignedDepth, Array, Calibration, Distortion
from jaxdet_kernels import align as kernels
from jaxdet_kernels import align_lines as line_kernels
from jaxdet_kernels import align_tiles as tile_kernels

_NOTHING = np.uint32(0xFFFFFFFF)
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
_lines = FrameKernel(line_kernels.align_lines, num_outputs=3)
_splat_rows = wp.jax_kernel(kernels.align_splat_rows, in_out_argnames=["keys_out"])


def align(depth: Array, calibration: Calibration) -> AlignedDepth:
    """Moves each depth pixel into the colour image; the nearest wins (Eq. 1-4).

    Equals :func:`jaxdet.reference.align`. On CUDA each depth pixel is a thread that lowers the
    keys it covers atomically; on the CPU, where Warp runs threads one after the other, each frame
    is one, or each row where a lens is distorted.

    Args:
        depth: ``(B, Hd, Wd)`` uint16 [depth units], 0 = no measurement. On the CPU, images whose
            memory starts at a multiple of 64 bytes are read where they are, so leave them alone
            until the results are ready.
        calibration: The log's calibration; the tables made from it are cached.

    Returns:
        ``(B, H, W)`` uint16 depth and z, as the reference.

    Raises:
        CalibrationError: The images are not of the depth camera's size.
    """
    check_depth(np.shape(depth), calibration)
    if calibration.is_aligned:
        depth = jnp.asarray(depth)
        return AlignedDepth(depth, depth)
    depth = jax.device_put(depth)
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
    lines = separable and max(depth.shape[2], *size) <= line_kernels.MAX_SIZE
    with jax.named_scope("align"):

        def on_cuda() -> tuple[jax.Array, jax.Array]:
            keys = _no_keys(depth, size)
            if separable:
                return _split(_splat_in_tiles(depth, x, y, parameters, fills, keys))
            out = _splat(depth, x, y, parameters, model, fills, keys, launch_dims=depth.shape)
            return _split(out[0])

        def on_cpu() -> tuple[jax.Array, jax.Array]:
            if lines:
                return _align_lines(depth, x, y, parameters, fills, size)
            keys, rows = _no_keys(depth, size), depth.shape[:2]
            out = _splat_rows(depth, x, y, parameters, model, fills, keys, launch_dims=rows)
            return _split(out[0])

        return jax.lax.platform_dependent(cpu=on_cpu, cuda=on_cuda)


def _no_keys(depth: jax.Array, size: tuple[int, int]) -> jax.Array:
    return jnp.full((depth.shape[0], *size), _NOTHING)


def _split(keys: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Depth and z from the keys ``depth << 16 | z``."""
    keys = jnp.where(keys == _NOTHING, jnp.uint32(0), keys)
    return (keys >> 16).astype(jnp.uint16), (keys & 0xFFFF).astype(jnp.uint16)


def _align_lines(
    depth: jax.Array,
    x: jax.Array,
    y: jax.Array,
    parameters: jax.Array,
    fills: int,
    size: tuple[int, int],
) -> tuple[jax.Array, jax.Array]:
    frames = depth.shape[0]
    images = dict.fromkeys(("depth_out", "z_out"), (frames, *size))
    found, z, _ = _lines(
        depth,
        x,
        y,
        parameters,
        fills,
        frames=frames,
        output_dims={**images, "keys_out": (shares_of(frames), *size)},
    )
    return found, z


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
