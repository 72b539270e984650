"""Obstacles made of points: the paper's method as one compiled program, for the CPU and CUDA."""

from functools import lru_cache, partial
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp

from jaxdet.config import ClusterConfig, Config, FeaturesConfig
from jaxdet.floor.plane import ground_axes
from jaxdet.stages import _align, _cluster, _features, _footprint, _ground, _spread
from jaxdet.stages._corners import corner_settings
from jaxdet.types import AlignedDepth, Calibration, Detections, Frames, GroundPlane


class _Tables(NamedTuple):
    """What the stages take beside images, in arrays: no camera or setting compiles anew."""

    align: tuple[jax.Array, ...]
    ground: tuple[jax.Array, ...]
    rays: _features.Rays
    corners: jax.Array
    gaps: jax.Array
    footprint: _footprint.Tables
    axes: jax.Array


SPECS = cast(Any, _Tables)(
    align=_spread.WHOLE,
    ground=(_spread.WHOLE, _spread.ROWS, _spread.WHOLE, _spread.WHOLE),
    rays=_spread.WHOLE,
    corners=_spread.WHOLE,
    gaps=_spread.WHOLE,
    footprint=_spread.WHOLE,
    axes=_spread.ROWS,
)
"""Which tables have a row for each frame."""


class _Static(NamedTuple):
    """What a compiled program is for."""

    align: tuple[int, int, tuple[int, int]] | None
    """The lens, whether depth pixels fill corners, and the colour image's size; None: depth is
    aligned already."""
    slots: int
    """Of corners."""
    most: int
    """Obstacles that there is room for."""


def clusters(frames: Frames, plane: GroundPlane, config: Config) -> Detections:
    """Aligns, drops the floor, finds corners, clusters them by gaps and outlines the clusters.

    Args:
        frames: ``B`` frames; images on the host, which all devices share, or already on devices.
        plane: The floor of each frame.
        config: The method; ``cluster.points`` is on.

    Returns:
        What :func:`jaxdet.pipeline.detect` returns, still being computed perhaps.
    """
    calibration, unit = frames.calibration, frames.calibration.depth_unit
    align, lens = _align_tables(calibration)
    most = _cluster.most_obstacles(config.features.max_corners, config.cluster)
    static = _Static(lens, config.features.max_corners, most)

    def run(images: tuple[Any, ...], known: GroundPlane) -> Detections:
        tables = _Tables(
            align,
            _ground.tables(known, calibration, config),
            _features.rays(calibration.color),
            _corners(config.features),
            _gaps(config.cluster, unit),
            _footprint.tables(config.footprint, unit),
            jnp.asarray(ground_axes(known)),
        )
        return _spread.run(_detect, *images, tables, SPECS, static)

    return _spread.in_parts(run, (frames.color, frames.depth), plane, staged=True)


def _align_tables(
    calibration: Calibration,
) -> tuple[tuple[jax.Array, ...], tuple[int, int, tuple[int, int]] | None]:
    """The alignment's arrays and its static arguments; none for depth that is aligned already."""
    if calibration.is_aligned:
        return (), None
    *arrays, model, fills = _align.tables(calibration)
    return tuple(arrays), (model, fills, (calibration.color.height, calibration.color.width))


@lru_cache(maxsize=8)
def _corners(config: FeaturesConfig) -> jax.Array:
    """The settings of corners on the device, see :func:`_gaps`."""
    return jnp.asarray(corner_settings(config))


@lru_cache(maxsize=8)
def _gaps(config: ClusterConfig, unit: float) -> jax.Array:
    """The gaps on the device: one array, as copies for several devices are kept by identity."""
    return jnp.asarray(_cluster.gap_settings(config, unit))


@partial(jax.jit, static_argnames="static")
def _detect(color: jax.Array, depth: jax.Array, tables: _Tables, static: _Static) -> Detections:
    aligned = AlignedDepth(depth, depth)
    if static.align is not None:
        aligned = AlignedDepth(*_align.align_arrays(depth, *tables.align, *static.align))
    keep = _ground.keep(aligned.z, *tables.ground)
    features = _features.on_device(
        color, keep.z, keep.mask, tables.rays, tables.corners, static.slots
    )
    labels = _cluster.labels(features, tables.gaps, static.most)
    obstacles = _footprint.obstacles(features, labels, tables.axes, tables.footprint, static.most)
    return Detections(features, labels, obstacles, keep.has_depth)
