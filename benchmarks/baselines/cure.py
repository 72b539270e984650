"""CURE: hierarchical clustering by a few scattered points of each cluster, moved to its mean.

Guha, Rastogi and Shim, CURE: an efficient clustering algorithm for large databases, SIGMOD 1998,
73-84. A random sample is clustered, then every point gets the cluster of the nearest
representative (their Sections 3 and 4). Unlike in the paper, merging ends at a distance instead of
a number of clusters, as in the other hierarchical baselines, and outliers are the clusters below
the minimum size of all methods.
"""

from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from benchmarks.baselines.sampling import sample

SAMPLE = 256
"""Number of points that are clustered; merging n points takes at least O(n^2)."""


class Merged(NamedTuple):
    """Clusters of a sample."""

    labels: np.ndarray
    """Cluster of each point, ``(m,)`` int64."""
    representatives: np.ndarray
    """Points ``(clusters, c, d)``; in a cluster with fewer than c, the first one is repeated."""


def cure(
    points: np.ndarray,
    distance_m: float,
    representatives: int = 5,
    shrink: float = 0.5,
    limit: int = SAMPLE,
) -> np.ndarray:
    """Cluster points by CURE.

    Args:
        points: Points ``(n, d)`` [m].
        distance_m: Clusters are merged while the representatives of the nearest two are at most
            this far apart.
        representatives: Number of representatives of a cluster, the paper's c.
        shrink: The paper's alpha: 0 leaves representatives where they are, 1 moves them all to the
            mean.
        limit: Maximum number of points in the sample.

    Returns:
        Labels ``(n,)`` int64.
    """
    points = np.asarray(points, np.float64)
    chosen = sample(len(points), limit)
    merged = merge(points[chosen], distance_m, representatives, shrink)
    if len(chosen) == len(points):
        return merged.labels
    clusters, width, dims = merged.representatives.shape
    tree = KDTree(merged.representatives.reshape(clusters * width, dims))
    labels = tree.query(points)[1] // width
    labels[chosen] = merged.labels
    return labels


def merge(
    points: np.ndarray,
    distance: float,
    representatives: int,
    shrink: float,
    clusters: int = 1,
) -> Merged:
    """Merge the nearest two clusters until they are too far apart, or there are few enough.

    Args:
        points: Points ``(m, d)`` float64.
        distance: Clusters farther apart than this are not
            merged.
        representatives: Maximum number of representatives of a cluster.
        shrink: Fraction by which representatives are moved to the cluster's mean, 0 to 1.
        clusters: Minimum number of clusters.
    """
    size = len(points)
    members = [[i] for i in range(size)]
    scattered = np.repeat(points[:, None], representatives, axis=1)
    apart = cdist(points, points)
    np.fill_diagonal(apart, np.inf)
    for _ in range(size - clusters):
        first, second = sorted(divmod(int(np.argmin(apart)), size))
        if not apart[first, second] <= distance:
            break
        members[first] += members[second]
        members[second] = []
        scattered[first] = scatter(points[members[first]], representatives, shrink)
        apart[second], apart[:, second] = np.inf, np.inf
        alive = np.flatnonzero(np.isfinite(apart[first]))
        reach = cdist(scattered[alive].reshape(-1, points.shape[1]), scattered[first])
        apart[first, alive] = reach.reshape(len(alive), representatives**2).min(axis=1)
        apart[alive, first] = apart[first, alive]
    kept = [i for i, own in enumerate(members) if own]
    labels = np.zeros(size, np.int64)
    for number, i in enumerate(kept):
        labels[members[i]] = number
    return Merged(labels, scattered[kept])


def scatter(points: np.ndarray, representatives: int, shrink: float) -> np.ndarray:
    """Choose points of a cluster that are far from each other, and move them to its mean.

    The first is the farthest from the mean, each next one the farthest from those chosen before; of
    equally far points, the first counts.

    Args:
        points: Points of the cluster, ``(m, d)`` float64.
        representatives: Number of points to choose.
        shrink: Fraction of the way to the mean, 0 to 1.

    Returns:
        Points ``(representatives, d)``; if the cluster has fewer, the first is repeated.
    """
    mean = points.mean(axis=0)
    square = np.sum((points - mean) ** 2, axis=1)
    chosen = [int(np.argmax(square))]
    square = np.full(len(points), np.inf)
    for _ in range(min(representatives, len(points)) - 1):
        square = np.minimum(square, np.sum((points - points[chosen[-1]]) ** 2, axis=1))
        chosen.append(int(np.argmax(square)))
    chosen += [chosen[0]] * (representatives - len(chosen))
    return points[chosen] + shrink * (mean - points[chosen])
