"""A random sample of the points, for methods whose time or memory grows with their square."""

from collections.abc import Callable

import numpy as np
from scipy.spatial import KDTree


def sample(count: int, limit: int) -> np.ndarray:
    """Indices of at most ``limit`` of ``count`` points, always the same ones, in order."""
    if count <= limit:
        return np.arange(count)
    return np.sort(np.random.default_rng(0).choice(count, limit, replace=False))


def cluster_sample(
    points: np.ndarray, limit: int, cluster: Callable[[np.ndarray], np.ndarray]
) -> np.ndarray:
    """Clusters a sample; every other point gets the label of the sample's nearest.

    Args:
        points: ``(n, d)``.
        limit: Most points in the sample.
        cluster: Of points ``(m, d)``, m <= ``limit``, gives labels ``(m,)``.

    Returns:
        ``(n,)`` labels.
    """
    chosen = sample(len(points), limit)
    labels = np.asarray(cluster(points[chosen]))
    if len(chosen) == len(points):
        return labels
    return labels[KDTree(points[chosen]).query(points)[1]]
