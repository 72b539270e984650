"""RSC (our reading): hierarchical clustering by reciprocal nearest neighbours.

Xie, Lee, Wang, Chen and Zhou, Hierarchical clustering supported by reciprocal nearest neighbors,
Information Sciences 527 (2020), 279-292. Only the abstract was available, and there is no known
public code; choices that the abstract leaves open are marked "ours". In tables, the method is named
"RSC (our reading)".

On each level, ``nn(i)`` is the point nearest to point i (of equally near ones, the one of lowest
index; ours). Each component of the graph of links ``{i, nn(i)}`` contains exactly one reciprocal
pair ``(a, b)`` with ``nn(a) = b`` and ``nn(b) = a``, and its links are part of the minimum spanning
tree. Each component is replaced by its root, computed from the pair or from all members (three
variants; ours). The roots are the points of the next level, until one is left.
"""

from typing import Literal, NamedTuple

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

Root = Literal["midpoint", "member", "mean"]
"""Root of a component: the midpoint of its reciprocal pair, the pair's point of lower index, or the
mean of all its original points (as in FINCH).
"""


class Level(NamedTuple):
    """Links of one level with ``m`` points."""

    nearest: np.ndarray
    """Index of the point nearest to each, ``(m,)`` int64."""
    length: np.ndarray
    """Distance to the nearest point, ``(m,)`` float64."""
    parent: np.ndarray
    """Index of the next level's point to which each belongs, ``(m,)`` int64."""


def rsc_threshold(points: np.ndarray, tau: float, root: Root = "midpoint") -> np.ndarray:
    """Cluster points by the links that are at most ``tau`` long, on all levels.

    A point without a link is its own root. Links never get longer from a point towards the pair, so
    a removed link always leaves a single point. The last level is the one without links.

    Args:
        points: Points ``(n, d)``.
        tau: Maximum length of a link, in the unit of the points.
        root: Kind of root of a component.

    Returns:
        Labels ``(n,)`` int64.
    """
    labels = np.arange(len(points))
    for level in _levels(points, tau, root):
        labels = level.parent[labels]
    return labels


def rsc_count(points: np.ndarray, clusters: int, root: Root = "midpoint") -> np.ndarray:
    """Cluster points into a given number of clusters, from the top root down.

    The coarsest level with more than ``clusters`` points is chosen. The longest of its links are
    removed until it has ``clusters`` components; of equally long ones, those of higher index.

    Args:
        points: Points ``(n, d)``.
        clusters: Number of clusters, at least 1; if there are fewer points, each is a cluster.
        root: Kind of root of a component.

    Returns:
        Labels ``(n,)`` int64.
    """
    labels = np.arange(len(points))
    for level in _levels(points, np.inf, root):
        if level.parent.max() + 1 > clusters:
            labels = level.parent[labels]
            continue
        size = len(level.nearest)
        once = (level.nearest[level.nearest] != np.arange(size)) | (np.arange(size) < level.nearest)
        links = np.flatnonzero(once)
        links = links[np.argsort(level.length[links], kind="stable")]
        return _components(size, links[: max(0, size - clusters)], level.nearest)[labels]
    return labels


def _levels(points: np.ndarray, tau: float, root: Root) -> list[Level]:
    points = np.asarray(points, np.float64)
    weight = np.ones(len(points))
    levels: list[Level] = []
    while len(points) > 1:
        nearest, length = nearest_neighbours(points)
        linked = np.flatnonzero(length <= tau)
        if not len(linked):
            break
        parent = _components(len(points), linked, nearest)
        levels.append(Level(nearest, length, parent))
        points, weight = _roots(points, weight, levels[-1], tau, root)
    return levels


def _components(size: int, links: np.ndarray, nearest: np.ndarray) -> np.ndarray:
    graph = csr_matrix((np.ones(len(links)), (links, nearest[links])), (size, size))
    return connected_components(graph, directed=False)[1].astype(np.int64)


def _roots(
    points: np.ndarray, weight: np.ndarray, level: Level, tau: float, root: Root
) -> tuple[np.ndarray, np.ndarray]:
    """Return the next level's points, and how many original points belong to each."""
    count = int(level.parent.max()) + 1
    below = np.bincount(level.parent, weight, count)
    if root == "mean":
        sums = np.stack([np.bincount(level.parent, weight * a, count) for a in points.T], axis=1)
        return sums / below[:, None], below
    out = np.zeros((count, points.shape[1]))
    out[level.parent] = points
    index = np.arange(len(points))
    pair = (level.nearest[level.nearest] == index) & (index < level.nearest)
    a = np.flatnonzero(pair & (level.length <= tau))
    b = level.nearest[a]
    out[level.parent[a]] = points[a] if root == "member" else (points[a] + points[b]) / 2
    return out, below


def nearest_neighbours(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the point nearest to each; of equally near ones, the one of lowest index.

    Args:
        points: Points ``(n, d)`` float64, n >= 2.

    Returns:
        Indices ``(n,)`` int64 and distances ``(n,)`` float64.
    """
    size = len(points)
    width = min(size, 8)
    distance, index = KDTree(points).query(points, k=width)
    other = index != np.arange(size)[:, None]
    length = np.where(other, distance, np.inf).min(axis=1)
    tied = other & (distance == length[:, None])
    nearest = np.where(tied, index, size).min(axis=1).astype(np.int64)
    # If the farthest point that the tree returned is equally near, there may be more.
    more = np.flatnonzero((distance[:, -1] == length) & (width < size))
    for start in range(0, len(more), 256):
        rows = more[start : start + 256]
        exact = np.sqrt(np.sum((points[rows, None] - points) ** 2, axis=-1))
        exact[np.arange(len(rows)), rows] = np.inf
        nearest[rows] = np.argmin(exact, axis=1)
    return nearest, length
