"""Stage 4, cluster: two sorts, gap flags and segmented scans."""

from functools import lru_cache, partial

import jax
import jax.numpy as jnp
from jax import lax

from jaxdet.config import ClusterConfig, Config
from jaxdet.plane import gap_table, ground_axes
from jaxdet.stages._footprint import to_ground
from jaxdet.types import Features, GroundPlane, Labels

LAST = jnp.iinfo(jnp.int32).max


def cluster(features: Features, plane: GroundPlane, depth_unit: float, config: Config) -> Labels:
    """Groups the kept features of each frame into obstacles (Eq. 6, Section 3.4).

    Equals :func:`jaxdet.reference.cluster`. Every frame is an array program of its own, mapped
    over the batch: sort by depth, flag gaps, count each set; sort by set and x, flag gaps, count
    again; number what is left.

    Args:
        features: ``(B, N)`` points; only ``kept`` ones take part.
        plane: The floor of each frame, used when the distances are measured on it.
        depth_unit: Metres in one depth unit.
        config: The gaps, N and the options of its cluster part.

    Returns:
        Labels numbered in order of nearest z, then smallest x, with -1 for no obstacle.
    """
    settings = config.cluster
    lateral_gap = round(settings.lateral_gap_m / depth_unit)
    gaps = _gaps(settings, depth_unit)
    axes = jnp.asarray(ground_axes(plane)) if settings.on_floor else None
    return Labels(
        *_cluster(features, gaps, axes, lateral_gap, settings.min_points, settings.rounds)
    )


@lru_cache(maxsize=8)
def _gaps(config: ClusterConfig, depth_unit: float) -> jax.Array:
    return jnp.asarray(gap_table(config, depth_unit))


@partial(jax.jit, static_argnames=("lateral_gap", "min_points", "rounds"))
def _cluster(
    features: Features,
    gaps: jax.Array,
    axes: jax.Array | None,
    lateral_gap: int,
    min_points: int,
    rounds: int,
) -> tuple[jax.Array, jax.Array]:
    with jax.named_scope("cluster"):
        x, depth = features.x, features.z
        if axes is not None:
            floor = to_ground(jnp.stack([x, features.y, depth], axis=-1), axes)
            x, depth = floor[..., 0], jnp.clip(floor[..., 1], 0, 65535)
        settings = (gaps, lateral_gap, min_points, rounds)
        return jax.vmap(lambda x, z, kept: _cluster_frame(x, z, kept, *settings))(
            x, depth, features.kept
        )


def _cluster_frame(
    x: jax.Array,
    z: jax.Array,
    kept: jax.Array,
    gaps: jax.Array,
    lateral_gap: int,
    min_points: int,
    rounds: int,
) -> tuple[jax.Array, jax.Array]:
    """One frame: ``(N,)`` each."""
    n = z.shape[0]
    group, z_sorted, slot = _sort_by_depth(z, kept)
    part, x_sorted = group, x
    for number in range(rounds):
        if number:
            group, z_sorted, slot = lax.sort((part, z[slot], slot), num_keys=2)
        group = _gap_sets(z_sorted, group, gaps[z_sorted], min_points)
        part, x_sorted, slot = lax.sort((group, x[slot], slot), num_keys=2)
        part = _gap_sets(x_sorted, part, jnp.full(n, lateral_gap, jnp.int32), min_points)
    return _number(part, x_sorted, z[slot], slot, n // (min_points + 1))


def _sort_by_depth(z: jax.Array, kept: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Sorts the kept points by depth, in one key: group (0, or ``LAST``), depth and slot.

    Depth needs 16 bits and the slot at most 15, so one 32-bit key sorts both; what does not take
    part is deeper than any depth.
    """
    slot = jnp.arange(z.shape[0], dtype=jnp.uint32)
    depth = jnp.where(kept, z.astype(jnp.uint32), jnp.uint32(1 << 16))
    key = jnp.sort((depth << 15) | slot)
    depth = (key >> 15).astype(jnp.int32)
    group = jnp.where(depth < (1 << 16), 0, LAST)
    return group, jnp.minimum(depth, 65535), (key & 0x7FFF).astype(jnp.int32)


def _gap_sets(values: jax.Array, group: jax.Array, gap: jax.Array, min_points: int) -> jax.Array:
    """Numbers the runs of ``values`` without a gap, in order.

    Args:
        values: ``(N,)`` int32, rising within each group.
        group: ``(N,)`` int32, rising; a new group starts a new run; ``LAST`` takes no part.
        gap: ``(N,)`` int32, the largest step from each entry to the next.
        min_points: Runs of this many entries or fewer are dropped.

    Returns:
        ``(N,)`` int32, the run's number among all runs, or ``LAST`` where dropped.
    """
    n = values.shape[0]
    position = jnp.arange(n, dtype=jnp.int32)
    valid = group != LAST
    steps = (values[1:] - values[:-1] > gap[:-1]) | (group[1:] != group[:-1])
    starts = jnp.concatenate([jnp.ones(1, bool), steps]) | ~valid
    first = lax.cummax(jnp.where(starts, position, 0))
    next_start = jnp.concatenate([jnp.where(starts, position, n)[1:], jnp.full(1, n, jnp.int32)])
    size = lax.cummin(next_start, reverse=True) - first
    return jnp.where(valid & (size > min_points), jnp.cumsum(starts, dtype=jnp.int32) - 1, LAST)


def _number(
    part: jax.Array, x: jax.Array, z: jax.Array, slot: jax.Array, max_parts: int
) -> tuple[jax.Array, jax.Array]:
    """Numbers the parts by nearest z, then smallest x, and puts the labels back in their slots.

    Args:
        part: ``(N,)`` int32, equal within a part, rising but for ``LAST``.
        x: ``(N,)`` int32.
        z: ``(N,)`` int32.
        slot: ``(N,)`` int32, the feature slot of each entry.
        max_parts: As many parts as there can be.

    Returns:
        ``labels`` ``(N,)`` int32 and their number, int32.
    """
    m = max(1, max_parts)
    kept = part != LAST
    previous = jnp.concatenate([jnp.full(1, -1, jnp.int32), part[:-1]])
    index = jnp.cumsum(kept & (part != previous), dtype=jnp.int32) - 1
    index = jnp.where(kept, index, m)
    nearest = jnp.full(m, LAST).at[index].min(z, mode="drop")
    leftmost = jnp.full(m, LAST).at[index].min(x, mode="drop")
    *_, order = lax.sort((nearest, leftmost, jnp.arange(m, dtype=jnp.int32)), num_keys=2)
    label = jnp.zeros(m, jnp.int32).at[order].set(jnp.arange(m, dtype=jnp.int32))
    labels = jnp.where(kept, label[jnp.minimum(index, m - 1)], -1)
    count = jnp.sum(nearest != LAST, dtype=jnp.int32)
    return jnp.full(part.shape, -1, jnp.int32).at[slot].set(labels, unique_indices=True), count
