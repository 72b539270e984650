"""ROCK: hierarchical clustering by links, the neighbours that points have in common.

Guha, Rastogi and Shim, ROCK: a robust clustering algorithm for categorical attributes,
Information Systems 25 (2000), 345-366. Of points in space, ours: neighbours are the points within
a radius, each its own too; theta is left in the exponent only, as pyclustering has it.
"""

import numpy as np
from scipy.spatial.distance import cdist

from benchmarks.baselines.sampling import sample

SAMPLE = 256
"""Points that are clustered; links between all n take O(n^2) and more."""


def rock(
    points: np.ndarray, radius_m: float, clusters: int, theta: float = 0.5, limit: int = SAMPLE
) -> np.ndarray:
    """Flat clusters: of a random sample by links, of all others by their neighbours in it.

    A point goes to the cluster with the largest ``neighbours / (size + 1)^f``, where ``f = (1 -
    theta) / (1 + theta)``; without a neighbour it is noise.

    Args:
        points: ``(n, d)`` [m].
        radius_m: Points this near to each other are neighbours.
        clusters: Merging ends with so many, or where no links are left.
        theta: 0 to below 1; the smaller it is, the less large clusters attract.
        limit: Points in the sample.

    Returns:
        ``(n,)`` int64, -1 = noise.
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
    """Merges the two clusters of the largest goodness, while any have links between them.

    Goodness is the number of links over the number to be expected: ``links / ((m + k)^e - m^e -
    k^e)`` for clusters of m and k points, ``e = 1 + 2 (1 - theta) / (1 + theta)``.

    Args:
        near: ``(m, m)`` bool, symmetric: which points are neighbours.
        clusters: It ends with so many.
        theta: 0 to below 1.

    Returns:
        ``(m,)`` int64.
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
