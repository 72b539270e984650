"""CURE, ROCK, PERCH and CHAMELEON: examples by hand, naive implementations, and properties."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("scipy")
pytest.importorskip("sklearn")

from scipy.cluster.hierarchy import fcluster, linkage
from sklearn.metrics import adjusted_rand_score

from benchmarks.baselines import cure, perch, rock
from benchmarks.baselines.clustering import chameleon
from benchmarks.baselines.sampling import cluster_sample, sample
from benchmarks.tests.boards import same_partition

seeds = st.integers(0, 2**32 - 1)
EASY = {
    "cure": (cure.cure, {"distance_m": 0.5}),
    "rock": (rock.rock, {"radius_m": 0.3, "clusters": 4}),
    "perch": (perch.perch, {"diagonal_m": 1.5}),
    "chameleon": (chameleon, {"clusters": 4}),
}


def blobs(count):
    """Return the points of four clouds 3 apart with a deviation of 0.1, and their clouds."""
    rng = np.random.default_rng(4)
    truth = np.arange(count) % 4
    return np.array([[0, 0], [3, 0], [0, 3], [3, 3]])[truth] + rng.normal(0, 0.1, (count, 2)), truth


@pytest.mark.parametrize("name", EASY)
@pytest.mark.parametrize("count", [80, 1200])
def test_distant_clouds_are_found_with_equal_labels_each_time(name, count):
    if name == "chameleon":
        pytest.importorskip("pychameleon")
    run, params = EASY[name]
    points, truth = blobs(count)
    labels = run(points, **params)
    assert labels.shape == (count,) and adjusted_rand_score(truth, labels) == 1
    np.testing.assert_array_equal(run(points.copy(), **params), labels)


def test_samples_are_reproducible_and_other_points_take_the_nearest_label():
    assert sample(5, 9).tolist() == [0, 1, 2, 3, 4]
    chosen = sample(100, 10)
    assert len(set(chosen)) == 10 and (np.diff(chosen) > 0).all()
    np.testing.assert_array_equal(sample(100, 10), chosen)
    line = np.arange(100.0)[:, None]
    labels = cluster_sample(line, 10, lambda own: own[:, 0].astype(int))
    assert (np.abs(labels - line[:, 0]) == np.abs(line - chosen).min(axis=1)).all()


# --- CURE ---


def naive_cure(points, clusters, representatives, shrink):
    """Merge until ``clusters`` clusters are left; return the indices of each."""
    found = [[i] for i in range(len(points))]

    def stand_ins(own):
        cloud = points[own]
        mean = cloud.mean(axis=0)
        picked = [max(own, key=lambda i: ((points[i] - mean) ** 2).sum())]
        while len(picked) < min(representatives, len(own)):
            gap = {i: min(((points[i] - points[j]) ** 2).sum() for j in picked) for i in own}
            picked.append(max(own, key=lambda i: gap[i]))
        return [points[i] + shrink * (mean - points[i]) for i in picked]

    while len(found) > clusters:
        pairs = [(a, b) for b in range(len(found)) for a in range(b)]
        ends = [stand_ins(own) for own in found]
        gaps = [min(np.hypot(*(p - q)) for p in ends[a] for q in ends[b]) for a, b in pairs]
        a, b = pairs[int(np.argmin(gaps))]
        found[a] += found.pop(b)
    return found


def as_labels(clusters, count):
    labels = np.zeros(count, int)
    for number, own in enumerate(clusters):
        labels[own] = number
    return labels


@settings(max_examples=25)
@given(seeds, st.integers(2, 14), st.integers(1, 5), st.integers(1, 5), st.floats(0, 0.9))
def test_cure_equals_the_naive_implementation(seed, n, clusters, representatives, shrink):
    points = np.random.default_rng(seed).random((n, 2))
    ours = cure.merge(points, np.inf, representatives, shrink, clusters).labels
    assert same_partition(ours, as_labels(naive_cure(points, clusters, representatives, shrink), n))


@given(seeds, st.integers(2, 60), st.floats(0.01, 0.5))
def test_cure_with_all_points_unshrunk_is_single_linkage(seed, n, gap):
    points = np.random.default_rng(seed).random((n, 2))
    single = fcluster(linkage(points, "single"), gap, "distance")
    assert same_partition(cure.cure(points, gap, representatives=n, shrink=0.0), single)


def test_cure_by_hand():
    square = np.array([[0.0, 0], [4, 0], [4, 4], [0, 4], [2, 2]])
    ends = cure.scatter(square, 2, 0.5)
    np.testing.assert_allclose(ends, [[1, 1], [3, 3]])
    np.testing.assert_allclose(cure.scatter(square[:1], 3, 0.5), square[[0, 0, 0]])
    line = np.array([[0.0, 0], [1, 0], [2.4, 0], [9, 0]])
    # The representatives 0 and 1 are moved to 0.25 and 0.75: 2.4 is 1.65 away.
    assert cure.merge(line, 1.5, 2, 0.5).labels.tolist() == [0, 0, 1, 2]
    assert cure.merge(line, 1.7, 2, 0.5).labels.tolist() == [0, 0, 0, 1]


# --- ROCK ---


def naive_rock(near, clusters, theta):
    power = 1 + 2 * (1 - theta) / (1 + theta)
    found = [[i] for i in range(len(near))]
    while len(found) > clusters:
        best, pair = 0.0, None
        for a in range(len(found)):
            for b in range(a + 1, len(found)):
                links = sum((near[i] & near[j]).sum() for i in found[a] for j in found[b])
                m, k = len(found[a]), len(found[b])
                goodness = links / ((m + k) ** power - (m**power + k**power))
                if goodness > best:
                    best, pair = goodness, (a, b)
        if pair is None:
            break
        found[pair[0]] += found.pop(pair[1])
    return found


@settings(max_examples=25)
@given(seeds, st.integers(2, 16), st.integers(1, 5), st.sampled_from([0.2, 0.5, 0.8]))
def test_rock_equals_the_naive_implementation(seed, n, clusters, theta):
    # Of pairs with equal goodness, frequent in small examples, both take the lowest indices.
    rng = np.random.default_rng(seed)
    near = rng.random((n, n)) < 0.3
    near = near | near.T | np.eye(n, dtype=bool)
    ours = rock.merge(near, clusters, theta)
    theirs = as_labels(naive_rock(near, clusters, theta), n)
    assert same_partition(ours, theirs)


def test_rock_by_hand():
    # Two triangles that are connected by the edge 2-3 only.
    near = np.eye(6, dtype=bool)
    for a, b in [(0, 1), (0, 2), (1, 2), (3, 4), (3, 5), (4, 5), (2, 3)]:
        near[a, b] = near[b, a] = True
    assert rock.merge(near, 2, 0.5).tolist() == [0, 0, 0, 1, 1, 1]
    assert rock.merge(near, 1, 0.5).tolist() == [0] * 6
    near[2, 3] = near[3, 2] = False
    assert rock.merge(near, 1, 0.5).tolist() == [0, 0, 0, 1, 1, 1]


def test_rock_labels_points_without_neighbours_as_noise():
    points, truth = blobs(400)
    lost = np.setdiff1d(np.arange(400), sample(400, 100))[0]
    points[lost] = 50
    labels = rock.rock(points, 0.3, 4, limit=100)
    assert np.flatnonzero(labels == -1).tolist() == [lost]
    others = np.arange(400) != lost
    assert adjusted_rand_score(truth[others], labels[others]) == 1


# --- PERCH ---


def walk(tree, node):
    """Return a node and all nodes below it, after checking their parents and sizes."""
    if node < tree.count:
        return [node]
    below = []
    for child in tree.children[node]:
        assert tree.parent[child] == node
        below += walk(tree, child)
    assert tree.size[node] == len(tree.leaves(node)) == len([n for n in below if n < tree.count])
    return [node, *below]


@given(seeds, st.integers(1, 60))
def test_perch_tree_is_consistent(seed, n):
    points = np.random.default_rng(seed).random((n, 2))
    tree = perch.Tree(points)
    nodes = walk(tree, tree.root)
    assert len(nodes) == 2 * n - 1 and tree.parent[tree.root] == -1
    for node in nodes:
        own = points[tree.leaves(node)]
        assert tree.box[node] == (*own.min(axis=0), *own.max(axis=0))
    for diagonal in (0.0, 0.2, 0.7, 2.0):
        labels = perch.perch(points, diagonal)
        boxes = [np.ptp(points[labels == k], axis=0) for k in range(labels.max() + 1)]
        assert all(np.hypot(*box) <= diagonal for box in boxes)
    assert len(np.unique(perch.perch(points, 2.0))) == 1


@given(seeds, st.integers(2, 5), st.integers(2, 8))
def test_perch_is_pure_where_clusters_are_separated(seed, clusters, each):
    # Theorem 1 of the paper: if clusters are farther apart than wide, each is a node, in any order
    # of points.
    rng = np.random.default_rng(seed)
    truth = rng.permutation(np.repeat(np.arange(clusters), each))
    points = np.stack([10.0 * truth, np.zeros(len(truth))], axis=1) + rng.random((len(truth), 2))
    assert same_partition(perch.perch(points, 2.0), truth)


def test_perch_by_hand():
    tree = perch.Tree(np.array([[0.0, 0], [10, 0], [1, 0]]))
    assert sorted(map(sorted, tree.branches(1.0))) == [[0, 2], [1]]
    tree = perch.Tree(np.array([[0.0, 0], [10, 0], [11, 0], [1, 0]]))
    assert sorted(map(sorted, tree.branches(1.0))) == [[0, 3], [1, 2]]
    assert sorted(map(sorted, tree.branches(0.9))) == [[0], [1], [2], [3]]


def test_perch_rotates_a_masked_node():
    # 11 becomes the sibling of 5, which is nearer to its aunt 0 than to 11.
    tree = perch.Tree(np.array([[0.0, 0], [5, 0], [11, 0]]))
    assert sorted(map(sorted, tree.branches(5.0))) == [[0, 1], [2]]


def test_perch_balances_a_chain():
    tree = perch.Tree(np.stack([np.arange(64.0), np.zeros(64)], axis=1))
    depth, node = 0, 63
    while node != tree.root:
        depth, node = depth + 1, tree.parent[node]
    assert depth <= 12


# --- CHAMELEON ---


def test_chameleon_equals_its_package_on_points_below_the_limit():
    package = pytest.importorskip("pychameleon")
    points, _ = blobs(200)
    own = package.Chameleon(n_clusters=3).fit_predict(points)
    np.testing.assert_array_equal(chameleon(points, 3), own)
    assert chameleon(points[:2], 1).shape == (2,)
