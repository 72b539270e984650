"""Stage 5, footprint: segment reductions, and a sort for each axis."""

from functools import lru_cache, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxdet.checks import check_points
from jaxdet.config import TRIM_SHARE, Config, FootprintConfig
from jaxdet.floor.plane import band_table, ground_axes
from jaxdet.stages._tables import kernel_table
from jaxdet.stages.paper._cluster import most_obstacles
from jaxdet.types import MAX_LATERAL, Features, GroundPlane, Labels, Obstacles

VALUE_BITS = 19
"""Number of bits of a coordinate (made non-negative) in a sort key; the other bits hold the number
of the obstacle."""
LAST = jnp.iinfo(jnp.int32).max


def footprint(
    features: Features, labels: Labels, plane: GroundPlane, depth_unit: float, config: Config
) -> Obstacles:
    """Measure obstacles, by segment reductions; twin of :func:`jaxdet.reference.paper.footprint`.

    Raises:
        ConfigError: There are more than 8192 points per frame.
    """
    points = features.z.shape[1]
    check_points(points)
    axes = jnp.asarray(ground_axes(plane))
    shared = tables(config.footprint, depth_unit)
    return obstacles(features, labels, axes, shared, most_obstacles(points, config.cluster))


class Tables(NamedTuple):
    """Arrays for :func:`obstacles`, from the configuration."""

    bands: jax.Array  # (65536, 2) int32, from jaxdet.floor.plane.band_table
    settings: jax.Array  # (2,) int32: the threshold of a vertex [depth units] and trim


@lru_cache(maxsize=8)
def tables(config: FootprintConfig, depth_unit: float) -> Tables:
    """Return the tables on the device."""
    threshold = round(config.vertex_threshold_m / depth_unit)
    settings = kernel_table([threshold, config.trim])
    return Tables(jnp.asarray(band_table(config, depth_unit)), jnp.asarray(settings))


@partial(jax.jit, static_argnames="most")
def obstacles(
    features: Features, labels: Labels, axes: jax.Array, shared: Tables, most: int
) -> Obstacles:
    """Measure the obstacles; the result has ``most`` slots per frame.

    Args:
        features: Points ``(B, N)``.
        labels: Obstacles of the points.
        axes: Axes ``(B, 2, 3)`` int32, from :func:`jaxdet.floor.plane.ground_axes`.
        shared: From :func:`tables`.
        most: From :func:`jaxdet.stages.paper._cluster.most_obstacles`.
    """
    with jax.named_scope("footprint"):
        uv = jnp.stack([features.u, features.v], axis=-1)
        xyz = jnp.stack([features.x, features.y, features.z], axis=-1)
        floor = jnp.clip(to_ground(xyz, axes), -MAX_LATERAL, MAX_LATERAL)
        measure = partial(_measure, shared=shared, m=most)
        return jax.vmap(measure)(labels.labels, uv, xyz, floor)


def to_ground(xyz: jax.Array, axes: jax.Array) -> jax.Array:
    """Return ``(xyz . axis + half) >> GROUND_BITS`` in 32-bit arithmetic.

    The coordinates are split at ten bits; rounding down in two steps is exact, as in ``lateral``.

    Args:
        xyz: Points ``(B, N, 3)`` int32 [depth units].
        axes: Axes ``(B, 2, 3)`` int32 with ``GROUND_BITS = 13`` fraction bits.

    Returns:
        Right and forward ``(B, N, 2)`` int32 [depth units].
    """

    def along(values: jax.Array) -> jax.Array:
        return jnp.sum(values[:, :, None, :] * axes[:, None, :, :], axis=-1, dtype=jnp.int32)

    high, low = along(xyz >> 10), along(xyz & 1023)
    return (high + ((low + 4096) >> 10)) >> 3


