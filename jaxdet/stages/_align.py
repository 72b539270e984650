"""Stage 1, align: a Warp kernel under ``jax.jit``."""

from functools import lru_cache, partial

import jax
import jax.numpy as jnp
import numpy as np

from jaxdet.camera import corner_rays, splat_parameters
from jaxdet.checks import check_size
from jaxdet.stages._chain import FrameKernel, by_device
from jaxdet.stages._launch import BatchKernel
from jaxdet.types import AlignedDepth, Array, Calibration, Distortion
from jaxdet_kernels import align as kernels

_NOTHING = np.uint32(0xFFFFFFFF)
_MODELS = Distortion.NONE, Distortion.PLUMB_BOB, Distortion.RATIONAL, Distortion.EQUIDISTANT
"""In the order of ``native/projection.h``."""

_lines = FrameKernel(kernels.align_lines)
_tiles = BatchKernel(kernels.align_tiles, kernels.TILE_BLOCK)


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
    return AlignedDepth(*align_arrays(depth, *tables(calibration), size))


@partial(jax.jit, static_argnames=("model", "fills", "size"))
def align_arrays(
    depth: jax.Array,
    x: jax.Array,
    y: jax.Array,
    parameters: jax.Array,
    model: int,
    fills: int,
    size: tuple[int, int],
) -> tuple[jax.Array, jax.Array]:
    """Depth and z at the colour pixels, from :func:`tables` and the colour image's size."""
    with jax.named_scope("align"):
        frames, rows, columns = depth.shape
        by_lines = partial(
            _lines, depth, x, y, parameters, model, fills,
            batch=frames,
            shapes=dict.fromkeys(_lines.outputs, (frames, *size)),
            scratch=kernels.lines_words(*size),
        )  # fmt: skip

        def by_tiles() -> tuple[jax.Array, jax.Array]:
            tiles = -(-rows // kernels.TILE_ROWS) * -(-columns // kernels.TILE_COLUMNS)
            keys = jnp.full((frames, *size), _NOTHING)
            arguments = depth, x, y, parameters, model, fills, keys
            (keys,) = _tiles(*arguments, launch_dims=(frames * tiles, kernels.TILE_BLOCK))
            keys = jnp.where(keys == _NOTHING, jnp.uint32(0), keys)
            return (keys >> 16).astype(jnp.uint16), (keys & 0xFFFF).astype(jnp.uint16)

        return by_device(by_lines, by_tiles)


@lru_cache(maxsize=8)
def tables(calibration: Calibration) -> tuple[jax.Array, jax.Array, jax.Array, int, int]:
    """The calibration's arrays on the device, and the kernel's static arguments."""
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
        _MODELS.index(splat.model),
        int(splat.fills_corners),
    )
