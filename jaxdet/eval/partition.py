"""Agreement of two partitions of points, by pair counts that can be added up over frames."""

import math
from typing import NamedTuple

import numpy as np


class PairCounts(NamedTuple):
    """Numbers of pairs of points that share a cluster."""

    both: int
    """Pairs that share a cluster in the detection and in the ground truth."""
    detected: int
    """Pairs that share a cluster in the detection."""
    true: int
    """Pairs that share a cluster in the ground truth."""


def pair_counts(labels: np.ndarray, truth: np.ndarray) -> PairCounts:
    """Count the pairs of points that share a cluster.

    In both partitions, each point without a label (negative) is a separate cluster.

    Args:
        labels: Detected clusters ``(n,)`` integer.
        truth: True clusters ``(n,)`` integer.

    Returns:
        Sums of ``k (k - 1) / 2`` over the clusters of each partition and of their intersection.

    Example:
        >>> pair_counts(np.array([0, 0, 1, -1, -1]), np.array([5, 5, 5, 6, 6]))
        PairCounts(both=1, detected=1, true=4)
    """
    labels, truth = np.asarray(labels, np.int64), np.asarray(truth, np.int64)
    both = (labels >= 0) & (truth >= 0)
    if not both.any():
        return PairCounts(0, _pairs(labels), _pairs(truth))
    cells = labels[both] * (int(truth.max()) + 1) + truth[both]
    _, cells = np.unique(cells, return_inverse=True)
    return PairCounts(_pairs(cells), _pairs(labels), _pairs(truth))


def _pairs(labels: np.ndarray) -> int:
    sizes = np.bincount(labels[labels >= 0])
    return int((sizes * (sizes - 1) // 2).sum())


def fowlkes_mallows(counts: PairCounts) -> float:
    """Compute the Fowlkes-Mallows index ``both / sqrt(detected true)``.

    The index is the geometric mean of the pairs' precision and recall; 1 is full agreement. Fowlkes
    and Mallows, Journal of the American Statistical Association 78 (1983), 553-569. Equals
    ``sklearn.metrics.fowlkes_mallows_score`` if each noise point has a label of its own.

    Args:
        counts: Counts of one or several frames.

    Returns:
        0 to 1; 0 if only one of the partitions has pairs; NaN if neither has.

    Example:
        >>> fowlkes_mallows(PairCounts(2, 4, 4))
        0.5
    """
    if not counts.detected and not counts.true:
        return math.nan
    if not counts.detected or not counts.true:
        return 0.0
    return counts.both / math.sqrt(counts.detected * counts.true)
