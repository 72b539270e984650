"""Sets of points linked slice by slice, and along the surfaces that a grid of pixels shows."""

import jax
import jax.numpy as jnp
import warp as wp

from jaxdet.config import REACH, ClusterConfig
from jaxdet.plane import SLOPE_BITS, depth_gap_units, slice_units, slope_units
from jaxdet.stages._rank import RANK_BITS, RANK_MASK, rank
from jaxdet.types import MAX_LATERAL, Features
from jaxdet_kernels import linked_sets as kernels

_linked_sets = wp.jax_kernel(
    kernels.linked_sets, num_outputs=2, block_dim=kernels.LINKED_SETS_BLOCK
)


def linked_sets(
    features: Features,
    gaps: jax.Array,
    first_grid: int,
    depth_unit: float,
    settings: ClusterConfig,
) -> jax.Array:
    """Groups each frame's kept points; twin of ``jaxdet.reference._slices.linked_sets``.

    Args:
        features: ``(B, N)`` points.
        gaps: ``(65536,)`` int32, see :func:`jaxdet.plane.surface_gap_table`.
        first_grid: The slot of the grid's first pixel.
        depth_unit: Metres in one depth unit.
        settings: The distances.

    Returns:
        ``(B, N)`` int32, the smallest slot of each point's set.
    """
    x, z, depth = features.x, features.z, slice_units(settings, depth_unit)
    gap, reach = (round(m / depth_unit) for m in (settings.lateral_gap_m, settings.occluder_m))
    order, place = jax.vmap(rank)(x + MAX_LATERAL)
    behind = jnp.full_like(x, -1)
    if reach and first_grid < x.shape[1]:
        gap_behind = depth_gap_units(settings, depth_unit)
        behind = _behind(features, gap_behind, first_grid, reach, settings)
    links = [
        _sideways(features.kept, x, (z + start) // depth, order, place, gap)
        for start in (0, depth // 2)
    ]
    given = (
        jnp.stack([*links, behind], axis=1),
        features.y,
        z,
        features.kept,
        features.v,
        gaps,
        round(settings.surface_height_m / depth_unit),
        first_grid,
    )
    batch, n = x.shape

    def find(threads: int) -> jax.Array:
        dims = {"scratch_out": (batch, 2, n), "root_out": (batch, n)}
        return _linked_sets(*given, launch_dims=(batch * threads,), output_dims=dims)[1]

    return jax.lax.platform_dependent(
        cpu=lambda: find(1), cuda=lambda: find(kernels.LINKED_SETS_BLOCK)
    )


def _sideways(
    kept: jax.Array, x: jax.Array, part: jax.Array, order: jax.Array, place: jax.Array, gap: int
) -> jax.Array:
    """Each point's left neighbour in its slice, if it is near; -1 = none; ``(B, N)`` int32."""
    nowhere = jnp.uint32(1 << 18)
    key = jnp.where(kept, part.astype(jnp.uint32), nowhere) << RANK_BITS | place
    key = jnp.sort(key, axis=1)
    slot = jnp.take_along_axis(order, (key & RANK_MASK).astype(jnp.int32), axis=1)
    own = key >> RANK_BITS
    side = jnp.take_along_axis(x, slot, axis=1)
    near = (own[:, 1:] == own[:, :-1]) & (side[:, 1:] - side[:, :-1] <= gap)
    near &= own[:, 1:] != nowhere
    left = jnp.where(near, slot[:, :-1], -1)
    frame = jnp.arange(x.shape[0])[:, None]
    return jnp.full_like(slot, -1).at[frame, slot[:, 1:]].set(left, unique_indices=True)


def _behind(
    features: Features, depth_gap: int, first: int, reach: int, settings: ClusterConfig
) -> jax.Array:
    """The point at the other side of what stands before each; -1 = none; ``(B, N)`` int32.

    All points look one grid pixel farther to the left in each step.
    """
    n = features.x.shape[1]
    slope = slope_units(settings)
    row, kept, x, z = (a[:, first:] for a in (features.v, features.kept, features.x, features.z))
    slot = jnp.arange(first, n, dtype=jnp.int32)[None, :]
    link, holes, looking = jnp.full_like(x, -1), jnp.zeros_like(x), kept
    for away in range(1, min(REACH, n - first - 1) + 1):
        row_j, kept_j, x_j, z_j = (
            jnp.pad(a[:, :-away], ((0, 0), (away, 0))) for a in (row, kept, x, z)
        )
        looking &= (row_j == row) & (slot - away >= first)
        aside = jnp.abs(x - x_j)
        within = depth_gap + (slope * aside >> SLOPE_BITS)
        ends = looking & kept_j & (z_j >= z - within)
        hit = ends & (z_j <= z + within) & (aside <= reach)
        link = jnp.where(hit, slot - away, link) if away > 1 else link
        holes += 1 - kept_j.astype(jnp.int32)
        looking &= ~ends & (kept_j | (z_j == 0) & (holes <= settings.max_holes))
    return jnp.pad(link, ((0, 0), (first, 0)), constant_values=-1)
