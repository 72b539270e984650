"""Stage 4, cluster: two sorts, gap flags and segmented scans."""

from functools import partial

import jax
import jax.numpy as jnp
from jax import lax

from jaxdet.config import Config
from jaxdet.types import Features, Labels

LAST = jnp.iinfo(jnp.int32).max


def cluster(features: Features, depth_unit: float, config: Config) -> Labels:
    """Groups the kept features of each frame into obstacles (Eq. 6, Section 3.4).

    Equals :func:`jaxdet.reference.cluster`. Every frame is an array program of its own, mapped
    over the batch: sort by depth, flag gaps, count each set; sort by set and x, flag gaps, count
    again; number what is left.

    Args:
        features: ``(B, N)`` points; only ``kept`` ones take part.
        depth_unit: Metres in one depth unit.
        config: The gaps and N of its cluster part.

    Returns:
        Labels numbered in order of nearest z, then smallest x, with -1 for no obstacle.
    """
    settings = config.cluster
    gaps = round(settings.depth_gap_m / depth_unit), round(settings.lateral_gap_m / depth_unit)
    return Labels(*_cluster(features.x, features.z, features.kept, gaps, settings.min_points))


@partial(jax.jit, static_argnames=("gaps", "min_points"))
def _cluster(
    x: jax.Array, z: jax.Array, kept: jax.Array, gaps: tuple[int, int], min_points: int
) -> tuple[jax.Array, jax.Array]:
    with jax.named_scope("cluster"):
        return jax.vmap(partial(_cluster_frame, gaps=gaps, min_points=min_points))(x, z, kept)


def _cluster_frame(
    x: jax.Array, z: jax.Array, kept: jax.Array, gaps: tuple[int, int], min_points: int
) -> tuple[jax.Array, jax.Array]:
    """One frame: ``(N,)`` each."""
    n = z.shape[0]
    slot = jnp.arange(n, dtype=jnp.uint32)
    # Depth needs 16 bits and the slot at most 15, so one 32-bit key sorts both; what does not
    # take part is deeper than any depth.
    depth = jnp.where(kept, z.astype(jnp.uint32), jnp.uint32(1 << 16))
    key = jnp.sort((depth << 15) | slot)
    slot = (key & 0x7FFF).astype(jnp.int32)
    z_sorted = (key >> 15).astype(jnp.int32)
    taking_part = z_sorted < (1 << 16)
    set_number = _gap_sets(z_sorted, jnp.zeros_like(slot), taking_part, gaps[0], min_points)

    set_number, x_sorted, slot = lax.sort((set_number, x[slot], slot), num_keys=2)
    part = _gap_sets(x_sorted, set_number, set_number != LAST, gaps[1], min_points)
    return _number(part, x_sorted, z[slot], slot, n // (min_points + 1))


def _gap_sets(
    values: jax.Array, group: jax.Array, valid: jax.Array, gap: int, min_points: int
) -> jax.Array:
    """Numbers the runs of ``values`` without a gap, in order.

    Args:
        values: ``(N,)`` int32, rising within each group.
        group: ``(N,)`` int32, rising; a new group starts a new run.
        valid: ``(N,)`` bool, the valid entries come first.
        gap: The largest step within a run.
        min_points: Runs of this many entries or fewer are dropped.

    Returns:
        ``(N,)`` int32, the run's number among all runs, or ``LAST`` where dropped or not valid.
    """
    n = values.shape[0]
    position = jnp.arange(n, dtype=jnp.int32)
    steps = (values[1:] - values[:-1] > gap) | (group[1:] != group[:-1])
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
