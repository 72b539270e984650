"""Stage 3, features: Warp kernels and a look-up of depth."""

from functools import lru_cache, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxdet.camera import fixed_rays
from jaxdet.checks import check_size
from jaxdet.config import FeaturesConfig
from jaxdet.errors import ConfigError
from jaxdet.runtime.calls import uninterrupted
from jaxdet.stages._corners import corner_settings, mask_bits, strongest_corners
from jaxdet.types import Array, Calibration, Features, Intrinsics, Keep
from jaxdet_kernels.features import MAX_SIZE


class Rays(NamedTuple):
    """The rays of a camera's pixels, from :func:`jaxdet.camera.fixed_rays`."""

    x: jax.Array  # (H, W) int32
    y: jax.Array  # (H, W) int32


@lru_cache(maxsize=8)
def rays(camera: Intrinsics) -> Rays:
    """The rays on the device."""
    return Rays(*(jnp.asarray(a) for a in fixed_rays(camera)))


def features(
    color: Array,
    keep: Keep,
    calibration: Calibration,
    config: FeaturesConfig,
) -> Features:
    """Equals :func:`jaxdet.reference.features`, in one program.

    Raises:
        CalibrationError: The images or the mask are not of the colour camera's size.
        ConfigError: That size is not one that the kernels take, see :func:`check_kernels_size`.
    """
    check_kernels_size(calibration.image)
    for what, images in (("colour", color), ("mask", keep.mask)):
        check_size(what, images.shape, calibration.image)
    arrays = rays(calibration.image)
    settings = jnp.asarray(corner_settings(config))
    given = jnp.asarray(color), keep.z, keep.mask, arrays, settings
    return uninterrupted(on_device, *given, config.max_corners)


def check_kernels_size(camera: Intrinsics) -> None:
    """Refuses colour images that the kernels have no room for.

    Raises:
        ConfigError: A side is shorter than 3 or longer than ``MAX_SIZE``.
    """
    if not 3 <= min(camera.width, camera.height) <= max(camera.width, camera.height) <= MAX_SIZE:
        raise ConfigError(
            f"colour images of {camera.width}x{camera.height} pixels, but the kernels take from "
            f"3 to {MAX_SIZE} a side",
            remedy="use --backend reference",
        )


@partial(jax.jit, static_argnames="slots")
def on_device(
    color: jax.Array,
    z: jax.Array,
    keep: jax.Array,
    arrays: Rays,
    settings: jax.Array,
    slots: int,
) -> Features:
    """The features, from :func:`rays` and :func:`~jaxdet.stages._corners.corner_settings`."""
    with jax.named_scope("features"):
        found = strongest_corners(color, mask_bits(keep), settings, slots)
        return _look_up(*found, z, keep, arrays)


def _look_up(
    u: jax.Array,
    v: jax.Array,
    count: jax.Array,
    z: jax.Array,
    keep: jax.Array,
    arrays: Rays,
) -> Features:
    """The features' depth, coordinates and flags, from their pixels ``(B, N)``."""
    n = u.shape[1]
    valid = jnp.arange(n, dtype=jnp.int32)[None, :] < count[:, None]
    frame = jnp.arange(u.shape[0], dtype=jnp.int32)[:, None]
    z = jnp.where(valid, z[frame, v, u].astype(jnp.int32), 0)
    x, y = (lateral(ray[v, u], z) for ray in arrays)
    return Features(u, v, x, y, z, valid, valid & keep[frame, v, u], overflow=count > n)


def lateral(ray: jax.Array, z: jax.Array) -> jax.Array:
    """``(ray * z + half) >> RAY_BITS`` without leaving 32 bits: ten fraction bits at a time.

    Holds for rays up to ``MAX_RAY`` and z below 2^16, as the floors nest:
    ``floor((a + 2^19) / 2^20) = floor((floor(a / 2^10) + 2^9) / 2^10)``.
    """
    product = (ray >> 10) * z + (((ray & 1023) * z) >> 10)
    return (product + 512) >> 10
