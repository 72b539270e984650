"""Labels on the CPU, a frame after the other: XLA's sorts and scatters are slow there."""

import jax

from jaxdet.config import REACH, ClusterConfig
from jaxdet.plane import slice_units, slope_units
from jaxdet.stages._threads import FrameKernel
from jaxdet.types import Features
from jaxdet_kernels import cluster_frames as kernels

_cluster = FrameKernel(kernels.cluster_frames, num_outputs=2)


def labels_by_frames(
    features: Features,
    x: jax.Array,
    depth: jax.Array,
    gap_by_depth: jax.Array,
    first_grid: int,
    depth_unit: float,
    settings: ClusterConfig,
) -> tuple[jax.Array, jax.Array]:
    """Numbers each frame's obstacles; with slices or a single round.

    Args:
        features: ``(B, N)`` points.
        x: ``(B, N)`` int32, to the right [depth units].
        depth: ``(B, N)`` int32, forward [depth units], in [0, 65536).
        gap_by_depth: ``(2, 65536)`` int32, see :func:`jaxdet.plane.gap_table`.
        first_grid: The slot of the grid's first pixel.
        depth_unit: Metres in one depth unit.
        settings: The distances.

    Returns:
        ``labels`` ``(B, N)`` int32 and their number ``(B,)`` int32.
    """
    depth_of_slice = min(slice_units(settings, depth_unit), 1 << 18)  # more hold all depths as well
    labels, count = _cluster(
        x,
        features.y,
        depth,
        features.kept,
        features.v,
        features.z,
        gap_by_depth,
        round(settings.lateral_gap_m / depth_unit),
        settings.min_points,
        depth_of_slice,
        REACH,
        round(settings.occluder_m / depth_unit),
        slope_units(settings),
        settings.max_holes,
        round(settings.surface_height_m / depth_unit),
        first_grid,
        frames=x.shape[0],
        output_dims={"labels_out": x.shape, "count_out": (x.shape[0],)},
    )
    return labels, count
