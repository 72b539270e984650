"""DCC (deep continuous clustering): autoencoder and a representative of each point.

Shah and Koltun, Deep continuous clustering, arXiv 1803.01449 (2018), here of descriptors of points.
The autoencoder and the representatives are optimised together: representatives stay near the codes
and near the representatives of neighbours, by robust distances whose scale decreases. Own
implementation after the authors' code, which needs PyTorch. Unlike in the paper, it is trained on a
random sample of a frame's points; any other point gets the label of the sample's nearest
descriptor.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components, minimum_spanning_tree
from scipy.spatial import KDTree

from benchmarks.baselines.autoencoder import (
    SAMPLE,
    Net,
    adam,
    code_of,
    descriptors,
    padded,
    pretrained,
    rebuilt,
)
from benchmarks.baselines.frames import Frame
from benchmarks.baselines.sampling import cluster_sample
from jaxdet.config import Config

FINETUNING = 300
"""Number of steps of Adam in the optimisation of autoencoder and representatives."""
EVERY = 20
"""Number of steps after which the scales of the robust distances are halved, the paper's M."""
NOISE_M = 0.01
"""Edges with smaller differences of coordinates are ignored when the scale is chosen."""


def dcc(
    frame: Frame,
    config: Config,
    pull: float = 100.0,
    threshold: float = 10.0,
    neighbours: int = 20,
    depth_scale: float = 1.0,
    grey_m: float = 0.1,
) -> np.ndarray:
    """Cluster a frame's features by DCC of their descriptors.

    Args:
        frame: The frame.
        config: Not used.
        pull: See :func:`continuous`.
        threshold: See :func:`continuous`.
        neighbours: See :func:`continuous`.
        depth_scale: See :func:`descriptors`.
        grey_m: See :func:`descriptors`.

    Returns:
        Labels ``(n,)`` integer of the features above the floor.
    """
    points = descriptors(frame, depth_scale, grey_m)
    return cluster_sample(
        points, SAMPLE, partial(continuous, neighbours=neighbours, pull=pull, threshold=threshold)
    )


def continuous(points: np.ndarray, neighbours: int, pull: float, threshold: float) -> np.ndarray:
    """Cluster points by DCC.

    Scales and weights are those of the authors' code, except that the data term's scale starts at
    16 times its final value, without the code's lower bound. ``pull`` and ``threshold`` are
    additions: the authors' code expects tens of thousands of points that are normalised to its own
    constants.

    Args:
        points: Descriptors ``(m, d)`` float32.
        neighbours: Number of nearest neighbours of each point. Edges join points that are
            neighbours of each other, and the minimum spanning tree of all neighbours.
        pull: Factor for the weight of the pairs, the paper's lambda.
        threshold: Two representatives are in one cluster if their distance is less than this
            multiple of the mean of the shortest 1 % of the edges.

    Returns:
        Labels ``(m,)`` int64: components of the edges whose representatives are near each other.
    """
    count = len(points)
    if count < 3:
        return np.zeros(count, np.int64)
    edges = neighbour_edges(points, min(neighbours, count - 1))
    first, second = edges
    degree = np.bincount(edges.ravel(), minlength=count).astype(np.float64)
    weight = degree.mean() / np.sqrt(degree[first] * degree[second])
    start = pretrained(points)
    code = np.asarray(code_of(start, padded(points)), np.float64)[:count]
    length = np.sort(np.linalg.norm(code[first] - code[second], axis=1))
    length = length[length > NOISE_M * np.sqrt(code.shape[1])]
    if not len(length):
        return np.zeros(count, np.int64)
    near = float(length[: max(1, len(edges[0]) // 100)].mean())
    scatter = float(np.mean(np.sum((code - code.mean(axis=0)) ** 2, axis=1)))
    graph = coo_matrix((weight, (first, second)), shape=(count, count)).toarray()
    laplacian = np.diag((graph + graph.T).sum(axis=1)) - graph - graph.T
    balance = pull * np.linalg.norm(code, 2) / (1 + np.linalg.norm(laplacian, 2))
    room = SAMPLE * (neighbours + 1) - len(weight)
    stiffness = np.array([16 * scatter, scatter, 3 * length[-1] ** 2, near / 2, balance])
    moved = _finetuned(
        start,
        padded(points),
        np.pad(degree, (0, SAMPLE - count)).astype(np.float32),
        np.pad(edges, ((0, 0), (0, room))),
        np.pad(weight, (0, room)).astype(np.float32),
        stiffness.astype(np.float32),
        count,
    )
    own = np.asarray(moved, np.float64)[:count]
    joined = np.linalg.norm(own[first] - own[second], axis=1) < threshold * near
    graph = coo_matrix((joined[joined], edges[:, joined]), shape=(count, count))
    return connected_components(graph, directed=False)[1].astype(np.int64)


def neighbour_edges(points: np.ndarray, neighbours: int) -> np.ndarray:
    """Return edges: mutual nearest neighbours, and the minimum spanning tree of all neighbours.

    Args:
        points: Points ``(m, d)``.
        neighbours: Number of nearest neighbours of each point, less than
            m.

    Returns:
        Indices ``(2, edges)`` int64, the lower index first, sorted.
    """
    count = len(points)
    length, index = KDTree(points).query(points, k=neighbours + 1)
    rows = np.repeat(np.arange(count), neighbours + 1)
    other = rows != index.ravel()
    # For minimum_spanning_tree, a length of 0 means no edge.
    lengths = np.maximum(length.ravel(), 1e-9)[other]
    place = (rows[other], index.ravel()[other])
    graph = coo_matrix((lengths, place), shape=(count, count)).tocsr()
    tree = minimum_spanning_tree(graph)
    near: Any = graph > 0
    both = near.multiply(near.T) + (tree > 0) + (tree > 0).T
    first, second = both.nonzero()
    return np.stack([first, second])[:, first < second].astype(np.int64)


@jax.jit
def _finetuned(
    net: Net,
    points: jax.Array,
    degree: jax.Array,
    edges: jax.Array,
    weight: jax.Array,
    stiffness: jax.Array,
    count: int,
) -> jax.Array:
    """Return the representatives, optimised together with the autoencoder."""
    data, data_end, pair, pair_end, balance = stiffness

    def loss(value: tuple[Net, jax.Array], step: jax.Array) -> jax.Array:
        net, own = value
        half = 0.5 ** (step // EVERY).astype(jnp.float32)
        code = code_of(net, points)
        error = jnp.sum(degree * jnp.sum((rebuilt(net, code) - points) ** 2, axis=1))
        far = _robust(code - own, jnp.maximum(data_end, data * half))
        apart = _robust(own[edges[0]] - own[edges[1]], jnp.maximum(pair_end, pair * half))
        pull = jnp.sum(degree * far) + balance * jnp.sum(weight * apart)
        return error / (count * points.shape[1]) + pull / (count * code.shape[1])

    return adam(loss, (net, code_of(net, points)), FINETUNING)[1]


def _robust(difference: jax.Array, scale: jax.Array) -> jax.Array:
    """Return Geman and McClure's distance: near 0 the square, at most the scale."""
    square = jnp.sum(difference**2, axis=1)
    return scale * square / (scale + square)
