"""ROCK: hierarchical clustering by links, the number of neighbours that two points share.

Guha, Rastogi and Shim, ROCK: a robust clustering algorithm for categorical attributes,
Information Systems 25 (2000), 345-366. Here it clusters points in space: the neighbours of a point
are the points within a radius, including itself; theta is only used in the exponent, as in
pyclustering.
"""

import numpy as np
from scipy.spatial.distance import cdist

from benchmarks.baselines.sampling import sample

SAMPLE = 256
"""Number of points that are clustered; the links between n points take at least O(n^2)."""


def rock(
    points: np.ndarray, radius_m: float, clusters: int, theta: float = 0.5, limit: int = SAMPLE
) -> np.ndarray:
    """Cluster a random sample by links, and all other points by their neighbours in it.

    A point outside the sample belongs to the cluster with the largest ``neighbours / (size +
    1)^f``, ``f = (1 - theta) / (1 + theta)``; if it has no neighbours, it is noise.

    Args:
        points: Points ``(n, d)`` [m].
        radius_m: Maximum distance of neighbours [m].
        clusters: Number of clusters at which merging ends; it ends earlier if no links are left.
        theta: The paper's theta, 0 to below 1; the smaller it is, the less are large clusters
            preferred.
        limit: Maximum number of points in the sample.

    Returns:
        Labels ``(n,)`` int64, -1 = noise.
    """
    points = np.asarray(points, np.float64)
    chosen = sample(len(points), limit)
    own = merge(cdist(points[chosen], points[chosen]) <= radius_m, clusters, theta)
    others = np.setdiff1d(np.arange(len(points)), chosen)
    near = cdist(points[others], points[chosen]) <= radius_m
    counts = near @ np.eye(own.max() + 1)[own]
    share = counts / (np.bincount(own) + 1.0) ** ((1 - theta) / (1 + theta))
    labels = np.zeros(len(points), np.int64)
    labels[chosen] = own
    labels[others] = np.where(near.any(axis=1), share.argmax(axis=1), -1)
    return labels


def merge(near: np.ndarray, clusters: int, theta: float) -> np.ndarray:
    """Merge the two clusters with the largest goodness while there are links between clusters.

    Goodness is the number of links divided by the expected number: ``links / ((m + k)^e - m^e -
    k^e)`` for clusters of m and k points, ``e = 1 + 2 (1 - theta) / (1 + theta)``.

    Args:
        near: Whether two points are neighbours, ``(m, m)`` bool, symmetric.
        clusters: Number of clusters at which merging ends.
        theta: The paper's theta, 0 to below 1.

    Returns:
        Labels ``(m,)`` int64.
    """
    count = len(near)
    power = 1 + 2 * (1 - theta) / (1 + theta)
    links = near.astype(np.float64) @ near
    np.fill_diagonal(links, 0)
    size = np.ones(count)
    goodness = links / (2**power - 2)
    labels = np.arange(count)
    for _ in range(count - clusters):
        first, second = sorted(divmod(int(np.argmax(goodness)), count))
        if goodness[first, second] <= 0:
            break
        labels[labels == second] = first
        size[first] += size[second]
        links[first] += links[second]
        links[first, [first, second]] = 0
        links[second], links[:, second], links[:, first] = 0, 0, links[first]
        expected = (size + size[first]) ** power - (size**power + size[first] ** power)
        goodness[second], goodness[:, second] = 0, 0
        goodness[first] = links[first] / expected
        goodness[:, first] = goodness[first]
    return np.unique(labels, return_inverse=True)[1].astype(np.int64)
