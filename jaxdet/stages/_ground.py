"""Stage 2, ground: one comparison a pixel."""

from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np

from jaxdet.config import Config
from jaxdet.plane import floor_limits
from jaxdet.types import AlignedDepth, Calibration, GroundPlane, Keep


def ground(
    aligned: AlignedDepth, plane: GroundPlane, calibration: Calibration, config: Config
) -> Keep:
    """Keeps pixels whose depth is in range and whose height is above the step height (Eq. 5).

    Equals :func:`jaxdet.reference.ground`. What depends on the plane and the calibration is in
    a table made on the host once (:func:`jaxdet.plane.floor_limits`); here each pixel is
    compared with it.

    Args:
        aligned: Depth at the colour pixels; ``z`` is used.
        plane: The floor of each of the ``B`` frames.
        calibration: For the colour camera and the depth unit.
        config: The range and the step height of its ground part.

    Returns:
        The mask, True where the pixel may belong to an obstacle, and whether a frame has any
        depth in range.
    """
    settings, unit = config.ground, calibration.depth_unit
    limits, which = floor_limits(calibration.color, plane, settings.step_height_m, unit)
    nearest = max(1, round(settings.min_depth_m / unit))
    farthest = min(65535, round(settings.max_depth_m / unit))
    return _ground(aligned.z, jnp.asarray(limits), jnp.asarray(which), *_bounds(nearest, farthest))


@lru_cache(maxsize=16)
def _bounds(nearest: int, farthest: int) -> tuple[jax.Array, jax.Array]:
    return jnp.asarray(np.uint16(nearest)), jnp.asarray(np.uint16(farthest))


@jax.jit
def _ground(
    z: jax.Array, limits: jax.Array, which: jax.Array, nearest: jax.Array, farthest: jax.Array
) -> Keep:
    with jax.named_scope("ground"):
        in_range = (z >= nearest) & (z <= farthest)
        return Keep(in_range & (z <= limits[which]), in_range.any(axis=(1, 2)))
