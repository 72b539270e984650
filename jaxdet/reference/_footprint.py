"""Stage 5, footprint: extent and outline of each obstacle on the floor (Section 3.5)."""

import numpy as np

from jaxdet.config import TRIM_SHARE, Config, FootprintConfig
from jaxdet.floor.plane import GROUND_BITS, band_table, ground_axes
from jaxdet.types import MAX_LATERAL, Features, GroundPlane, Labels, Obstacles


def footprint(
    features: Features,
    labels: Labels,
    plane: GroundPlane,
    depth_unit: float,
    config: Config,
) -> Obstacles:
    """Measure each obstacle and find its points A, B and C on the floor (Eq. 7).

    The points are projected onto the floor (:func:`to_ground`), at most MAX_LATERAL away. A is the
    leftmost, B the rightmost, C the nearest; ties go to the nearer point, for C to the leftmost. If
    the configuration sets a trim and bands, the outermost and nearest points are trimmed, and A, B
    and C are medians of bands instead (:func:`_outermost`). C is a vertex unless

        min(d_A, d_B) - d_C < d_threshold

    with d the distance forward. :func:`jaxdet.results.metric.rectangles` draws the rectangle, which
    need not contain all points: points in front of AB, to the side of C or behind are outside.
    Therefore ``nearest`` is computed from all points.

    Args:
        features: ``(B, N)`` points.
        labels: Their obstacles.
        plane: Floor of each frame, for the axes of the ground frame.
        depth_unit: Metres in one depth unit.
        config: Configuration, of which ``footprint`` is used; ``M`` follows from N and
            ``cluster.min_points``.

    Returns:
        ``(B, M)`` obstacles in the order of their labels.
    """
    slots = max(1, labels.labels.shape[1] // (config.cluster.min_points + 1))
    floor = np.clip(to_ground(features, plane), -MAX_LATERAL, MAX_LATERAL)
    found = footprint_on_floor(features, labels, floor, depth_unit, config.footprint, slots=slots)
    return found._replace(nearest=_nearest(labels, floor, slots))


def _nearest(labels: Labels, floor: np.ndarray, slots: int) -> np.ndarray:
    """Return squared distances of the obstacles' nearest points, ``(B, M, 2)``: divmod by 2^18."""
    squared = (floor.astype(np.int64) ** 2).sum(axis=-1)
    nearest = np.zeros((len(floor), slots), np.int64)
    for b, count in enumerate(labels.num_obstacles):
        for label in range(int(count)):
            nearest[b, label] = squared[b, labels.labels[b] == label].min()
    return np.stack(np.divmod(nearest, 1 << 18), axis=-1).astype(np.int32)


def footprint_on_floor(
    features: Features,
    labels: Labels,
    floor: np.ndarray,
    depth_unit: float,
    config: FootprintConfig,
    *,
    slots: int,
) -> Obstacles:
    """Measure obstacles from the positions of their points on the floor, see :func:`footprint`.

    Args:
        features: ``(B, N)`` points.
        labels: Their obstacles.
        floor: Right and forward ``(B, N, 2)`` integer, at most MAX_LATERAL [depth units].
        depth_unit: Metres in one depth unit.
        config: Trim, bands and threshold of the vertex.
        slots: ``M``.

    Returns:
        ``(B, M)`` obstacles in the order of their labels; direction and span are zero, nearest is
        None.
    """
    batch, m = len(labels.labels), slots
    threshold = round(config.vertex_threshold_m / depth_unit)
    shapes = {"num_points": (m,), "has_vertex": (m,)}
    shapes |= dict.fromkeys(("uv_min", "uv_max", "a", "b", "c", "direction"), (m, 2))
    shapes |= {"span": (m, 4)}
    shapes |= dict.fromkeys(("xyz_min", "xyz_max"), (m, 3)) | {"xyz_sum": (m, 3, 2)}
    out = Obstacles(**{k: np.zeros((batch, *shape), np.int32) for k, shape in shapes.items()})
    bands = band_table(config, depth_unit)
    uv = np.stack([features.u, features.v], axis=-1)
    xyz = np.stack([features.x, features.y, features.z], axis=-1)
    for b in range(batch):
        for label in range(int(labels.num_obstacles[b])):
            own = labels.labels[b] == label
            out.num_points[b, label] = own.sum()
            out.uv_min[b, label], out.uv_max[b, label] = uv[b, own].min(0), uv[b, own].max(0)
            out.xyz_min[b, label], out.xyz_max[b, label] = xyz[b, own].min(0), xyz[b, own].max(0)
            out.xyz_sum[b, label] = np.stack(np.divmod(xyz[b, own].sum(0, np.int64), 1 << 16), -1)
            a_b_c = _outline(floor[b, own], config.trim, bands)
            out.a[b, label], out.b[b, label], out.c[b, label] = a_b_c
            (_, d_a), (_, d_b), (_, d_c) = a_b_c
            out.has_vertex[b, label] = min(d_a, d_b) - d_c >= threshold
    return out._replace(has_vertex=out.has_vertex.astype(bool))


def to_ground(features: Features, plane: GroundPlane) -> np.ndarray:
    """Transform points to the ground frame, in integer depth units.

    Returns:
        Right and forward ``(B, N, 2)`` int32.
    """
    xyz = np.stack([features.x, features.y, features.z], axis=-1).astype(np.int64)
    axes = ground_axes(plane).astype(np.int64)
    along = np.einsum("bnk,bak->bna", xyz, axes)  # noqa: TID251, of integers
    return ((along + (1 << (GROUND_BITS - 1))) >> GROUND_BITS).astype(np.int32)


def _outline(
    points: np.ndarray, trim: int, bands: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return A, B and C of an obstacle's points ``(n, 2)``."""
    right, forward = points.T
    side, near = bands[np.clip(forward.min(), 0, len(bands) - 1)]
    a_right, b_right = _outermost(right, trim, side), -_outermost(-right, trim, side)
    c_forward = _outermost(forward, trim, near)
    a = a_right, forward[right == a_right].min()
    b = b_right, forward[right == b_right].min()
    c = right[forward == c_forward].min(), c_forward
    return np.array(a), np.array(b), np.array(c)


def _outermost(values: np.ndarray, trim: int, band: int) -> int:
    """Return the lower median of the values at most ``band`` above the smallest.

    The ``trim`` smallest values are removed first, at most a ``TRIM_SHARE``-th of all.

    Example:
        >>> _outermost(np.array([9, 2, 0, 3, 7]), trim=0, band=3)
        2
    """
    values = np.sort(values)[min(trim, len(values) // TRIM_SHARE) :]
    inside = values[values <= values[0] + band]
    return int(inside[(len(inside) - 1) // 2])
