"""Internal cluster validity indices, which need no ground truth.

Points without a label (-1) are ignored. Dropped points therefore affect only the scores against
ground truth.
"""

import numpy as np


def silhouette(points: np.ndarray, labels: np.ndarray) -> float:
    """Compute the silhouette coefficient, the paper's SC.

    For point i, ``a`` is the mean distance to the other points of its cluster, ``b`` the smallest
    mean distance to another cluster, and ``s(i) = (b - a) / max(a, b)``, or 0 if the cluster has
    only one point; SC is the mean of ``s``. Rousseeuw, Journal of Computational and Applied
    Mathematics 20 (1987), 53-65. Equals ``sklearn.metrics.silhouette_score`` on the labelled
    points.

    Args:
        points: Points ``(n, d)``.
        labels: Labels ``(n,)`` integer, negative = noise, excluded.

    Returns:
        -1 to 1, larger is better; NaN with fewer than two clusters.

    Example:
        >>> points = np.array([[0.0], [1.0], [9.0], [10.0], [99.0]])
        >>> round(silhouette(points, np.array([0, 0, 1, 1, -1])), 4)
        0.8885
    """
    points, which, count = _labelled(points, labels)
    if count < 2:
        return float("nan")
    squares = np.sum(points * points, axis=1)
    gram = squares[:, None] + squares - 2 * points @ points.T
    np.fill_diagonal(gram, 0.0)
    distance = np.sqrt(np.maximum(gram, 0.0))
    member = np.eye(count)[which]
    sums, sizes = distance @ member, member.sum(axis=0)
    own = np.arange(len(which)), which
    a = sums[own] / np.maximum(sizes[which] - 1, 1)
    means = sums / sizes
    means[own] = np.inf
    b = means.min(axis=1)
    larger = np.maximum(a, b)
    s = np.divide(b - a, larger, out=np.zeros_like(a), where=larger > 0)
    return float(np.mean(np.where(sizes[which] > 1, s, 0.0)))


def davies_bouldin(points: np.ndarray, labels: np.ndarray) -> float:
    """Compute the Davies-Bouldin index, the paper's DB.

    The index is the mean over clusters i of ``max_j (S_i + S_j) / |c_i - c_j|``, where ``c_i`` is
    the mean of the points of cluster i, and ``S_i`` their mean distance from it. Davies and
    Bouldin, IEEE Transactions on Pattern Analysis and Machine Intelligence 1 (1979), 224-227.
    Equals ``sklearn.metrics.davies_bouldin_score`` on the labelled points.

    Args:
        points: Points ``(n, d)``.
        labels: Labels ``(n,)`` integer, negative = noise, excluded.

    Returns:
        At least 0; smaller is better. Unlike the paper states, values above 1 are possible. The
        index is infinite if two clusters of non-zero extent have the same mean, and NaN with fewer
        than two clusters.

    Example:
        >>> davies_bouldin(np.array([[0.0], [2.0], [8.0], [16.0]]), np.array([0, 0, 1, 1])) * 11
        5.0
    """
    points, which, count = _labelled(points, labels)
    if count < 2:
        return float("nan")
    member = np.eye(count)[which]
    means = member.T @ points / member.sum(axis=0)[:, None]
    spread = np.linalg.norm(points - means[which], axis=1) @ member / member.sum(axis=0)
    apart = np.linalg.norm(means[:, None] - means, axis=-1)
    together = spread[:, None] + spread
    ratio = np.divide(together, apart, out=np.where(together > 0, np.inf, 0.0), where=apart > 0)
    np.fill_diagonal(ratio, -np.inf)
    return float(np.mean(ratio.max(axis=1)))


def _labelled(points: np.ndarray, labels: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """Return labelled points ``(m, d)``, their clusters ``(m,)`` from 0, and the cluster count."""
    labels = np.asarray(labels)
    used = labels >= 0
    names, which = np.unique(labels[used], return_inverse=True)
    chosen = np.asarray(points, np.float64)[used]
    return chosen - chosen.mean(axis=0) if len(chosen) else chosen, which, len(names)
