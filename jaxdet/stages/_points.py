"""Obstacles made of points: the paper's method as one compiled program, for the CPU and CUDA."""

from functools import lru_cache, partial
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp

from jaxdet.config import Config
from jaxdet.floor.plane import ground_axes, plane_in_color
from jaxdet.stages import _align, _cluster, _features, _footprint, _ground, _spread
from jaxdet.stages._corners import corner_settings
from jaxdet.types import AlignedDepth, Calibration, Detections, Frames, GroundPlane, Points


class _Tables(NamedTuple):
    """What all frames share: arrays, so that no camera and no setting compiles anew."""

    align: tuple[jax.Array, ...]
    rays: _features.Rays
    corners: jax.Array
    gaps: jax.Array
    footprint: _footprint.Tables


class _Given(NamedTuple):
    """What is known of the frames' floors."""

    ground: tuple[jax.Array, ...]
    axes: jax.Array


_PLANES = _spread.WHOLE, _spread.ROWS, _spread.WHOLE, _spread.WHOLE
SPECS = _spread.WHOLE, cast(Any, _Given)(ground=_PLANES, axes=_spread.ROWS)
"""Of :class:`_Tables` and :class:`_Given`: which have a row for each frame."""


class _Static(NamedTuple):
    """What a compiled program is for."""

    align: tuple[int, int] | None  # the colour image's size; None: depth is aligned already
    slots: int  # of corners
    most: int  # obstacles that there is room for


def clusters(frames: Frames, plane: GroundPlane, config: Config) -> Detections:
    """Align depth, drop the floor, find corners, cluster them by gaps and outline the clusters.

    Args:
        frames: ``B`` frames with colour; images on the host, which all devices share, or already
            on devices.
        plane: Floor of each frame.
        config: Configuration of the method; ``cluster.points`` is True.

    Returns:
        The obstacles, see :func:`jaxdet.pipeline.detect`, perhaps still being computed.
    """
    _features.check_kernels_size(frames.calibration.image)
    plane = plane_in_color(plane, frames.calibration)
    shared, static = _tables(frames.calibration, config)

    def run(images: tuple[Any, ...], known: GroundPlane) -> Detections:
        ground = _ground.tables(known, frames.calibration, config)
        given = _Given(ground, jnp.asarray(ground_axes(known)))
        return _spread.run(_detect, images, (shared, given), SPECS, static)

    return _spread.in_parts(run, (frames.color, frames.depth), plane, staged=True)


@lru_cache(maxsize=8)
def _tables(calibration: Calibration, config: Config) -> tuple[_Tables, _Static]:
    """The arrays on the device, and what is compiled for; no alignment of what is aligned."""
    unit, slots, size, align = calibration.depth_unit, config.features.max_corners, None, ()
    if not calibration.is_aligned:
        align = _align.tables(calibration)
        size = calibration.image.height, calibration.image.width
    made = _Tables(
        tuple(align),
        _features.rays(calibration.image),
        jnp.asarray(corner_settings(config.features)),
        jnp.asarray(_cluster.gap_settings(config.cluster, unit)),
        _footprint.tables(config.footprint, unit),
    )
    return made, _Static(size, slots, _cluster.most_obstacles(slots, config.cluster))


@partial(jax.jit, static_argnames="static")
def _detect(
    color: jax.Array, depth: jax.Array, given: tuple[_Tables, _Given], static: _Static
) -> Detections:
    tables, floor = given
    aligned = AlignedDepth(depth, depth)
    if static.align is not None:
        aligned = AlignedDepth(*_align.align_arrays(depth, *tables.align, static.align))
    keep = _ground.keep(aligned.z, *floor.ground)
    corners = _features.on_device(
        color, keep.z, keep.mask, tables.rays, tables.corners, static.slots
    )
    labels = _cluster.labels(corners, tables.gaps, static.most)
    obstacles = _footprint.obstacles(corners, labels, floor.axes, tables.footprint, static.most)
    count, points = labels.num_obstacles, Points(corners, labels)
    return Detections(count, corners.overflow, keep.has_depth, obstacles, points=points)
