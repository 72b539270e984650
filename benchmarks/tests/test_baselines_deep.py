"""DDC and DCC: examples by hand, naive implementations, and properties."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("scipy")
pytest.importorskip("sklearn")

from sklearn.metrics import adjusted_rand_score

from benchmarks.baselines import autoencoder, dcc, ddc
from benchmarks.tests.boards import board_frame, same_partition
from jaxdet.config import Config

seeds = st.integers(0, 2**32 - 1)


def clouds(count, apart=3.0):
    """Return the points of three clouds ``(n, 6)`` with a deviation of 0.1, and their clouds."""
    rng = np.random.default_rng(5)
    truth = np.arange(count) % 3
    centres = np.eye(6)[:3] * apart
    return (centres[truth] + rng.normal(0, 0.1, (count, 6))).astype(np.float32), truth


def test_descriptors_by_hand():
    frame = board_frame()
    n = int(frame.features.kept.sum())
    plain = autoencoder.descriptors(frame, 4.0, 1.0)
    assert plain.shape == (n, 6) and not plain[:, 2:].any()
    np.testing.assert_allclose(plain[:, 0], frame.features.x[0] / 1000, atol=1e-6)
    np.testing.assert_allclose(plain[:, 1], frame.features.z[0] / 250, atol=1e-6)
    # Grey grows by 2 levels per column: a slope of 2 / 255, a deviation of 2 levels x sqrt(20 / 3).
    ramp = np.repeat(2 * np.arange(160)[None, :, None], 120, axis=0).astype(np.int64)
    ramp = np.minimum(np.repeat(ramp, 3, axis=2), 255).astype(np.uint8)
    looks = autoencoder.descriptors(frame._replace(color=ramp), 1.0, 0.5)[:, 2:]
    u = frame.features.u[0]
    inner = (u >= 6) & (u <= 110)
    expected = np.stack([2.0 * u, 0 * u + 2 * (20 / 3) ** 0.5, 0 * u + 2.0, 0.0 * u], axis=1)
    np.testing.assert_allclose(looks[inner], expected[inner] * 0.5 / 255, atol=2e-4)


# --- DDC ---


def naive_peaks(points, ratio):
    """Cluster point by point as described in the docstring of ``density_peaks``."""
    n = len(points)
    gap = np.sqrt(((points[:, None] - points) ** 2).sum(-1))
    cutoff = ratio * np.mean([gap[i, j] for i in range(n) for j in range(n) if i != j])
    near = np.exp(-((gap / cutoff) ** 2))
    density = [sum(near[i, j] for j in range(n) if j != i) for i in range(n)]
    owner = {}
    for i in sorted(range(n), key=lambda i: -density[i]):
        if not owner:
            owner[i] = i
            continue
        j = min(owner, key=lambda j: gap[i, j])
        peak = gap[i, j] > cutoff and density[i] > np.mean(density)
        owner[i] = i if peak else owner[j]
    labels = np.array([owner[i] for i in range(n)])
    mean = {k: np.mean([density[i] for i in range(n) if labels[i] == k]) for k in labels}
    core = [i for i in range(n) if density[i] > mean[labels[i]]]
    for i in core:
        for j in core:
            if gap[i, j] < cutoff:
                labels[labels == labels[j]] = labels[i]
    return labels


@given(seeds, st.integers(3, 40), st.sampled_from([0.1, 0.2, 0.4]))
def test_density_peaks_equal_the_naive_implementation(seed, n, ratio):
    rng = np.random.default_rng(seed)
    points = rng.integers(0, 3, (n, 1)) + rng.normal(0, 0.3, (n, 2))
    assert same_partition(ddc.density_peaks(points, ratio), naive_peaks(points, ratio))


def test_density_peaks_by_hand():
    rng = np.random.default_rng(0)
    truth = np.repeat([0, 1, 2], 40)
    points = np.array([[0, 0], [9, 0], [0, 9]])[truth] + rng.normal(0, 0.5, (120, 2))
    assert same_partition(ddc.density_peaks(points, 0.1), truth)
    assert not ddc.density_peaks(np.ones((5, 2)), 0.1).any()


# --- DCC ---


@given(seeds, st.integers(3, 30), st.integers(1, 5))
def test_neighbour_edges_are_mutual_neighbours_and_keep_the_graph_connected(seed, n, k):
    points = np.random.default_rng(seed).random((n, 3))
    k = min(k, n - 1)
    gap = np.sqrt(((points[:, None] - points) ** 2).sum(-1))
    near = [set(np.argsort(row)[1 : k + 1]) for row in gap]
    mutual = {(i, j) for i in range(n) for j in near[i] if i < j and i in near[j]}
    edges = set(zip(*dcc.neighbour_edges(points, k).tolist(), strict=True))
    assert mutual <= edges
    either = {(min(i, j), max(i, j)) for i in range(n) for j in near[i]}
    assert edges <= either
    # Each component of the graph of all nearest neighbours stays connected.
    parts = list(range(n))
    for i, j in edges:
        parts = [parts[i] if p == parts[j] else p for p in parts]
    assert all(parts[i] == parts[j] for i, j in either)
    assert len(edges - mutual) <= n - 1


def test_the_robust_distance_by_hand():
    far = np.asarray(dcc._robust(np.array([[0.0, 0], [3, 4], [300, 400]], np.float32), 25.0))
    np.testing.assert_allclose(far, [0, 12.5, 25], rtol=1e-3)


def test_each_cloud_is_one_cluster_of_dcc():
    points, truth = clouds(90)
    labels = dcc.continuous(points, 10, 100.0, 10.0)
    assert adjusted_rand_score(truth, labels) == 1
    np.testing.assert_array_equal(dcc.continuous(points, 10, 100.0, 10.0), labels)
    strict = dcc.continuous(points, 10, 1e-6, 1.0)
    assert len(np.unique(strict)) > 10


# --- Both ---


def test_points_can_be_decoded_from_their_codes():
    points, _ = clouds(120)
    net = autoencoder.pretrained(points)
    code = autoencoder.encode(points)
    assert code.shape == (120, autoencoder.WIDTHS[-1])
    middle = points.mean(axis=0)
    again = np.asarray(autoencoder.rebuilt(net, code)) + middle
    assert np.sum((again - points) ** 2) < 0.05 * np.sum((points - middle) ** 2)
    # Training is deterministic: equal points result in equal codes.
    np.testing.assert_array_equal(autoencoder.encode(points.copy()), code)


@pytest.mark.parametrize("method", [ddc.ddc, dcc.dcc])
def test_labels_are_deterministic(method):
    frame = board_frame()
    extra = {"ratio": 0.1} if method is ddc.ddc else {}
    labels = method(frame, Config(), **extra)
    assert labels.shape == (int(frame.features.kept.sum()),)
    np.testing.assert_array_equal(method(frame, Config(), **extra), labels)
