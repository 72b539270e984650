"""Labels on the CPU, a frame after the other: XLA's sorts and scatters are slow there."""

import jax

from jaxdet.config import REACH, ClusterConfig
from jaxdet.plane import depth_gap_units, slice_units, slope_units
from jaxdet.stages._threads import FrameKernel
from jaxdet.types import Features
from jaxdet_kernels import cluster_frames as kernels

_cluster = FrameKernel(kernels.cluster_frames, num_outputs=2)


def labels_by_frames(
    features: Features,
    gaps: jax.Array,
    first_grid: int,
    depth_unit: float,
    settings: ClusterConfig,
) -> tuple[jax.Array, jax.Array]:
    """Numbers each frame's obstacles.

    Args:
        features: ``(B, N)`` points.
        gaps: ``(65536,)`` int32, see :func:`jaxdet.plane.surface_gap_table`.
        first_grid: The slot of the grid's first pixel.
        depth_unit: Metres in one depth unit.
        settings: The distances.

    Returns:
        ``labels`` ``(B, N)`` int32 and their number ``(B,)`` int32.
    """
    depth_of_slice = min(slice_units(settings, depth_unit), 1 << 18)  # more hold all depths as well
    labels, count = _cluster(
        features.x,
        features.y,
        features.z,
        features.kept,
        features.v,
        gaps,
        depth_gap_units(settings, depth_unit),
        round(settings.lateral_gap_m / depth_unit),
        settings.min_points,
        depth_of_slice,
        REACH,
        round(settings.occluder_m / depth_unit),
        slope_units(settings),
        settings.max_holes,
        round(settings.surface_height_m / depth_unit),
        first_grid,
        frames=len(features.x),
        output_dims={"labels_out": features.x.shape, "count_out": (len(features.x),)},
    )
    return labels, count
