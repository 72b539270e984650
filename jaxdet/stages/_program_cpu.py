"""All five stages as one compiled program, for the CPU."""

from functools import lru_cache, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxdet.config import Config, FeaturesConfig
from jaxdet.plane import ground_axes
from jaxdet.stages import _align_points, _cluster, _features, _footprint, _ground
from jaxdet.stages._threads import FrameKernel, shares_of
from jaxdet.types import Calibration, Detections, Features, Frames, GroundPlane
from jaxdet_kernels import features_depth_lines as kernels
from jaxdet_kernels.align import PARAMETERS
from jaxdet_kernels.align_search import SEARCH_VALUES, TILE

_find = FrameKernel(kernels.features_depth_lines, num_outputs=17, in_out_argnames=["strength"])


class _Tables(NamedTuple):
    """What the stages take beside the images: arrays, so that no camera compiles anew."""

    align: tuple[jax.Array, ...]
    ground: tuple[jax.Array, ...]
    features: _features.Tables
    gaps: jax.Array
    bands: jax.Array
    axes: jax.Array


def covers(calibration: Calibration) -> bool:
    """Whether depth can be looked up where features are."""
    return calibration.is_aligned or _align_points.covers(calibration)


def detect(frames: Frames, plane: GroundPlane, config: Config) -> Detections:
    """Runs the five stages without a dense alignment, a frame after the other.

    Args:
        frames: ``B`` frames. Images whose memory starts at a multiple of 64 bytes are read where
            they are, so leave them alone until the results are ready.
        plane: The floor of each frame.
        config: The method's parameters.

    Returns:
        What :func:`jaxdet.pipeline.detect` returns, still being computed perhaps.
    """
    calibration, unit = frames.calibration, frames.calibration.depth_unit
    arrays, aligned, fills = _align_tables(calibration)
    tables = _Tables(
        arrays,
        _ground.tables(plane, calibration, config),
        _features.tables(calibration.color, config.features.grid_columns),
        _cluster.surface_gaps(config.cluster, unit),
        _footprint.bands(config.footprint, unit),
        jnp.asarray(ground_axes(plane)),
    )
    color, depth = jax.device_put((frames.color, frames.depth))
    return _detect(color, depth, tables, (aligned, fills), unit, config)


@lru_cache(maxsize=8)
def _align_tables(calibration: Calibration) -> tuple[tuple[jax.Array, ...], int, int]:
    """The search's arrays, whether depth is aligned already, and whether corners are filled."""
    if calibration.is_aligned:
        rays = jnp.zeros((1, 1), jnp.float32)
        return (rays, rays, *(jnp.zeros(n, jnp.float32) for n in (PARAMETERS, SEARCH_VALUES))), 1, 0
    *arrays, fills = _align_points.tables(calibration)
    return tuple(arrays), 0, fills


@partial(jax.jit, static_argnames=("flags", "unit", "config"))
def _detect(
    color: jax.Array,
    depth: jax.Array,
    tables: _Tables,
    flags: tuple[int, int],
    unit: float,
    config: Config,
) -> Detections:
    features, has_depth = _points(color, depth, tables, flags, config.features)
    labels = _cluster.labels(features, tables.gaps, unit, config)
    obstacles = _footprint.obstacles(features, labels, tables.bands, tables.axes, unit, config)
    return Detections(features, labels, obstacles, has_depth)


def _points(
    color: jax.Array,
    depth: jax.Array,
    tables: _Tables,
    flags: tuple[int, int],
    config: FeaturesConfig,
) -> tuple[Features, jax.Array]:
    """The first three stages: the features, and whether a frame has any depth in range.

    The flags: depth is aligned already; depth pixels cover all pixels between their corners.
    """
    with jax.named_scope("features"):
        batch, height, width, _ = color.shape
        words, tiles = 2 * -(-width // 64), (-(-depth.shape[1] // TILE), -(-depth.shape[2] // TILE))
        limits, which, nearest, farthest = tables.ground
        n = config.max_corners
        slots = batch, n + len(tables.features.grid_u)
        shares = shares_of(batch)
        rows = shares, height, words
        strengths = shares, height, 32 * words + 32
        _, u, v, x, y, z, valid, kept, found, has_depth, *_ = _find(
            color,
            *config.canny_bounds,
            depth,
            *tables.align,
            limits,
            which,
            jnp.stack([nearest, farthest]).astype(jnp.int32),
            *tables.features,
            *flags,
            int(config.use_mask),
            float(config.quality_level),
            float(config.min_distance),
            jnp.zeros(strengths, jnp.float32),
            frames=batch,
            output_dims={
                "strength": strengths,
                **dict.fromkeys(("u_out", "v_out", "x_out", "y_out", "z_out"), slots),
                **dict.fromkeys(("valid_out", "kept_out"), slots),
                **dict.fromkeys(("found_out", "seen_out", "ranges_out"), (batch,)),
                "tiles_out": (batch, *tiles),
                "keys_out": (shares, 6 * height * width),
                **dict.fromkeys(("blocked_out", "weak_out", "strong_out"), rows),
                "edges_out": rows,
            },
        )
        return Features(u, v, x, y, z, valid, kept, overflow=found > n), has_depth
