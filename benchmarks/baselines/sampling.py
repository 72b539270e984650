"""Random sample of points, for methods whose time or memory grows with n^2."""

from collections.abc import Callable

import numpy as np
from scipy.spatial import KDTree


def sample(count: int, limit: int) -> np.ndarray:
    """Return indices of at most ``limit`` of ``count`` points, always the same ones, ascending."""
    if count <= limit:
        return np.arange(count)
    return np.sort(np.random.default_rng(0).choice(count, limit, replace=False))


def cluster_sample(
    points: np.ndarray, limit: int, cluster: Callable[[np.ndarray], np.ndarray]
) -> np.ndarray:
    """Cluster a sample; any other point gets the label of the sample's nearest point.

    Args:
        points: Points ``(n, d)``.
        limit: Maximum number of points in the sample.
        cluster: Function that returns labels ``(m,)`` of points ``(m, d)``, m <= ``limit``.

    Returns:
        Labels ``(n,)``.
    """
    chosen = sample(len(points), limit)
    labels = np.asarray(cluster(points[chosen]))
    if len(chosen) == len(points):
        return labels
    return labels[KDTree(points[chosen]).query(points)[1]]
