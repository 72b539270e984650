"""Stage 3, ground: comparison of each feature's depth with the limit of its pixel."""

from functools import lru_cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxdet.config import Config, GroundConfig
from jaxdet.floor.plane import depth_range, floor_limits
from jaxdet.types import Calibration, Features, GroundPlane, Intrinsics


def ground(
    features: Features, plane: GroundPlane, calibration: Calibration, config: Config
) -> Features:
    """Mark features above the floor; twin of :func:`jaxdet.reference.paper.ground`.

    The host tabulates a maximum depth per plane and pixel once
    (:func:`jaxdet.floor.plane.floor_limits`); here each feature's z is compared with it.
    """
    return keep(features, tables(plane, calibration, config))


class Tables(NamedTuple):
    """Arrays for :func:`keep`, from the floors and the configuration."""

    limits: jax.Array
    """Depth limits of the pixels for each distinct plane, ``(P, H, W)`` uint16 [depth units]."""
    which: jax.Array
    """Index of the plane of each frame, ``(B,)`` int32."""
    nearest: jax.Array
    farthest: jax.Array


def tables(plane: GroundPlane, calibration: Calibration, config: Config) -> Tables:
    """Return the tables on the device.

    The last plane is repeated up to a power of two, so that few shapes are compiled.
    """
    settings, unit = config.ground, calibration.depth_unit
    rows = np.stack([np.asarray(part, np.float64) for part in plane], axis=1)
    different, which = np.unique(rows, axis=0, return_inverse=True)
    planes = tuple(map(tuple, different.tolist()))
    limits = _limits(calibration.image, planes, settings, unit)
    bounds = depth_range(settings.min_depth_m, settings.max_depth_m, unit)
    nearest, farthest = (jnp.asarray(np.int32(bound)) for bound in bounds)
    return Tables(limits, jnp.asarray(which.reshape(-1).astype(np.int32)), nearest, farthest)


@lru_cache(maxsize=8)
def _limits(
    camera: Intrinsics, planes: tuple[tuple[float, ...], ...], settings: GroundConfig, unit: float
) -> jax.Array:
    """Return the depth limits of each plane's pixels, padded as in :func:`tables`."""
    limits, _ = floor_limits(camera, GroundPlane(*np.array(planes).T), settings, unit)
    spare = (1 << (len(limits) - 1).bit_length()) - len(limits)
    if spare:
        limits = np.concatenate([limits, np.repeat(limits[-1:], spare, axis=0)])
    return jnp.asarray(limits)


@jax.jit
def keep(features: Features, floors: Tables) -> Features:
    """Return the features with ``kept`` set."""
    with jax.named_scope("ground"):
        z, limit = features.z, floors.limits[floors.which[:, None], features.v, features.u]
        in_range = (z >= floors.nearest) & (z <= floors.farthest)
        kept = features.valid & in_range & (z <= limit.astype(z.dtype))
        return features._replace(kept=kept)
