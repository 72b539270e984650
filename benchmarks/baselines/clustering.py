"""Clustering by scikit-learn and SciPy, and by the paper's rule, on a frame's kept features."""

from dataclasses import replace
from importlib import import_module
from typing import Any, Literal

import numpy as np
from scipy.cluster.hierarchy import fcluster
from scipy.cluster.hierarchy import linkage as scipy_linkage
from sklearn.cluster import DBSCAN, HDBSCAN, AgglomerativeClustering, Birch

from benchmarks.baselines.frames import Frame
from benchmarks.baselines.sampling import cluster_sample
from jaxdet import reference
from jaxdet.config import Config


def hierarchical(
    points: np.ndarray,
    distance_m: float,
    linkage: Literal["ward", "complete", "average", "single"] = "ward",
) -> np.ndarray:
    """scikit-learn's agglomerative clustering: merges up to ``distance_m`` (for ward, its cost)."""
    model = AgglomerativeClustering(
        n_clusters=None,  # pyright: ignore[reportArgumentType] (scikit-learn documents None)
        linkage=linkage,
        distance_threshold=distance_m,
    )
    return model.fit_predict(points)


def hierarchical_count(points: np.ndarray, clusters: int) -> np.ndarray:
    """scikit-learn's agglomerative clustering into a number of clusters, by ward's linkage."""
    if len(points) < clusters:
        return np.full(len(points), -1)
    return AgglomerativeClustering(clusters).fit_predict(points)


def single_linkage(points: np.ndarray, distance_m: float) -> np.ndarray:
    """SciPy's single linkage, cut at ``distance_m``."""
    return fcluster(scipy_linkage(points, "single"), distance_m, "distance") - 1


def dbscan(points: np.ndarray, eps_m: float, min_samples: int) -> np.ndarray:
    """scikit-learn's DBSCAN."""
    return DBSCAN(eps=eps_m, min_samples=min_samples).fit_predict(points)


def hdbscan(points: np.ndarray, min_points: int, min_samples: int, single: bool) -> np.ndarray:
    """scikit-learn's HDBSCAN; its own size rule is the shared one.

    Its ``cluster_selection_epsilon`` is left at 0: in scikit-learn 1.9.1 it raises a TypeError
    with NumPy 2.4 as soon as it has something to merge.

    Args:
        points: ``(n, d)`` [m].
        min_points: Clusters have more points than this.
        min_samples: Neighbours that make a point dense.
        single: Whether all points may be one cluster.
    """
    if len(points) <= max(min_points, min_samples, 1):
        return np.full(len(points), -1)
    model = HDBSCAN(
        min_cluster_size=max(2, min_points + 1),
        min_samples=min_samples,
        allow_single_cluster=single,
        copy=True,  # pyright: ignore[reportArgumentType] (scikit-learn documents a bool)
    )
    return model.fit_predict(points)


def birch(points: np.ndarray, threshold_m: float, branching: int = 50) -> np.ndarray:
    """scikit-learn's BIRCH without a global step: the subclusters of its tree."""
    model = Birch(
        threshold=threshold_m,
        branching_factor=branching,
        n_clusters=None,  # pyright: ignore[reportArgumentType] (scikit-learn documents None)
    )
    return model.fit_predict(points)


def chameleon(
    points: np.ndarray, clusters: int, neighbours: int = 10, limit: int = 256
) -> np.ndarray:
    """chameleon-cluster's CHAMELEON: METIS cuts a graph of neighbours, what fits is merged.

    A part of the graph that is not connected with others stays a cluster, also beyond
    ``clusters``.

    Args:
        points: ``(n, d)`` [m].
        clusters: Merging ends with so many.
        neighbours: Of each point in the graph.
        limit: A random sample of so many points is clustered, all others get the label of its
            nearest.

    Returns:
        ``(n,)`` int64.

    Raises:
        ImportError: chameleon-cluster is not installed.
    """
    package: Any = import_module("pychameleon")
    model = package.Chameleon(n_clusters=clusters, k_nn=max(2, neighbours))
    return cluster_sample(points, limit, model.fit_predict)


def printed(points: np.ndarray, depth_gap_m: float, lateral_gap_m: float) -> np.ndarray:
    """The paper's Algorithm 1 as printed, along z and then along x.

    It compares with the first point of a set and stops there (line 8), where Step 3 compares with
    any point of the set: so a set reaches from its first point to less than the gap beyond it.

    Args:
        points: ``(n, 2)``, x and z [m].
        depth_gap_m: d along z.
        lateral_gap_m: d along x.

    Returns:
        ``(n,)`` int64, every point in a set.

    Example:
        >>> printed(np.array([[0, 1.0], [0, 1.09], [0, 1.18]]), 0.1, 0.4).tolist()
        [0, 0, 1]
    """
    x, z = points.T
    column = _from_seeds(z, np.zeros(len(z), np.int64), depth_gap_m)
    return _from_seeds(x, column, lateral_gap_m)


def _from_seeds(values: np.ndarray, group: np.ndarray, gap: float) -> np.ndarray:
    """Parts of each group: from its least value to less than ``gap`` beyond, then the next."""
    order = np.lexsort((values, group))
    parts, number, start = np.zeros(len(values), np.int64), 0, 0
    ends = np.flatnonzero(np.diff(group[order], append=-1)) + 1
    for end in ends:
        while start < end:
            ahead = values[order[start:end]]
            stop = start + max(1, int(np.searchsorted(ahead, ahead[0] + gap)))
            parts[order[start:stop]] = number
            number, start = number + 1, stop
    return parts


def paper(frame: Frame, config: Config, **params: Any) -> np.ndarray:
    """The paper's rule: the reference's cluster stage.

    Args:
        frame: The frame.
        config: Its cluster part holds what the parameters leave open.
        **params: Fields of :class:`jaxdet.config.ClusterConfig`.

    Returns:
        ``(n,)`` int32, of the kept features.
    """
    chosen = replace(config, cluster=replace(config.cluster, **params))
    unit = frame.calibration.depth_unit
    found = reference.paper.cluster(frame.features, unit, chosen)
    return found.labels[frame.features.kept]
