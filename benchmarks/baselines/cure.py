"""CURE: hierarchical clustering by a few scattered, shrunk points of each cluster.

Guha, Rastogi and Shim, CURE: an efficient clustering algorithm for large databases, SIGMOD 1998,
73-84. A random sample is clustered, then every point gets the cluster of the nearest
representative (their Sections 3 and 4). Ours: merging ends at a distance instead of a number of
clusters, as of the other hierarchical baselines, and outliers are what the shared size rule drops.
"""

from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from benchmarks.baselines.sampling import sample

SAMPLE = 256
"""Points that are clustered; merging all n takes O(n^2) and more."""


class Merged(NamedTuple):
    """Clusters of a sample."""

    labels: np.ndarray
    """``(m,)`` int64."""
    representatives: np.ndarray
    """``(clusters, c, d)``; where a cluster has fewer than c, its first is repeated."""


def cure(
    points: np.ndarray,
    distance_m: float,
    representatives: int = 5,
    shrink: float = 0.5,
    limit: int = SAMPLE,
) -> np.ndarray:
    """Flat clusters of all points.

    Args:
        points: ``(n, d)`` [m].
        distance_m: Clusters are merged while the nearest two are at most this far apart, by
            their representatives.
        representatives: The paper's c.
        shrink: The paper's alpha: 0 leaves representatives where they are, 1 puts them all into
            the mean.
        limit: Points in the sample.

    Returns:
        ``(n,)`` int64.
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
    """Merges the nearest two clusters until they are too far apart, or few enough.

    Args:
        points: ``(m, d)`` float64.
        distance: Nearest clusters farther apart than this are left as they are.
        representatives: Of a cluster, at most.
        shrink: How far they are moved to the cluster's mean, 0 to 1.
        clusters: It ends with so many, at the latest.
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
    """Points far from each other, moved towards the mean.

    The first is the farthest from the mean, each next the farthest from those chosen (of equals
    the first).

    Args:
        points: ``(m, d)`` float64, a cluster's.
        representatives: How many.
        shrink: 0 to 1.

    Returns:
        ``(representatives, d)``; with fewer different points the first is repeated.
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
