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


class _Static(NamedTuple):
    """Sizes that the program is compiled for."""

    features: _features.Static
    cluster: _cluster.Sizes


def detect(frames: Frames, plane: GroundPlane, config: Config) -> Detections:
    """Detect corners, drop those on the floor, cluster the others by gaps and measure the clusters.

    Args:
        frames: ``B`` frames with colour; images on the host or already on a device.
        plane: Floor of each frame.
        config: Configuration of the method; ``cluster.points`` is True.

    Returns:
        The obstacles, see :func:`jaxdet.pipeline.detect`; JAX may still be computing them.
    """
    _features.check_kernels_size(frames.calibration.image)
    plane = plane_in_color(plane, frames.calibration)
    shared, static = _tables(frames.calibration, config)

    def run(images: tuple[Any, ...], planes: GroundPlane) -> Detections:
        ground = _ground.tables(planes, frames.calibration, config)
        axes = jnp.asarray(ground_axes(planes))
        return uninterrupted(_detect, *images, (shared, ground, axes), static)

    return _batches.in_parts(run, (frames.color, frames.depth), plane, staged=True)


@lru_cache(maxsize=8)
def _tables(calibration: Calibration, config: Config) -> tuple[_Tables, _Static]:
    """Return the arrays on the device, and the sizes."""
    unit = calibration.depth_unit
    features, sizes = _features.tables(calibration, config.features)
    gaps = jnp.asarray(_cluster.gap_settings(config.cluster, unit))
    made = _Tables(features, gaps, _footprint.tables(config.footprint, unit))
    return made, _Static(sizes, _cluster.sizes(sizes.slots, config.cluster, unit))


@partial(jax.jit, static_argnames="static")
def _detect(
    color: jax.Array,
    depth: jax.Array,
    inputs: tuple[_Tables, _ground.Tables, jax.Array],
    static: _Static,
) -> Detections:
    tables, ground, axes = inputs
    corners = _features.on_device(color, depth, tables.features, static.features)
    corners = _ground.keep(corners, ground)
    labels = _cluster.labels(corners, tables.gaps, static.cluster)
    most = static.cluster.most
    obstacles = _footprint.obstacles(corners, labels, axes, tables.footprint, most)
    units = depth.astype(ground.nearest.dtype)  # int32: ``nearest`` may exceed 16 bits
    in_range = (units >= ground.nearest) & (units <= ground.farthest)
    return Detections(
        labels.num_obstacles,
        corners.overflow,
        in_range.any(axis=(1, 2)),
        obstacles,
        points=Points(corners, labels),
    )
