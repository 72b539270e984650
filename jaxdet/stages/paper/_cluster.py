"""Stage 4, cluster: a histogram of depth, a sort by set and x, gap flags and segmented scans."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxdet.checks import check_points
from jaxdet.config import ClusterConfig, Config
from jaxdet.floor.plane import gap_units
from jaxdet.stages._tables import kernel_table
from jaxdet.types import MAX_LATERAL, Features, Labels

PLACE_BITS, VALUE_BITS = 13, 19  # a frame has at most 2^13 points, runs and obstacles
LAST = (1 << VALUE_BITS) - 1  # larger than all values
NONE = np.uint32(0xFFFFFFFF)  # larger than all keys, since x + MAX_LATERAL is below LAST
DEPTHS = 1 << 16  # z is less than this
BLOCK = 32  # number of entries per block of prefix sums, see _running_sum
MOST_BLOCKS = 512  # with more blocks, the matrix that sums them exceeds a megabyte


class Sizes(NamedTuple):
    """Sizes that the program is compiled for."""

    most: int
    """Maximum number of obstacles ``M``, see :func:`most_obstacles`."""
    bins: int
    """Number of bins of depth."""


def cluster(features: Features, depth_unit: float, config: Config) -> Labels:
    """Cluster points by gaps; twin of :func:`jaxdet.reference.paper.cluster`.

    Each step is a scan over all frames. First, points that are neighbours in depth form sets; the
    sets are numbered through bins of depth, and their points are counted. Then points are sorted by
    set and x, runs between gaps are numbered by prefix sums, and their points are counted. Finally,
    runs with enough points are numbered. z must be below 65536, and abs(x) at most MAX_LATERAL.

    Raises:
        ConfigError: There are more than 8192 points per frame.
    """
    points = features.z.shape[1]
    check_points(points)
    settings = gap_settings(config.cluster, depth_unit)
    return labels(features, settings, sizes(points, config.cluster, depth_unit))


def gap_settings(config: ClusterConfig, depth_unit: float) -> np.ndarray:
    """Return the gaps in depth and sideways [depth units] and the minimum number of points."""
    return kernel_table([*gap_units(config, depth_unit), config.min_points])


def sizes(points: int, config: ClusterConfig, depth_unit: float) -> Sizes:
    """Return the sizes for ``points`` points per frame."""
    depth_gap, _ = gap_units(config, depth_unit)
    width = max(1, depth_gap)
    bins = 1 << (DEPTHS // width).bit_length()  # a power of 2, so that few programs are compiled
    return Sizes(most_obstacles(points, config), bins)


def most_obstacles(points: int, config: ClusterConfig) -> int:
    """Return ``M``, the largest number of obstacles that ``points`` points can form, at least 1."""
    return max(1, points // (config.min_points + 1))


@partial(jax.jit, static_argnames="size")
def labels(features: Features, settings: jax.Array, size: Sizes) -> Labels:
    """Return the labels of points, from :func:`gap_settings` and :func:`sizes`."""
    with jax.named_scope("cluster"):
        depth_gap, lateral_gap, min_points = settings
        x, z, most = features.x, features.z, size.most
        column = _sets(z, features.kept, depth_gap, size.bins)
        large = _sizes(column, features.kept) > min_points
        kept = features.kept & _take(large, column)
        key = column.astype(jnp.uint32) << VALUE_BITS | (x + MAX_LATERAL).astype(jnp.uint32)
        key = jnp.where(kept, key, NONE)
        keys = jnp.sort(key, axis=1)
        run = _runs((keys & LAST).astype(jnp.int32), keys >> VALUE_BITS, lateral_gap)
        large = _sizes(run, keys < NONE) > min_points
        obstacle = jnp.where(large, _running_sum(large) - 1, most)
        # Equal keys are adjacent, so the first of them is sufficient.
        obstacle = _take(obstacle, _take(run, _first_place(keys, key)))
        return _numbered(obstacle, z, most)


def _sets(z: jax.Array, kept: jax.Array, gap: jax.Array, bins: int) -> jax.Array:
    """Number the sets of neighbours in depth (steps 1 to 4) by nearest z, from 0.

    The points of a bin as wide as the gap are neighbours of each other. Those of two bins are
    neighbours only if the bins are adjacent and no more than the gap lies between the farthest
    point of one and the nearest of the other.

    Args:
        z: Depth of the points, ``(B, N)`` int32.
        kept: Mask of the points to cluster, ``(B, N)`` bool.
        gap: Largest difference in depth of neighbours.
        bins: Number of bins.

    Returns:
        Set of each point, ``(B, N)`` int32, below ``N``; arbitrary for all other points.
    """
    place = jnp.where(kept, z // jnp.maximum(gap, 1), bins)
    shape, row = (len(z), bins), _rows(z)
    nearest = jnp.full(shape, LAST).at[row, place].min(z, mode="drop")
    farthest = jnp.full(shape, -LAST).at[row, place].max(z, mode="drop")
    apart = nearest[:, 1:] - farthest[:, :-1] > gap
    starts = jnp.pad(apart, ((0, 0), (1, 0)), constant_values=True) & (nearest < LAST)
    found = _take(_running_sum(starts) - 1, jnp.minimum(place, bins - 1))
    return jnp.maximum(found, 0)


def _runs(values: jax.Array, group: jax.Array, gap: jax.Array) -> jax.Array:
    """Number the runs of ``values`` without a gap (Eq. 6), from 0.

    Args:
        values: Values ``(B, N)`` int32, ascending within each group.
        group: Group of each entry, ``(B, N)``; a group's entries are adjacent and start a new run.
        gap: Largest difference between adjacent entries of a run.

    Returns:
        Run of each entry, ``(B, N)`` int32.
    """
    starts = (values[:, 1:] - values[:, :-1] > gap) | (group[:, 1:] != group[:, :-1])
    return _running_sum(jnp.pad(starts, ((0, 0), (1, 0))))


def _sizes(run: jax.Array, valid: jax.Array) -> jax.Array:
    """Return the number of valid entries of each run, ``(B, N)`` int32."""
    return jnp.zeros_like(run).at[_rows(run), run].add(valid.astype(jnp.int32))


def _running_sum(flags: jax.Array) -> jax.Array:
    """Return the number of flags up to and including each entry of its row, ``(B, N)`` int32.

    Prefix sums are computed within blocks, then over the sums of blocks, as products with a
    triangular matrix of ones, in a third of the time of ``jnp.cumsum`` on the CPU. They are exact
    in float32 and in TF32, because factors are 0 to ``BLOCK`` and sums are below 2^24.
    """
    count = flags.shape[1]
    if count > MOST_BLOCKS * BLOCK:
        return jnp.cumsum(flags, axis=1, dtype=jnp.int32)
    padded = jnp.pad(flags.astype(jnp.float32), ((0, 0), (0, -count % BLOCK)))
    blocks = padded.reshape(len(flags), -1, BLOCK)
    within = blocks @ np.triu(np.ones((BLOCK, BLOCK), np.float32))
    size = blocks.shape[1]
    before = within[..., -1] @ np.triu(np.ones((size, size), np.float32), 1)
    sums = (within + before[..., None]).reshape(len(flags), -1)
    return sums[:, :count].astype(jnp.int32)


def _first_place(keys: jax.Array, key: jax.Array) -> jax.Array:
    """Return the first position of ``key`` in each row's ascending ``keys``, ``(B, N)``.

    The binary search has steps of powers of two and carries no bounds from step to step, so it
    takes half the time of ``jnp.searchsorted`` on the CPU.
    """
    count = keys.shape[1]
    bits = count.bit_length()
    padded = jnp.pad(keys, ((0, 0), (0, (1 << bits) - 1 - count)), constant_values=NONE)

    def halve(turn: int, place: jax.Array) -> jax.Array:
        half = jnp.int32(1) << (bits - 1 - turn)
        return place + jnp.where(_take(padded, place + half - 1) < key, half, 0)

    return lax.fori_loop(0, bits, halve, jnp.zeros(key.shape, jnp.int32))


def _numbered(obstacle: jax.Array, z: jax.Array, most: int) -> Labels:
    """Number the obstacles by nearest z, then smallest x.

    Obstacles with equal nearest z belong to one set of neighbours in depth, so they are already
    sorted by x.

    Args:
        obstacle: Obstacle of each point, ``(B, N)`` int32, ``most`` if the point has none.
        z: Depth of the points, ``(B, N)`` int32.
        most: Maximum number of obstacles.
    """
    nearest = jnp.full((len(z), most), LAST).at[_rows(z), obstacle].min(z, mode="drop")
    # Nearest z and number are packed into one 32-bit key, which XLA sorts quickly on every device.
    key = nearest.astype(jnp.uint32) << PLACE_BITS | jnp.arange(most, dtype=jnp.uint32)[None]
    rank = _first_place(jnp.sort(key, axis=1), key)
    number = _take(rank, jnp.minimum(obstacle, most - 1))
    found = jnp.where(obstacle < most, number, -1)
    return Labels(found, jnp.sum(nearest < LAST, axis=1, dtype=jnp.int32))


def _take(values: jax.Array, place: jax.Array) -> jax.Array:
    """Return the values at positions of each row, ``(B, N)``."""
    return jnp.take_along_axis(values, place, axis=1, mode="promise_in_bounds")


def _rows(values: jax.Array) -> jax.Array:
    """Return the row of each value, ``(B, 1)``."""
    return jnp.arange(len(values))[:, None]
