"""DDC: density-based clustering of an autoencoder's codes, embedded in the plane.

Ren, Wang, Li and Xu, Deep density-based image clustering, Knowledge-Based Systems 197 (2020),
105841, here of descriptors of points instead of images. Own implementation, because the public code
(ClustPy) needs PyTorch. Unlike in the paper, it is trained on a random sample of a frame's points;
any other point gets the label of the sample's nearest descriptor.
"""

from functools import partial

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial.distance import cdist
from sklearn.manifold import TSNE
from threadpoolctl import threadpool_limits

from benchmarks.baselines.autoencoder import SAMPLE, descriptors, encode
from benchmarks.baselines.frames import Frame
from benchmarks.baselines.sampling import cluster_sample
from jaxdet.config import Config


def ddc(
    frame: Frame, config: Config, ratio: float, depth_scale: float = 1.0, grey_m: float = 0.1
) -> np.ndarray:
    """Cluster a frame's features by DDC of their descriptors.

    Args:
        frame: The frame.
        config: Not used.
        ratio: See :func:`density_peaks`.
        depth_scale: See :func:`descriptors`.
        grey_m: See :func:`descriptors`.

    Returns:
        Labels ``(n,)`` integer of the features above the floor.
    """
    points = descriptors(frame, depth_scale, grey_m)
    return cluster_sample(points, SAMPLE, partial(_ddc, ratio=ratio))


def _ddc(points: np.ndarray, ratio: float) -> np.ndarray:
    if len(points) < 5:
        return np.zeros(len(points), np.int64)
    code = encode(points)
    tsne = TSNE(
        perplexity=min(30.0, (len(points) - 1) / 3), init="pca", max_iter=250, random_state=0
    )
    with threadpool_limits(1):  # its threads wait in busy loops
        plane = tsne.fit_transform(code)
    return density_peaks(plane.astype(np.float64), ratio)


def density_peaks(points: np.ndarray, ratio: float) -> np.ndarray:
    """Cluster points by density into any number of clusters, the last step of DDC.

    With ``d_c`` the mean distance times ``ratio``, a point's density is the sum of ``exp(-(d /
    d_c)^2)`` over all other points. A point denser than the mean whose nearest denser point is
    farther than ``d_c`` is a centre; any other point belongs to the cluster of its nearest denser
    point. Points denser than their cluster's mean are its core, and clusters with core points
    nearer than ``d_c`` to each other are joined (Section 3.2 of the paper).

    Args:
        points: Points ``(n, d)`` float64, n >= 2.
        ratio: Factor of ``d_c``, more than 0.

    Returns:
        Labels ``(n,)`` int64.
    """
    count = len(points)
    apart = cdist(points, points)
    cutoff = ratio * apart.sum() / (count * (count - 1))
    if cutoff == 0:
        return np.zeros(count, np.int64)
    near = np.exp(-((apart / cutoff) ** 2))
    np.fill_diagonal(near, 0)
    density = near.sum(axis=1)
    order = np.argsort(-density, kind="stable")
    rank = np.argsort(order)
    denser = np.where(rank[None, :] < rank[:, None], apart, np.inf)
    nearest, reach = denser.argmin(axis=1), denser.min(axis=1)
    centre = (reach > cutoff) & (density > density.mean())
    centre[order[0]] = True
    labels = np.arange(count)
    for point in order:
        labels[point] = point if centre[point] else labels[nearest[point]]
    labels = np.unique(labels, return_inverse=True)[1]
    mean = np.bincount(labels, density) / np.bincount(labels)
    core = np.flatnonzero(density > mean[labels])
    first, second = np.nonzero(apart[np.ix_(core, core)] < cutoff)
    links = np.ones(len(first), bool), (labels[core[first]], labels[core[second]])
    graph = coo_matrix(links, shape=(len(mean), len(mean)))
    return connected_components(graph, directed=False)[1].astype(np.int64)[labels]
