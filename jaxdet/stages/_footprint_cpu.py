"""Obstacles on the CPU, a frame after the other: XLA's scatters are slow there."""

import jax

from jaxdet.config import TRIM_SHARE
from jaxdet.stages._threads import FrameKernel
from jaxdet.types import Features, Obstacles
from jaxdet_kernels import footprint_frames as kernels

_footprint = FrameKernel(kernels.footprint_frames, num_outputs=12)


def obstacles_by_frames(
    features: Features,
    labels: jax.Array,
    band_by_depth: jax.Array,
    axes: jax.Array,
    slots: int,
    threshold: int,
    trim: int,
) -> Obstacles:
    """Measures each frame's obstacles.

    Args:
        features: ``(B, N)`` points.
        labels: ``(B, N)`` int32, their obstacles; -1 for none.
        band_by_depth: ``(65536, 2)`` int32, from :func:`jaxdet.plane.band_table`.
        axes: ``(B, 2, 3)`` int32, from :func:`jaxdet.plane.ground_axes`.
        slots: ``M``.
        threshold: How much nearer C is than A and B to count as a vertex [depth units].
        trim: How many points are passed over at each side and in front.

    Returns:
        ``(B, M)`` obstacles.
    """
    batch = labels.shape[0]
    sizes = {2: ("uv_min", "uv_max", "a", "b", "c", "direction"), 4: ("span",)}
    sizes[3] = ("xyz_min", "xyz_max", "xyz_sum")
    dims = dict.fromkeys(("count_out", "vertex_out"), (batch, slots))
    for size, names in sizes.items():
        dims |= {f"{name}_out": (batch, slots, size) for name in names}
    return Obstacles(
        *_footprint(
            labels,
            features.u,
            features.v,
            features.x,
            features.y,
            features.z,
            axes,
            band_by_depth,
            threshold,
            trim,
            TRIM_SHARE,
            frames=batch,
            output_dims=dims,
        )
    )
