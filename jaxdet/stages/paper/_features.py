"""Stage 2, features: corners of Canny edges by a Warp kernel, and their depth."""

import math
import struct
from functools import lru_cache, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxdet.camera import fixed_rays
from jaxdet.checks import check_size
from jaxdet.config import FeaturesConfig
from jaxdet.errors import ConfigError
from jaxdet.runtime.calls import frame_kernel, uninterrupted
from jaxdet.stages.paper import _align
from jaxdet.types import Array, Calibration, Features, Intrinsics
from jaxdet_kernels import paper as kernels

_corners = frame_kernel(kernels, kernels.corners, kernels.corners_words, outputs=3)


def features(
    color: Array, depth: Array, calibration: Calibration, config: FeaturesConfig
) -> Features:
    """Detect corners and their positions; twin of :func:`jaxdet.reference.paper.features`.

    Raises:
        CalibrationError: The size of the images does not match the cameras.
        ConfigError: The kernels do not support this size, see :func:`check_kernels_size`.
    """
    check_kernels_size(calibration.image)
    check_size("colour", color.shape, calibration.image)
    check_size("depth", depth.shape, calibration.depth)
    inputs = jnp.asarray(color), jnp.asarray(depth), tables(calibration, config)
    return uninterrupted(on_device, *inputs, config.max_corners)


class Tables(NamedTuple):
    """Arrays for :func:`on_device`, from a camera and a configuration."""

    align: _align.Tables
    rays: tuple[jax.Array, jax.Array]
    """Rays of the pixels, ``(H, W)`` int32 each, from :func:`jaxdet.camera.fixed_rays`."""
    corners: jax.Array
    """Settings of the corners, from :func:`corner_settings`."""


def tables(calibration: Calibration, config: FeaturesConfig) -> Tables:
    """Return the tables on the device."""
    settings = jnp.asarray(corner_settings(config))
    return Tables(_align.tables(calibration), _rays(calibration.image), settings)


@lru_cache(maxsize=8)
def _rays(camera: Intrinsics) -> tuple[jax.Array, jax.Array]:
    x, y = fixed_rays(camera)
    return jnp.asarray(x), jnp.asarray(y)


def corner_settings(config: FeaturesConfig) -> np.ndarray:
    """Return the words of ``CornerSettings`` in ``corners.h``, int32.

    The minimum distance is squared and rounded up, which does not change any comparison, because
    squared distances between pixels are integers.
    """
    distance = config.min_distance
    limit = math.ceil(distance * distance) if distance >= 1 else 0
    words = struct.pack("<3i4xd", *config.canny_bounds, limit, config.quality_level)
    return np.frombuffer(words, np.int32)


def check_kernels_size(camera: Intrinsics) -> None:
    """Raise an error for colour images of a size that the kernels do not support.

    Raises:
        ConfigError: A side is shorter than 3 or longer than ``MAX_SIZE``.
    """
    least, most = sorted((camera.width, camera.height))
    if least < 3 or most > kernels.MAX_SIZE:
        raise ConfigError(
            f"colour images have {camera.width}x{camera.height} pixels, but the kernels take from "
            f"3 to {kernels.MAX_SIZE} pixels per side",
            remedy="use --backend reference",
        )


@partial(jax.jit, static_argnames="slots")
def on_device(color: jax.Array, depth: jax.Array, shared: Tables, slots: int) -> Features:
    """Return the features, at most ``slots`` per frame; ``shared`` is from :func:`tables`."""
    with jax.named_scope("features"):
        batch, *size, _ = color.shape
        dims = {"u": (batch, slots), "v": (batch, slots), "number": (batch,)}
        u, v, count = _corners(color, shared.corners, size=size, output_dims=dims)
        _, z = _align.align_arrays(depth, u, v, shared.align, tuple(size))
        valid = jnp.arange(slots, dtype=jnp.int32)[None, :] < count[:, None]
        z = jnp.where(valid, z.astype(jnp.int32), 0)
        x, y = (lateral(ray[v, u], z) for ray in shared.rays)
        return Features(u, v, x, y, z, valid=valid, kept=valid, overflow=count > slots)


def lateral(ray: jax.Array, z: jax.Array) -> jax.Array:
    """Return ``(ray * z + half) >> RAY_BITS`` in 32-bit arithmetic, ten fraction bits at a time.

    The result is exact for rays up to ``MAX_RAY`` and z below 2^16, as rounding down in two steps
    is: ``floor((a + 2^19) / 2^20) = floor((floor(a / 2^10) + 2^9) / 2^10)``.
    """
    product = (ray >> 10) * z + (((ray & 1023) * z) >> 10)
    return (product + 512) >> 10