def _measure(
    labels: jax.Array,
    uv: jax.Array,
    xyz: jax.Array,
    floor: jax.Array,
    shared: Tables,
    m: int,
) -> Obstacles:
    """Measure one frame's obstacles ``(M, ...)`` from ``labels (N,)`` and points ``(N, k)``."""
    threshold, trim = shared.settings
    own = jnp.where(labels >= 0, labels, m)

    def reduce(operation: str, values: jax.Array, start: int) -> jax.Array:
        empty = jnp.full((m, *values.shape[1:]), start, jnp.int32)
        return getattr(empty.at[own], operation)(values, mode="drop")

    # 32 bits suffice: at most MAX_POINTS coordinates of at most MAX_LATERAL.
    points, total = reduce("add", jnp.ones_like(labels), 0), reduce("add", xyz, 0)
    some = points > 0

    def extreme(operation: str, values: jax.Array) -> jax.Array:
        start = LAST if operation == "min" else -LAST
        out = reduce(operation, values, start)
        return jnp.where(some.reshape(-1, *[1] * (out.ndim - 1)), out, 0)

    def least(values: jax.Array, best: jax.Array, of: jax.Array) -> jax.Array:
        """Return each obstacle's minimum of ``values`` over its points with ``of == best``."""
        tied = of == best[jnp.minimum(own, m - 1)]
        return extreme("min", jnp.where(tied, values, LAST))

    right, forward = floor[:, 0], floor[:, 1]
    distance = jnp.clip(extreme("min", forward), 0, len(shared.bands) - 1)
    side, near = shared.bands[distance].T
    passed = jnp.minimum(trim, points // TRIM_SHARE)
    a_right, b_right = _outermost(own, right, points, passed, side)
    c_forward, _ = _outermost(own, forward, points, passed, near)
    a_forward, b_forward = (least(forward, best, right) for best in (a_right, b_right))
    c_right = least(right, c_forward, forward)
    high, low = _squared_length(floor)
    near_high = extreme("min", high)
    near_low = least(low, near_high, high)
    a = jnp.stack([a_right, a_forward], axis=-1)
    b = jnp.stack([b_right, b_forward], axis=-1)
    return Obstacles(
        num_points=points,
        uv_min=extreme("min", uv),
        uv_max=extreme("max", uv),
        xyz_min=extreme("min", xyz),
        xyz_max=extreme("max", xyz),
        xyz_sum=jnp.stack([total >> 16, total & 0xFFFF], axis=-1),
        a=a,
        b=b,
        c=jnp.stack([c_right, c_forward], axis=-1),
        has_vertex=some & (jnp.minimum(a_forward, b_forward) - c_forward >= threshold),
        direction=jnp.zeros_like(a),
        span=jnp.zeros((m, 4), jnp.int32),
        nearest=jnp.stack([near_high, near_low], axis=-1),
    )


def _squared_length(floor: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return squared lengths of ``(N, 2)`` int32 as quotient and remainder by 2^18.

    Coordinates are at most MAX_LATERAL. 32 bits suffice: the square of ``x = 2^9 h + l`` is
    ``2^18 h^2 + 2^10 h l + l^2``.
    """
    high, low = jnp.abs(floor) >> 9, jnp.abs(floor) & 511
    rest = jnp.sum((high * low << 10) + low * low, axis=-1, dtype=jnp.int32)
    whole = jnp.sum(high * high, axis=-1, dtype=jnp.int32)
    return whole + (rest >> 18), rest & ((1 << 18) - 1)


def _outermost(
    own: jax.Array, values: jax.Array, points: jax.Array, passed: jax.Array, band: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Return the medians of each obstacle's values in the bands at both ends of their range.

    Args:
        own: Obstacle of each point, ``(N,)`` int32; M if the point has none.
        values: Coordinates ``(N,)`` int32, at most MAX_LATERAL.
        points: Number of points of each obstacle, ``(M,)`` int32.
        passed: Number of outermost values that are trimmed, ``(M,)`` int32.
        band: Width of the band, ``(M,)`` int32.

    Returns:
        ``(M,)`` int32 each, 0 for obstacles without points.
    """
    n, m = own.shape[0], points.shape[0]
    most = (1 << VALUE_BITS) - 1
    key = (own.astype(jnp.uint32) << VALUE_BITS) | (values + MAX_LATERAL).astype(jnp.uint32)
    key = jnp.sort(jnp.where(own < m, key, jnp.uint32(0xFFFFFFFF)))
    end = jnp.cumsum(points, dtype=jnp.int32)
    start = end - points

    def value_at(place: jax.Array) -> jax.Array:
        return (key[jnp.clip(place, 0, n - 1)] & most).astype(jnp.int32)

    def place_of(value: jax.Array, side: str) -> jax.Array:
        first = jnp.arange(m, dtype=jnp.uint32) << VALUE_BITS
        wanted = first | jnp.clip(value, 0, most).astype(jnp.uint32)
        return jnp.searchsorted(key, wanted, side=side, method="scan_unrolled").astype(jnp.int32)

    first, last = start + passed, end - 1 - passed
    band_end = place_of(value_at(first) + band, "right")
    band_start = place_of(value_at(last) - band, "left")
    low, high = (first + band_end - 1) // 2, last - (last - band_start) // 2
    some = points > 0
    return (
        jnp.where(some, value_at(low) - MAX_LATERAL, 0),
        jnp.where(some, value_at(high) - MAX_LATERAL, 0),
    )
