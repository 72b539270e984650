"""Clustering of points into obstacles: the paper's method as one program, for the CPU and CUDA."""

from functools import lru_cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxdet.config import Config
from jaxdet.floor.plane import ground_axes, plane_in_color
from jaxdet.runtime.calls import uninterrupted
from jaxdet.stages import _batches
from jaxdet.stages.paper import _cluster, _features, _footprint, _ground
from jaxdet.types import Calibration, Detections, Frames, GroundPlane, Points


class _Tables(NamedTuple):
    """Arrays shared by all frames.

    They are arguments of the compiled program, so that a new camera or setting needs no
    compilation.
    """

    features: _features.Tables
    gaps: jax.Array
    footprint: _footprint.Tables


def detect(frames: Frames, plane: GroundPlane, config: Config) -> Detections:
    """Detect corners, cluster those above the floor by gaps, and measure the clusters.

    Args:
        frames: ``B`` frames with colour; images on the host or already on a device.
        plane: Floor of each frame.
        config: Configuration of the method; ``cluster.points`` is True.

    Returns:
        The obstacles, see :func:`jaxdet.pipeline.detect`; JAX may still be computing them.
    """
    calibration, slots = frames.calibration, config.features.max_corners
    _features.check_kernels_size(calibration.image)
    plane = plane_in_color(plane, calibration)
    shared = _tables(calibration, config)
    sizes = _cluster.sizes(slots, config.cluster, calibration.depth_unit)

    def run(images: tuple[Any, ...], planes: GroundPlane) -> Detections:
        ground = _ground.tables(planes, calibration, config)
        axes = jnp.asarray(ground_axes(planes))
        return uninterrupted(_detect, *images, (shared, ground, axes), slots, sizes)

    return _batches.in_parts(run, (frames.color, frames.depth), plane, staged=True)


@lru_cache(maxsize=8)
def _tables(calibration: Calibration, config: Config) -> _Tables:
    """Return the arrays on the device."""
    unit = calibration.depth_unit
    features = _features.tables(calibration, config.features)
    gaps = jnp.asarray(_cluster.gap_settings(config.cluster, unit))
    return _Tables(features, gaps, _footprint.tables(config.footprint, unit))


@partial(jax.jit, static_argnames=("slots", "sizes"))
def _detect(
    color: jax.Array,
    depth: jax.Array,
    inputs: tuple[_Tables, _ground.Tables, jax.Array],
    slots: int,
    sizes: _cluster.Sizes,
) -> Detections:
    tables, ground, axes = inputs
    corners = _features.on_device(color, depth, tables.features, slots)
    corners = _ground.keep(corners, ground)
    labels = _cluster.labels(corners, tables.gaps, sizes)
    obstacles = _footprint.obstacles(corners, labels, axes, tables.footprint, sizes.most)
    units = depth.astype(ground.nearest.dtype)  # int32: ``nearest`` may exceed 16 bits
    in_range = (units >= ground.nearest) & (units <= ground.farthest)
    return Detections(
        labels.num_obstacles,
        corners.overflow,
        in_range.any(axis=(1, 2)),
        obstacles,
        points=Points(corners, labels),
    )
