"""All five stages as one compiled program, for CUDA."""

from functools import partial
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp

from jaxdet.config import Config
from jaxdet.plane import ground_axes
from jaxdet.stages import (
    _align,
    _align_points,
    _cluster,
    _features,
    _footprint,
    _ground,
    _sparse,
    _spread,
)
from jaxdet.types import AlignedDepth, Calibration, Detections, Features, Frames, GroundPlane


class _Tables(NamedTuple):
    """What the stages take beside the images: arrays, so that no camera compiles anew."""

    align: tuple[jax.Array, ...]
    ground: tuple[jax.Array, ...]
    features: _features.Tables
    gaps: jax.Array
    bands: jax.Array
    axes: jax.Array


SPECS = cast(Any, _Tables)(
    align=_spread.WHOLE,
    ground=(_spread.WHOLE, _spread.ROWS, _spread.WHOLE, _spread.WHOLE),
    features=_spread.WHOLE,
    gaps=_spread.WHOLE,
    bands=_spread.WHOLE,
    axes=_spread.ROWS,
)
"""Which tables have a row for each frame."""


def detect(frames: Frames, plane: GroundPlane, config: Config) -> Detections:
    """Runs the five stages on the devices without a stop at the host.

    Args:
        frames: ``B`` frames; images on the host, which all devices share, or already on devices.
        plane: The floor of each frame.
        config: The method's parameters.

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
        _features.tables(calibration.color, config.features.grid_columns),
        _cluster.surface_gaps(config.cluster, unit),
        _footprint.bands(config.footprint, unit),
        jnp.asarray(ground_axes(plane)),
    )
    found = _spread.run(_detect, color, depth, tables, SPECS, static, unit, config)
    return found if len(color) == count else jax.tree.map(lambda rows: rows[:count], found)


def _align_tables(calibration: Calibration) -> tuple[tuple[jax.Array, ...], tuple | None]:
    """The alignment's arrays and its static arguments.

    One static argument for a look-up at the features, four for the dense alignment, none for
    depth that is aligned already.
    """
    if calibration.is_aligned:
        return (), None
    if _align_points.covers(calibration):
        *arrays, fills = _align_points.tables(calibration)
        return tuple(arrays), (fills,)
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
    features, has_depth = _features_of(color, depth, tables, align, config)
    labels = _cluster.labels(features, tables.gaps, unit, config)
    obstacles = _footprint.obstacles(features, labels, tables.bands, tables.axes, unit, config)
    return Detections(features, labels, obstacles, has_depth)


def _features_of(
    color: jax.Array, depth: jax.Array, tables: _Tables, align: tuple | None, config: Config
) -> tuple[Features, jax.Array]:
    """The first three stages: the features, and whether a frame has depth in range."""
    if align is not None and len(align) == 1:
        floor, settings = _sparse.Floor(*tables.ground), config.features
        return _sparse.features(
            color, depth, tables.align, *align, floor, tables.features, settings
        )
    aligned = AlignedDepth(depth, depth)
    if align is not None:
        aligned = AlignedDepth(*_align.align_arrays(depth, *tables.align, *align))
    keep = _ground.keep(aligned.z, *tables.ground)
    found = _features.on_device(color, keep.z, keep.mask, tables.features, config.features)
    return found, keep.has_depth
