"""Stage 4, cluster: two sorts, gap flags and segmented scans."""

from functools import lru_cache, partial

import jax
import jax.numpy as jnp
from jax import lax

from jaxdet.config import ClusterConfig, Config
from jaxdet.plane import gap_table, ground_axes
from jaxdet.stages._footprint import to_ground
from jaxdet.types import MAX_LATERAL, Features, GroundPlane, Labels

LAST = jnp.iinfo(jnp.int32).max
RANK_BITS = 13
RANK_MASK = (1 << RANK_BITS) - 1
"""A frame has at most 2^13 points; what is sorted has 19 bits."""


def cluster(features: Features, plane: GroundPlane, depth_unit: float, config: Config) -> Labels:
    """Groups the kept features of each frame into obstacles (Eq. 6, Section 3.4).

    Equals :func:`jaxdet.reference.cluster`. Every frame is an array program of its own, mapped
    over the batch: sort by set and depth, flag gaps, count each set; the same by set and x; number
    what is left.

    Args:
        features: ``(B, N)`` points; only ``kept`` ones take part.
        plane: The floor of each frame, used when the distances are measured on it.
        depth_unit: Metres in one depth unit.
        config: The gaps, N and the options of its cluster part.

    Returns:
        Labels numbered in order of nearest z, then smallest x, with -1 for no obstacle.
    """
    axes = jnp.asarray(ground_axes(plane))
    return labels(features, gaps(config.cluster, depth_unit), axes, depth_unit, config.cluster)


@lru_cache(maxsize=8)
def gaps(config: ClusterConfig, depth_unit: float) -> jax.Array:
    """:func:`jaxdet.plane.gap_table` on the device."""
    return jnp.asarray(gap_table(config, depth_unit))


@partial(jax.jit, static_argnames=("depth_unit", "config"))
def labels(
    features: Features,
    gap_by_depth: jax.Array,
    axes: jax.Array,
    depth_unit: float,
    config: ClusterConfig,
) -> Labels:
    """The labels, from :func:`gaps` and :func:`jaxdet.plane.ground_axes`."""
    with jax.named_scope("cluster"):
        x, depth = features.x, features.z
        if config.on_floor:
            floor = to_ground(jnp.stack([x, features.y, depth], axis=-1), axes)
            x = jnp.clip(floor[..., 0], -MAX_LATERAL, MAX_LATERAL)
            depth = jnp.clip(floor[..., 1], 0, 65535)
        lateral_gap = round(config.lateral_gap_m / depth_unit)
        settings = (gap_by_depth, lateral_gap, config.min_points, config.rounds)
        found = jax.vmap(lambda x, z, kept: _cluster_frame(x, z, kept, *settings))
        return Labels(*found(x, depth, features.kept))


def _cluster_frame(
    x: jax.Array,
    z: jax.Array,
    kept: jax.Array,
    gaps: jax.Array,
    lateral_gap: int,
    min_points: int,
    rounds: int,
) -> tuple[jax.Array, jax.Array]:
    """One frame: ``(N,)`` each.

    The points are ranked along both axes once. A set's points are then in order after one sort
    of ``set << RANK_BITS | rank``: every sort has a single 32-bit key, which is what XLA sorts
    quickly on every device.
    """
    n = z.shape[0]
    by_z, z_rank = _rank(z)
    by_x, x_rank = _rank(x + MAX_LATERAL)
    group = jnp.where(kept, 0, n)
    for _ in range(rounds):
        for values, order, rank, gap in (
            (z, by_z, z_rank, gaps[jnp.clip(z, 0, 65535)]),
            (x, by_x, x_rank, jnp.full(n, lateral_gap, jnp.int32)),
        ):
            key = jnp.sort((group.astype(jnp.uint32) << RANK_BITS) | rank)
            slot = order[key & RANK_MASK]
            sorted_group = (key >> RANK_BITS).astype(jnp.int32)
            part = _gap_sets(values[slot], sorted_group, gap[slot], min_points)
            group = jnp.zeros(n, jnp.int32).at[slot].set(part, unique_indices=True)
    return _number(group, x, z, n // (min_points + 1))


def _rank(values: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Sorts ``(N,)`` int32 values in [0, 2^19).

    Returns:
        The slots in rising order, and each slot's rank, both ``(N,)``, int32 and uint32.
    """
    n = values.shape[0]
    slot = jnp.arange(n, dtype=jnp.uint32)
    order = (jnp.sort((values.astype(jnp.uint32) << RANK_BITS) | slot) & RANK_MASK).astype(
        jnp.int32
    )
    return order, jnp.zeros(n, jnp.uint32).at[order].set(slot, unique_indices=True)


def _gap_sets(values: jax.Array, group: jax.Array, gap: jax.Array, min_points: int) -> jax.Array:
    """Numbers the runs of ``values`` without a gap, in order.

    Args:
        values: ``(N,)`` int32, rising within each group.
        group: ``(N,)`` int32, rising; a new group starts a new run; N takes no part.
        gap: ``(N,)`` int32, the largest step from each entry to the next.
        min_points: Runs of this many entries or fewer are dropped.

    Returns:
        ``(N,)`` int32, the run's number among all runs, or N where dropped.
    """
    n = values.shape[0]
    position = jnp.arange(n, dtype=jnp.int32)
    valid = group != n
    steps = (values[1:] - values[:-1] > gap[:-1]) | (group[1:] != group[:-1])
    starts = jnp.concatenate([jnp.ones(1, bool), steps]) | ~valid
    first = lax.cummax(jnp.where(starts, position, 0))
    next_start = jnp.concatenate([jnp.where(starts, position, n)[1:], jnp.full(1, n, jnp.int32)])
    size = lax.cummin(next_start, reverse=True) - first
    return jnp.where(valid & (size > min_points), jnp.cumsum(starts, dtype=jnp.int32) - 1, n)


def _number(
    part: jax.Array, x: jax.Array, z: jax.Array, max_parts: int
) -> tuple[jax.Array, jax.Array]:
    """Numbers the parts by nearest z, then smallest x.

    Args:
        part: ``(N,)`` int32, equal within a part; N takes no part.
        x: ``(N,)`` int32.
        z: ``(N,)`` int32.
        max_parts: As many parts as there can be.

    Returns:
        ``labels`` ``(N,)`` int32 and their number, int32.
    """
    n, m = part.shape[0], max(1, max_parts)
    used = jnp.zeros(n, jnp.int32).at[part].set(1, mode="drop")
    index = jnp.where(
        part < n, (jnp.cumsum(used, dtype=jnp.int32) - 1)[jnp.minimum(part, n - 1)], m
    )
    nearest = jnp.full(m, LAST).at[index].min(z, mode="drop")
    leftmost = jnp.full(m, LAST).at[index].min(x, mode="drop")
    *_, order = lax.sort((nearest, leftmost, jnp.arange(m, dtype=jnp.int32)), num_keys=2)
    label = jnp.zeros(m, jnp.int32).at[order].set(jnp.arange(m, dtype=jnp.int32))
    labels = jnp.where(part < n, label[jnp.minimum(index, m - 1)], -1)
    return labels, jnp.sum(nearest != LAST, dtype=jnp.int32)
