"""Stage 2, ground: one comparison a pixel."""

from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np

from jaxdet.config import Config, GroundConfig
from jaxdet.floor.plane import depth_range, floor_limits
from jaxdet.types import AlignedDepth, Calibration, GroundPlane, Intrinsics, Keep


def ground(
    aligned: AlignedDepth, plane: GroundPlane, calibration: Calibration, config: Config
) -> Keep:
    """Equals :func:`jaxdet.reference.ground`.

    What depends on the plane and the calibration is in a table made on the host once
    (:func:`jaxdet.floor.plane.floor_limits`); here each pixel is compared with it.
    """
    return keep(aligned.z, *tables(plane, calibration, config))


def tables(
    plane: GroundPlane, calibration: Calibration, config: Config
) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """The limits of the different planes, each frame's plane, the nearest and farthest depth.

    The last plane is repeated up to a power of two, so that few shapes are compiled.
    """
    settings, unit = config.ground, calibration.depth_unit
    rows = np.stack([np.asarray(part, np.float64) for part in plane], axis=1)
    different, which = np.unique(rows, axis=0, return_inverse=True)
    planes = tuple(map(tuple, different.tolist()))
    limits = _limits(calibration.image, planes, settings, unit)
    bounds = depth_range(settings.min_depth_m, settings.max_depth_m, unit)
    nearest, farthest = (jnp.asarray(np.int32(bound)) for bound in bounds)
    return limits, jnp.asarray(which.reshape(-1).astype(np.int32)), nearest, farthest


@lru_cache(maxsize=8)
def _limits(
    camera: Intrinsics, planes: tuple[tuple[float, ...], ...], settings: GroundConfig, unit: float
) -> jax.Array:
    """The limits of planes in order on the device."""
    limits, _ = floor_limits(camera, GroundPlane(*np.array(planes).T), settings, unit)
    spare = (1 << (len(limits) - 1).bit_length()) - len(limits)
    if spare:
        limits = np.concatenate([limits, np.repeat(limits[-1:], spare, axis=0)])
    return jnp.asarray(limits)


@jax.jit
def keep(
    z: jax.Array,
    limits: jax.Array,
    which: jax.Array,
    nearest: jax.Array,
    farthest: jax.Array,
) -> Keep:
    """The pixels kept, from :func:`tables`."""
    with jax.named_scope("ground"):
        depth = z.astype(nearest.dtype)  # in fine units the nearest may be more than 16 bits
        in_range = (depth >= nearest) & (depth <= farthest)
        mask = in_range & (z <= limits[which])
        return Keep(mask, z, in_range.any(axis=(1, 2)))
