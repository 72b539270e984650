"""RSC (our reading): examples by hand, a naive implementation, and properties."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("scipy")

from benchmarks.baselines.rsc import nearest_neighbours, rsc_count, rsc_threshold
from benchmarks.tests.boards import same_partition

seeds = st.integers(0, 2**32 - 1)


def naive_rsc(points, tau, root):
    """Cluster level by level with dictionaries, as described in the module's docstring."""
    clusters = [([i], np.array(p, float)) for i, p in enumerate(points)]
    while len(clusters) > 1:
        centre = np.array([c for _, c in clusters])
        gap = np.sqrt(((centre[:, None] - centre) ** 2).sum(-1))
        np.fill_diagonal(gap, np.inf)
        nearest = gap.argmin(1)
        short = gap.min(1) <= tau
        if not short.any():
            break
        group = list(range(len(clusters)))
        for i in np.flatnonzero(short):
            a, b = group[i], group[nearest[i]]
            group = [a if g == b else g for g in group]
        merged = []
        for name in sorted(set(group), key=group.index):
            members = [i for i, g in enumerate(group) if g == name]
            leaves = [leaf for i in members for leaf in clusters[i][0]]
            place = clusters[members[0]][1]
            for i in members:
                j = int(nearest[i])
                if len(members) > 1 and nearest[j] == i and i < j:
                    place = centre[i] if root == "member" else (centre[i] + centre[j]) / 2
            if root == "mean":
                place = np.mean([points[leaf] for leaf in leaves], axis=0)
            merged.append((leaves, place))
        clusters = merged
    labels = np.zeros(len(points), int)
    for number, (leaves, _) in enumerate(clusters):
        labels[leaves] = number
    return labels


@given(
    seeds, st.integers(2, 40), st.floats(0.02, 0.6), st.sampled_from(["midpoint", "member", "mean"])
)
def test_rsc_equals_the_naive_implementation(seed, n, tau, root):
    points = np.random.default_rng(seed).random((n, 2))
    assert same_partition(rsc_threshold(points, tau, root), naive_rsc(points, tau, root))


def test_rsc_by_hand():
    line = np.array([[0.0], [1.0], [2.1], [10.0], [11.0], [30.0]])
    assert same_partition(rsc_threshold(line, 0.5), np.arange(6))
    assert same_partition(rsc_threshold(line, 1.0), np.array([0, 0, 2, 3, 3, 5]))
    assert same_partition(rsc_threshold(line, 1.1), np.array([0, 0, 0, 3, 3, 5]))
    # Roots 0.5 and 10.5: 10 apart; then 5.5 and 30.
    assert same_partition(rsc_threshold(line, 10.0), np.array([0, 0, 0, 0, 0, 5]))
    assert len(np.unique(rsc_threshold(line, 24.5))) == 1


@given(seeds, st.integers(2, 60), st.integers(1, 70), st.booleans())
def test_rsc_clusters_have_the_given_number_and_are_nested(seed, n, clusters, grid):
    rng = np.random.default_rng(seed)
    points = rng.integers(0, 4, (n, 2)).astype(float) if grid else rng.random((n, 2))
    labels = rsc_count(points, clusters)
    assert len(np.unique(labels)) == min(n, clusters)
    if clusters < n:
        finer = rsc_count(points, clusters + 1)
        assert np.unique(np.stack([labels, finer]), axis=1).shape[1] == clusters + 1


@given(seeds, st.integers(2, 200), st.integers(1, 5))
def test_of_equally_near_points_the_lowest_index_is_nearest(seed, n, values):
    points = np.random.default_rng(seed).integers(0, values, (n, 2)).astype(float)
    gap = np.sqrt(((points[:, None] - points) ** 2).sum(-1))
    np.fill_diagonal(gap, np.inf)
    nearest, length = nearest_neighbours(points)
    np.testing.assert_array_equal(nearest, gap.argmin(1))
    np.testing.assert_array_equal(length, gap.min(1))
