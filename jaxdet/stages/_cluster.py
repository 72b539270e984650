"""Stage 4, cluster: sorts, gap flags and segmented scans."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxdet.checks import check_points
from jaxdet.config import ClusterConfig, Config
from jaxdet.floor.plane import depth_gap_units
from jaxdet.stages._teams import kernel_table
from jaxdet.types import MAX_LATERAL, Features, Labels

LAST = jnp.iinfo(jnp.int32).max
RANK_BITS = 13  # a frame has at most 2^13 points; what is sorted has 19 bits
RANK_MASK = (1 << RANK_BITS) - 1


def cluster(features: Features, depth_unit: float, config: Config) -> Labels:
    """Equals :func:`jaxdet.reference.cluster`.

    Every frame is an array program of its own, mapped over the batch: sort by set and depth, flag
    gaps, count each set; the same by set and x; number what is left. z is below 65536, x at most
    MAX_LATERAL.

    Raises:
        ConfigError: There are more than 8192 points a frame.
    """
    points = features.z.shape[1]
    check_points(points)
    settings = jnp.asarray(gap_settings(config.cluster, depth_unit))
    return labels(features, settings, most_obstacles(points, config.cluster))


def gap_settings(config: ClusterConfig, depth_unit: float) -> np.ndarray:
    """What :func:`labels` takes of the configuration, ``(3,)`` int32.

    The gaps in depth and sideways [depth units], and how many points are too few.
    """
    gaps = depth_gap_units(config, depth_unit), round(config.lateral_gap_m / depth_unit)
    return kernel_table(np.array([*gaps, config.min_points]))


def most_obstacles(points: int, config: ClusterConfig) -> int:
    """``M``, as many obstacles as ``points`` points can make, at least 1."""
    return max(1, points // (config.min_points + 1))


@partial(jax.jit, static_argnames="most")
def labels(features: Features, settings: jax.Array, most: int) -> Labels:
    """The labels of points, from :func:`gap_settings` and :func:`most_obstacles`."""
    with jax.named_scope("cluster"):
        split, number = partial(_gap_parts, settings=settings), partial(_number, most=most)
        x, z = features.x, features.z
        part = jax.vmap(split)(x, z, features.kept)
        return Labels(*jax.vmap(number)(part, x, z))


def _gap_parts(x: jax.Array, z: jax.Array, kept: jax.Array, settings: jax.Array) -> jax.Array:
    """The sets of Steps 1-5 of one frame, ``(N,)`` each: a number a set, N for none.

    The points are ranked along both axes once. A set's points are then in order after one sort
    of ``set << RANK_BITS | place``: every sort has a single 32-bit key, which is what XLA sorts
    quickly on every device.
    """
    n = z.shape[0]
    depth_gap, lateral_gap, min_points = settings
    by_z, z_rank = _rank(z)
    by_x, x_rank = _rank(x + MAX_LATERAL)
    group = jnp.where(kept, 0, n)
    for values, order, place, gap in (
        (z, by_z, z_rank, depth_gap),
        (x, by_x, x_rank, lateral_gap),
    ):
        key = jnp.sort((group.astype(jnp.uint32) << RANK_BITS) | place)
        slot = order[key & RANK_MASK]
        sorted_group = (key >> RANK_BITS).astype(jnp.int32)
        part = _gap_sets(values[slot], sorted_group, gap, min_points)
        group = jnp.zeros(n, jnp.int32).at[slot].set(part, unique_indices=True)
    return group


def _rank(values: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Sorts ``(N,)`` int32 values in [0, 2^19).

    Returns:
        The slots in rising order, and each slot's rank, both ``(N,)``, int32 and uint32.
    """
    n = values.shape[0]
    slot = jnp.arange(n, dtype=jnp.uint32)
    order = jnp.sort((values.astype(jnp.uint32) << RANK_BITS) | slot) & RANK_MASK
    order = order.astype(jnp.int32)
    return order, jnp.zeros(n, jnp.uint32).at[order].set(slot, unique_indices=True)


def _gap_sets(
    values: jax.Array, group: jax.Array, gap: jax.Array, min_points: jax.Array
) -> jax.Array:
    """Numbers the runs of ``values`` without a gap, in order.

    Args:
        values: ``(N,)`` int32, rising within each group.
        group: ``(N,)`` int32, rising; a new group starts a new run; N takes no part.
        gap: The largest step from an entry to the next.
        min_points: Runs of this many entries or fewer are dropped.

    Returns:
        ``(N,)`` int32, the run's number among all runs, or N where dropped.
    """
    n = values.shape[0]
    position = jnp.arange(n, dtype=jnp.int32)
    valid = group != n
    steps = (values[1:] - values[:-1] > gap) | (group[1:] != group[:-1])
    starts = jnp.concatenate([jnp.ones(1, bool), steps]) | ~valid
    first = lax.cummax(jnp.where(starts, position, 0))
    next_start = jnp.concatenate([jnp.where(starts, position, n)[1:], jnp.full(1, n, jnp.int32)])
    size = lax.cummin(next_start, reverse=True) - first
    return jnp.where(valid & (size > min_points), jnp.cumsum(starts, dtype=jnp.int32) - 1, n)


def _number(part: jax.Array, x: jax.Array, z: jax.Array, most: int) -> tuple[jax.Array, jax.Array]:
    """Numbers the parts by nearest z, then smallest x.

    Args:
        part: ``(N,)`` int32, equal within a part; N takes no part.
        x: ``(N,)`` int32.
        z: ``(N,)`` int32.
        most: As many parts as there can be.

    Returns:
        ``labels`` ``(N,)`` int32 and their number, int32.
    """
    n, m = part.shape[0], most
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
