"""RSC (our reading): hierarchical clustering by reciprocal nearest neighbours.

Xie, Lee, Wang, Chen and Zhou, Hierarchical clustering supported by reciprocal nearest neighbors,
Information Sciences 527 (2020), 279-292. We had its abstract, not its text, and know of no public
code; what is marked "ours" below is a choice of ours. In any table this is "RSC (our reading)".

One level, on points P: ``nn(i)`` is the nearest other point (of equals the lowest index, ours).
Each component of the graph ``{i, nn(i)}`` holds exactly one reciprocal pair ``(a, b)``, ``nn(a) =
b`` and ``nn(b) = a``, and its links are a part of the minimum spanning tree. The component is
replaced by its root, from the pair or from all members (ours, three variants), and the roots are
the points of the next level, until one is left.
"""

from typing import Literal, NamedTuple

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

Root = Literal["midpoint", "member", "mean"]
"""Variant A: the pair's midpoint; B: the pair's point of lower index; C: the mean of all original
points below (as FINCH has it)."""


class Level(NamedTuple):
    """The links of one level with ``m`` points."""

    nearest: np.ndarray
    """``(m,)`` int64."""
    length: np.ndarray
    """``(m,)`` float64."""
    parent: np.ndarray
    """``(m,)`` int64, the point of the next level that each belongs to."""


def rsc_threshold(points: np.ndarray, tau: float, root: Root = "midpoint") -> np.ndarray:
    """Flat clusters: links longer than ``tau`` are left out at every level.

    A point without a link stays a root of its own. Since the links from a point towards the pair
    never grow longer, what a cut link leaves behind is always a single point. It ends when no
    link is short enough.

    Args:
        points: ``(n, d)``.
        tau: In the units of the points.
        root: Which variant.

    Returns:
        ``(n,)`` int64.
    """
    labels = np.arange(len(points))
    for level in _levels(points, tau, root):
        labels = level.parent[labels]
    return labels


def rsc_count(points: np.ndarray, clusters: int, root: Root = "midpoint") -> np.ndarray:
    """Flat clusters, as many as asked for: down from the top root.

    From the coarsest level down to the first one with more than ``clusters`` points; of the links
    from there to the level above, the longest are left out until there are ``clusters``
    components (of equals, those of higher index).

    Args:
        points: ``(n, d)``.
        clusters: At least 1; with fewer points each is a cluster.
        root: Which variant.

    Returns:
        ``(n,)`` int64.
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
    """The next level's points, and how many original points lie below each."""
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
    """Each point's nearest other point, of equals the lowest index.

    Args:
        points: ``(n, d)`` float64, n >= 2.

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
    # Where the farthest that the tree returned ties too, there may be more of them.
    more = np.flatnonzero((distance[:, -1] == length) & (width < size))
    for start in range(0, len(more), 256):
        rows = more[start : start + 256]
        exact = np.sqrt(np.sum((points[rows, None] - points) ** 2, axis=-1))
        exact[np.arange(len(rows)), rows] = np.inf
        nearest[rows] = np.argmin(exact, axis=1)
    return nearest, length
