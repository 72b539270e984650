"""Obstacles made of points: the paper's method as one compiled program, for the CPU and CUDA."""

from functools import partial
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp

from jaxdet.config import Config
from jaxdet.floor.plane import ground_axes
from jaxdet.stages import _align, _cluster, _features, _footprint, _ground, _spread
from jaxdet.types import AlignedDepth, Calibration, Detections, Frames, GroundPlane


class _Tables(NamedTuple):
    """What the stages take beside the images: arrays, so that no camera compiles anew."""

    align: tuple[jax.Array, ...]
    ground: tuple[jax.Array, ...]
    rays: _features.Rays
    corners: jax.Array
    bands: jax.Array
    axes: jax.Array


SPECS = cast(Any, _Tables)(
    align=_spread.WHOLE,
    ground=(_spread.WHOLE, _spread.ROWS, _spread.WHOLE, _spread.WHOLE),
    rays=_spread.WHOLE,
    corners=_spread.WHOLE,
    bands=_spread.WHOLE,
    axes=_spread.ROWS,
)
"""Which tables have a row for each frame."""


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
    among, count = _spread.devices_for(frames.color), len(frames.color)
    color, depth, plane = _spread.even(frames.color, frames.depth, plane, len(among))
    align, static = _align_tables(calibration)
    tables = _Tables(
        align,
        _ground.tables(plane, calibration, config),
        _features.rays(calibration.color),
        jnp.asarray(_features.corner_settings(config.features)),
        _footprint.bands(config.footprint, unit),
        jnp.asarray(ground_axes(plane)),
    )
    found = _spread.run(_detect, color, depth, tables, SPECS, static, unit, config)
    return found if len(color) == count else jax.tree.map(lambda rows: rows[:count], found)


def _align_tables(calibration: Calibration) -> tuple[tuple[jax.Array, ...], tuple | None]:
    """The alignment's arrays and its static arguments; none for depth that is aligned already."""
    if calibration.is_aligned:
        return (), None
    *arrays, model, fills, separable = _align.tables(calibration)
    size = calibration.color.height, calibration.color.width
    return tuple(arrays), (model, fills, separable, size)


@partial(jax.jit, static_argnames=("align", "unit", "config"))
def _detect(
    color: jax.Array,
    depth: jax.Array,
    tables: _Tables,
    align: tuple | None,
    unit: float,
    config: Config,
) -> Detections:
    aligned = AlignedDepth(depth, depth)
    if align is not None:
        aligned = AlignedDepth(*_align.align_arrays(depth, *tables.align, *align))
    keep = _ground.keep(aligned.z, *tables.ground)
    features = _features.on_device(
        color, keep.z, keep.mask, tables.rays, tables.corners, config.features.max_corners
    )
    labels = _cluster.labels(features, unit, config.cluster)
    obstacles = _footprint.obstacles(features, labels, tables.bands, tables.axes, unit, config)
    return Detections(features, labels, obstacles, keep.has_depth)
