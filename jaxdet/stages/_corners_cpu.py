"""Corners on the CPU: Canny, Shi-Tomasi and the selection, a frame after the other."""

import jax
import jax.numpy as jnp

from jaxdet.config import FeaturesConfig
from jaxdet.stages._threads import FrameKernel, shares_of
from jaxdet_kernels import features_canny_lines as canny_kernels
from jaxdet_kernels import features_select_lines as select_kernels

_edges = FrameKernel(canny_kernels.canny_lines, num_outputs=3, num_kept=2)
_corners = FrameKernel(
    select_kernels.corners_lines, num_outputs=6, in_out_argnames=["strength"], num_kept=2
)


def edges(color: jax.Array, low: int, high: int) -> jax.Array:
    """``cv2.Canny`` of the grey images; as :func:`jaxdet.stages._corners_cuda.edges`."""
    batch, height, width, _ = color.shape
    words = 2 * -(-width // 64)
    rows = dict.fromkeys(("candidates_out", "strong_out"), (shares_of(batch), height, words))
    (found,) = _edges(
        color,
        low,
        high,
        frames=batch,
        output_dims={"edges_out": (batch, height, words), **rows},
    )
    return found


def strongest_corners(
    color: jax.Array, mask: jax.Array, config: FeaturesConfig
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """The strongest corners of the Canny edge images, as the reference selects them.

    Args:
        color: ``(B, H, W, 3)`` uint8, RGB.
        mask: ``(B, H, W)`` bool, where corners may be if the configuration uses a mask.
        config: Canny's bounds and the corner selection, static.

    Returns:
        Columns and rows ``(B, N)`` int32, strongest first, zero in empty slots, and how many
        corners qualify ``(B,)`` int32, at most one more than there are slots.
    """
    batch, height, width = mask.shape
    edge = edges(color, *config.canny_bounds)
    shares = shares_of(batch)
    strengths = shares, height, 32 * edge.shape[2] + 32
    slots = (batch, config.max_corners)
    _, u, v, found = _corners(
        edge,
        mask,
        int(config.use_mask),
        float(config.quality_level),
        float(config.min_distance),
        jnp.zeros(strengths, jnp.float32),
        frames=batch,
        output_dims={
            "strength": strengths,
            "u_out": slots,
            "v_out": slots,
            "found_out": (batch,),
            "keys_out": (shares, 6 * height * width),
            "blocked_out": (shares, *edge.shape[1:]),
        },
    )
    return u, v, found
