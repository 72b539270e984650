"""Stage 2, features: corners by a Warp kernel, and their depth."""

from functools import lru_cache, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxdet.camera import fixed_rays
from jaxdet.checks import check_size
from jaxdet.config import FeaturesConfig
from jaxdet.errors import ConfigError
from jaxdet.runtime.calls import uninterrupted
from jaxdet.stages.paper import _align
from jaxdet.stages.paper._corners import corner_settings, strongest_corners
from jaxdet.types import Array, Calibration, Features, Intrinsics
from jaxdet_kernels.features import MAX_SIZE


class Rays(NamedTuple):
    """Rays of a camera's pixels, from :func:`jaxdet.camera.fixed_rays`."""

    x: jax.Array  # (H, W) int32
    y: jax.Array  # (H, W) int32


@lru_cache(maxsize=8)
def rays(camera: Intrinsics) -> Rays:
    """Return the rays on the device."""
    return Rays(*(jnp.asarray(a) for a in fixed_rays(camera)))


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
    shared, static = tables(calibration, config)
    return uninterrupted(on_device, jnp.asarray(color), jnp.asarray(depth), shared, static)


class Tables(NamedTuple):
    """Arrays for :func:`on_device`, from a camera and a configuration."""

    align: _align.Tables
    rays: Rays
    corners: jax.Array


class Static(NamedTuple):
    """Sizes that :func:`on_device` is compiled for."""

    moved: tuple[int, int] | None  # size of the colour image; None: depth is already aligned
    slots: int  # maximum number of corners


def tables(calibration: Calibration, config: FeaturesConfig) -> tuple[Tables, Static]:
    """Return the tables on the device, and the sizes."""
    settings = jnp.asarray(corner_settings(config))
    shared = Tables(_align.tables(calibration), rays(calibration.image), settings)
    return shared, Static(_align.moved_size(calibration), config.max_corners)


def check_kernels_size(camera: Intrinsics) -> None:
    """Raise an error for colour images of a size that the kernels do not support.

    Raises:
        ConfigError: A side is shorter than 3 or longer than ``MAX_SIZE``.
    """
    if not 3 <= min(camera.width, camera.height) <= max(camera.width, camera.height) <= MAX_SIZE:
        raise ConfigError(
            f"colour images of {camera.width}x{camera.height} pixels, but the kernels take from "
            f"3 to {MAX_SIZE} a side",
            remedy="use --backend reference",
        )


@partial(jax.jit, static_argnames="static")
def on_device(color: jax.Array, depth: jax.Array, shared: Tables, static: Static) -> Features:
    """Return the features, from :func:`tables`."""
    with jax.named_scope("features"):
        u, v, count = strongest_corners(color, shared.corners, static.slots)
        _, z = _align.align_arrays(depth, u, v, shared.align, static.moved)
        valid = jnp.arange(static.slots, dtype=jnp.int32)[None, :] < count[:, None]
        z = jnp.where(valid, z.astype(jnp.int32), 0)
        x, y = (lateral(ray[v, u], z) for ray in shared.rays)
        return Features(u, v, x, y, z, valid=valid, kept=valid, overflow=count > static.slots)


def lateral(ray: jax.Array, z: jax.Array) -> jax.Array:
    """Return ``(ray * z + half) >> RAY_BITS`` in 32-bit arithmetic, ten fraction bits at a time.

    The result is exact for rays up to ``MAX_RAY`` and z below 2^16, as rounding down in two steps
    is: ``floor((a + 2^19) / 2^20) = floor((floor(a / 2^10) + 2^9) / 2^10)``.
    """
    product = (ray >> 10) * z + (((ray & 1023) * z) >> 10)
    return (product + 512) >> 10
