"""Stage 1, align: depth at pixels of the colour image, by a Warp kernel under ``jax.jit``."""

from functools import lru_cache, partial

import jax
import jax.numpy as jnp
import numpy as np

from jaxdet.camera import corner_rays
from jaxdet.checks import check_size
from jaxdet.runtime.calls import frame_kernel, uninterrupted
from jaxdet.stages._tables import parameters
from jaxdet.types import AlignedDepth, Array, Calibration
from jaxdet_kernels import paper as kernels

Tables = tuple[jax.Array, ...]
"""Rays of the depth pixels' corners, bounds of the rays of tiles, and parameters; empty if depth is
already aligned."""

_align = frame_kernel(kernels, kernels.align, kernels.align_words, outputs=1)


def align(depth: Array, u: Array, v: Array, calibration: Calibration) -> AlignedDepth:
    """Return depth at pixels of the colour image; twin of :func:`jaxdet.reference.paper.align`.

    On the CPU, images whose memory is aligned to 64 bytes are read in place; do not modify them
    until the results are ready. Tables for the calibration are cached.

    Args:
        depth: Depth images ``(B, Hd, Wd)`` uint16 [depth units], 0 = no measurement.
        u: Columns of pixels of the colour image, ``(B, N)`` int32.
        v: Rows of the pixels, ``(B, N)`` int32.
        calibration: Calibration of the log.

    Returns:
        Depth and z ``(B, N)`` uint16.

    Raises:
        CalibrationError: The images are not of the depth camera's size.
    """
    check_size("depth", np.shape(depth), calibration.depth)
    inputs = jax.device_put(depth), jnp.asarray(u), jnp.asarray(v), tables(calibration)
    size = calibration.image.height, calibration.image.width
    return AlignedDepth(*uninterrupted(align_arrays, *inputs, size))


@partial(jax.jit, static_argnames="size")
def align_arrays(
    depth: jax.Array, u: jax.Array, v: jax.Array, tables: Tables, size: tuple[int, int]
) -> tuple[jax.Array, jax.Array]:
    """Return depth and z at pixels.

    The arguments are those of :func:`align`, but the calibration is replaced by the result of
    :func:`tables`, and height and width of the colour image.
    """
    if not tables:
        found = depth[jnp.arange(len(depth))[:, None], v, u]
        return found, found
    missing = [(0, max(kernels.TILE - side, 0)) for side in depth.shape[1:]]
    if any(more for _, more in missing):  # the kernel needs at least one complete tile
        depth = jnp.pad(depth, [(0, 0), *missing])
    with jax.named_scope("align"):
        (keys,) = _align(depth, *tables, u, v, size=size, output_dims={"keys": u.shape})
        return (keys >> 16).astype(jnp.uint16), (keys & 0xFFFF).astype(jnp.uint16)


@lru_cache(maxsize=8)
def tables(calibration: Calibration) -> Tables:
    """Return the tables for a calibration, on the device."""
    if calibration.is_aligned:
        return ()
    rays, image = np.stack(corner_rays(calibration.depth)), calibration.image
    missing = [(0, max(kernels.TILE + 1 - side, 0)) for side in rays.shape[1:]]
    rays = np.pad(rays, [(0, 0), *missing], "edge")
    numbers = *parameters(calibration), image.height, image.width
    return tuple(jnp.asarray(a) for a in (rays, tile_rays(rays), np.array(numbers, np.float32)))


def tile_rays(rays: np.ndarray) -> np.ndarray:
    """Return bounds of the corner rays of each tile of depth pixels.

    Args:
        rays: Rays x / z and y / z, ``(2, Hd + 1, Wd + 1)`` float32, see
            :func:`jaxdet.camera.corner_rays`.

    Returns:
        Smallest and largest x, then y, of the corners of each tile's pixels, ``(tiles, 4)``
        float32.
    """
    return np.stack([_over_tiles(f, image) for image in rays for f in (np.minimum, np.maximum)], 1)


def _over_tiles(extreme: np.ufunc, image: np.ndarray) -> np.ndarray:
    """Reduce the corners of each tile's pixels, to ``(tiles,)``; tiles as in ``alignment.h``."""
    for axis, size in enumerate(image.shape):
        first = np.minimum(np.arange(0, size - 1, kernels.TILE), size - 1 - kernels.TILE)
        image = extreme.reduce([np.take(image, first + i, axis) for i in range(kernels.TILE + 1)])
    return image.ravel()
