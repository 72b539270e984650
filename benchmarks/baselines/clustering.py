"""Clustering of a frame's features by scikit-learn, SciPy and the paper's rule."""

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
    """Cluster by scikit-learn's agglomerative method, up to ``distance_m`` (for ward, the cost)."""
    model = AgglomerativeClustering(
        n_clusters=None,  # pyright: ignore[reportArgumentType] (scikit-learn documents None)
        linkage=linkage,
        distance_threshold=distance_m,
    )
    return model.fit_predict(points)


def hierarchical_count(points: np.ndarray, clusters: int) -> np.ndarray:
    """Cluster into a number of clusters by scikit-learn's ward linkage."""
    if len(points) < clusters:
        return np.full(len(points), -1)
    return AgglomerativeClustering(clusters).fit_predict(points)


def single_linkage(points: np.ndarray, distance_m: float) -> np.ndarray:
    """Cluster by SciPy's single linkage, cut at ``distance_m``."""
    return fcluster(scipy_linkage(points, "single"), distance_m, "distance") - 1


def dbscan(points: np.ndarray, eps_m: float, min_samples: int) -> np.ndarray:
    """Cluster by scikit-learn's DBSCAN."""
    return DBSCAN(eps=eps_m, min_samples=min_samples).fit_predict(points)


def hdbscan(points: np.ndarray, min_points: int, min_samples: int, single: bool) -> np.ndarray:
    """Cluster by scikit-learn's HDBSCAN, with the minimum size of clusters of all methods.

    Its ``cluster_selection_epsilon`` is left at 0: in scikit-learn 1.9.1 it raises a TypeError
    with NumPy 2.4 as soon as it has something to merge.

    Args:
        points: Points ``(n, d)`` [m].
        min_points: Clusters have more points than this.
        min_samples: Number of neighbours of a core point.
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
    """Cluster by scikit-learn's BIRCH without its global step: the subclusters of its tree."""
    model = Birch(
        threshold=threshold_m,
        branching_factor=branching,
        n_clusters=None,  # pyright: ignore[reportArgumentType] (scikit-learn documents None)
    )
    return model.fit_predict(points)


def chameleon(
    points: np.ndarray, clusters: int, neighbours: int = 10, limit: int = 256
) -> np.ndarray:
    """Cluster by chameleon-cluster's CHAMELEON: METIS cuts a graph of neighbours, parts are merged.

    A part of the graph without connection to others stays a cluster, even if there are more than
    ``clusters`` of them.

    Args:
        points: Points ``(n, d)`` [m].
        clusters: Number of clusters at which merging ends.
        neighbours: Number of neighbours of each point in the graph.
        limit: Maximum number of points that are clustered, a random sample; any other point gets
            the label of the nearest point of the sample.

    Returns:
        Labels ``(n,)`` int64.

    Raises:
        ImportError: chameleon-cluster is not installed.
    """
    package: Any = import_module("pychameleon")
    model = package.Chameleon(n_clusters=clusters, k_nn=max(2, neighbours))
    return cluster_sample(points, limit, model.fit_predict)


def printed(points: np.ndarray, depth_gap_m: float, lateral_gap_m: float) -> np.ndarray:
    """Cluster by the paper's Algorithm 1 as printed, along z and then along x.

    The algorithm compares a point with the first point of a set only (line 8), although Step 3
    compares it with any point of the set. So a set is shorter than the gap.

    Args:
        points: Points ``(n, 2)``, x and z [m].
        depth_gap_m: Gap along z, the paper's d_z [m].
        lateral_gap_m: Gap along x, the paper's d_x [m].

    Returns:
        Labels ``(n,)`` int64; every point belongs to a set.

    Example:
        >>> printed(np.array([[0, 1.0], [0, 1.09], [0, 1.18]]), 0.1, 0.4).tolist()
        [0, 0, 1]
    """
    x, z = points.T
    column = _from_seeds(z, np.zeros(len(z), np.int64), depth_gap_m)
    return _from_seeds(x, column, lateral_gap_m)


def _from_seeds(values: np.ndarray, group: np.ndarray, gap: float) -> np.ndarray:
    """Split each group into parts, each from its smallest value to less than ``gap`` above it."""
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
    """Cluster by the paper's rule, with the reference's cluster stage.

    Args:
        frame: The frame.
        config: Configuration; its cluster part has the values of parameters that are not given.
        **params: Fields of :class:`jaxdet.config.ClusterConfig`.

    Returns:
        Labels ``(n,)`` int32 of the features above the floor.
    """
    chosen = replace(config, cluster=replace(config.cluster, **params))
    unit = frame.calibration.depth_unit
    found = reference.paper.cluster(frame.features, unit, chosen)
    return found.labels[frame.features.kept]
