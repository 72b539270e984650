"""Measures of obstacles: boxes, sums and outermost points (Section 3.5)."""

import numpy as np

from jaxdet.config import TRIM_SHARE, FootprintConfig
from jaxdet.floor.plane import band_table
from jaxdet.types import Features, Labels, Obstacles


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
        features: Points ``(B, N)``.
        labels: Obstacle of each point.
        floor: Right and forward of each point, ``(B, N, 2)`` integer, at most MAX_LATERAL [depth
            units].
        depth_unit: Metres in one depth unit.
        config: Trim, bands and threshold of the vertex.
        slots: ``M``, the maximum number of obstacles.

    Returns:
        Obstacles ``(B, M)`` in the order of their labels; direction and span are zero, nearest is
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
