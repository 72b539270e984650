"""Stage 4, cluster: sorts, gap flags and segmented scans."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxdet.checks import check_points
from jaxdet.config import ClusterConfig, Config
from jaxdet.floor.plane import depth_gap_units
from jaxdet.stages._tables import kernel_table
from jaxdet.types import MAX_LATERAL, Features, Labels

PLACE_BITS, VALUE_BITS = 13, 19  # a frame has at most 2^13 points, and so many parts
LAST = (1 << VALUE_BITS) - 1  # beyond all values
NONE = np.uint32(0xFFFFFFFF)  # beyond all keys, as x + MAX_LATERAL is below LAST


def cluster(features: Features, depth_unit: float, config: Config) -> Labels:
    """Equals :func:`jaxdet.reference.cluster`.

    Sorts and segmented scans over all frames: sort by depth, flag gaps, number the sets by running
    sums and count them; the same by set and x; number what is left. z is below 65536, x at most
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
    return kernel_table([*gaps, config.min_points])


def most_obstacles(points: int, config: ClusterConfig) -> int:
    """``M``, as many obstacles as ``points`` points can make, at least 1."""
    return max(1, points // (config.min_points + 1))


@partial(jax.jit, static_argnames="most")
def labels(features: Features, settings: jax.Array, most: int) -> Labels:
    """The labels of points, from :func:`gap_settings` and :func:`most_obstacles`."""
    with jax.named_scope("cluster"):
        depth_gap, lateral_gap, min_points = settings
        x, z, n = features.x, features.z, features.z.shape[1]
        depth, slot = _sorted(jnp.where(features.kept, z, LAST))
        part = _parts(depth, jnp.where(depth < LAST, 0, n), depth_gap, min_points)
        part = _put(slot, part)
        key = part.astype(jnp.uint32) << VALUE_BITS | (x + MAX_LATERAL).astype(jnp.uint32)
        key = jnp.where(part < n, key, NONE)
        keys = jnp.sort(key, axis=1)
        group = jnp.where(keys < NONE, (keys >> VALUE_BITS).astype(jnp.int32), n)
        part = _parts((keys & LAST).astype(jnp.int32), group, lateral_gap, min_points)
        # Equal keys are neighbours, so any of them will do.
        place = jax.vmap(jnp.searchsorted)(keys, key)
        return _numbered(part, place, z, most)


def _parts(values: jax.Array, group: jax.Array, gap: jax.Array, min_points: jax.Array) -> jax.Array:
    """Numbers the runs of ``values`` without a gap, in order.

    Args:
        values: ``(B, N)`` int32, rising within each group.
        group: ``(B, N)`` int32, rising; a new group starts a new run; N takes no part.
        gap: The largest step from an entry to the next.
        min_points: Runs of this many entries or fewer are dropped.

    Returns:
        ``(B, N)`` int32, the run's number among all runs, or N where dropped.
    """
    n = values.shape[1]
    starts = (values[:, 1:] - values[:, :-1] > gap) | (group[:, 1:] != group[:, :-1])
    run = jnp.pad(jnp.cumsum(starts, axis=1, dtype=jnp.int32), ((0, 0), (1, 0)))
    size = jnp.zeros_like(run).at[_rows(run), run].add(1)
    return jnp.where((group < n) & (_take(size, run) > min_points), run, n)


def _numbered(part: jax.Array, place: jax.Array, z: jax.Array, most: int) -> Labels:
    """Numbers the parts by nearest z, then smallest x.

    Parts that are equally near are of one set of neighbours in depth, so in the order of x already.

    Args:
        part: ``(B, N)`` int32, the part at each place, N for none; those of a part follow each
            other.
        place: ``(B, N)`` int32, where each point is.
        z: ``(B, N)`` int32, of the points.
        most: As many parts as there can be.
    """
    n = part.shape[1]
    starts = (jnp.diff(part, axis=1, prepend=n) != 0) & (part < n)
    index = jnp.where(part < n, jnp.cumsum(starts, axis=1, dtype=jnp.int32) - 1, most)
    index = _take(index, place)
    nearest = jnp.full((len(z), most), LAST).at[_rows(z), index].min(z, mode="drop")
    _, order = _sorted(nearest)
    number = _take(_put(order, _positions(order)), jnp.minimum(index, most - 1))
    found = jnp.where(index < most, number, -1)
    return Labels(found, jnp.sum(nearest < LAST, axis=1, dtype=jnp.int32))


def _sorted(values: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Values of each row in rising order, and their places, ``(B, N)`` int32.

    Both are one 32-bit key, which is what XLA sorts quickly on every device.
    """
    key = values.astype(jnp.uint32) << PLACE_BITS | _positions(values).astype(jnp.uint32)
    key = jnp.sort(key, axis=1)
    place = key & ((1 << PLACE_BITS) - 1)
    return (key >> PLACE_BITS).astype(jnp.int32), place.astype(jnp.int32)


def _take(values: jax.Array, place: jax.Array) -> jax.Array:
    """Of each row, the values at places, ``(B, N)``."""
    return jnp.take_along_axis(values, place, axis=1, mode="promise_in_bounds")


def _put(place: jax.Array, values: jax.Array) -> jax.Array:
    """Of each row, values put at places that are a permutation, ``(B, N)``."""
    return jnp.zeros_like(values).at[_rows(place), place].set(values, unique_indices=True)


def _positions(values: jax.Array) -> jax.Array:
    """``(B, N)`` int32, the place of each value in its row."""
    return lax.broadcasted_iota(jnp.int32, values.shape, 1)


def _rows(values: jax.Array) -> jax.Array:
    """``(B, 1)``, the row of each value."""
    return jnp.arange(len(values))[:, None]
