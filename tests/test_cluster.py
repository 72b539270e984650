"""cluster: examples by hand, and comparisons with SciPy and of kernel and reference."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.cluster.hierarchy import fcluster, linkage

from jaxdet import reference, stages
from jaxdet.config import ClusterConfig, Config
from jaxdet.errors import ConfigError
from jaxdet.types import MAX_LATERAL, Features
from tests.scenes import assert_equal, points

SLOTS = 12
BACKENDS = pytest.mark.parametrize("backend", [reference, stages], ids=["reference", "stages"])


def config(depth_gap: int = 100, lateral_gap: int = 400, min_points: int = 2) -> Config:
    """Return a configuration with gaps in depth units of 1 mm."""
    return replace(
        Config(),
        cluster=ClusterConfig(
            depth_gap_m=depth_gap / 1000,
            lateral_gap_m=lateral_gap / 1000,
            min_points=min_points,
        ),
    )


def labels(backend, features: Features, settings_: Config) -> list:
    """Return the labels of the points, padded so that all cases share one program."""
    count = features.z.shape[1]
    padded = padding(features, SLOTS - count)
    found = np.asarray(backend.paper.cluster(padded, 0.001, settings_).labels)
    assert (found[:, count:] == -1).all()
    return found[:, :count].tolist()


def padding(features: Features, count: int) -> Features:
    """Append points that are not valid to each frame."""
    pad = [(0, 0), (0, count)]
    return Features(*(np.pad(a, pad) if a.ndim == 2 else a for a in features))


# by hand


@BACKENDS
def test_gaps_in_depth_separate_sets(backend):
    z = [1000, 1100, 1200, 1301, 1401, 1501]
    assert labels(backend, points([0] * 6, z), config()) == [[0, 0, 0, 1, 1, 1]]
    assert labels(backend, points([0] * 6, z), config(depth_gap=101)) == [[0] * 6]


@BACKENDS
def test_a_chain_longer_than_the_gap_is_one_set(backend):
    """This is the rule of the paper's text (Step 3, Eq. 6); its Algorithm 1 contradicts it."""
    z = np.arange(11) * 100 + 500
    assert labels(backend, points(0 * z, z), config()) == [[0] * 11]


@BACKENDS
def test_lateral_gaps_separate_points_of_a_set(backend):
    x = [-500, -450, -400, 1, 50, 100, 700]
    z = [1000, 1010, 1020, 990, 1000, 1010, 1000]
    assert labels(backend, points(x, z), config()) == [[1, 1, 1, 0, 0, 0, -1]]


@BACKENDS
def test_sets_of_min_points_or_fewer_are_dropped(backend):
    z = [500, 501, 800, 801, 802]
    assert labels(backend, points([0] * 5, z), config()) == [[-1, -1, 0, 0, 0]]
    assert labels(backend, points([0] * 5, z), config(min_points=3)) == [[-1] * 5]


@BACKENDS
def test_clusters_are_ordered_by_nearest_depth_then_smallest_x(backend):
    x = [900, 910, 920, 0, 10, 20, -900, -890, -880]
    z = [600, 650, 650, 600, 650, 650, 599, 650, 650]
    assert labels(backend, points(x, z), config()) == [[2, 2, 2, 1, 1, 1, 0, 0, 0]]


@BACKENDS
def test_points_that_are_not_kept_have_no_label(backend):
    z, kept = [500, 501, 502, 503], [True, False, True, True]
    assert labels(backend, points([0] * 4, z, kept), config()) == [[0, -1, 0, 0]]
    nothing = points([0] * SLOTS, [*z] * 3, [False] * SLOTS)
    found = backend.paper.cluster(nothing, 0.001, config())
    assert np.asarray(found.num_obstacles).tolist() == [0]


def test_gaps_scale_with_the_depth_unit():
    z = [5000, 6000, 7000]
    found = reference.paper.cluster(points([0] * 3, z), 0.0001, config())
    assert found.labels.tolist() == [[0, 0, 0]]
    found = reference.paper.cluster(points([0] * 3, z), 0.001, config())
    assert found.labels.tolist() == [[-1] * 3]


@BACKENDS
def test_robots_width_is_the_gap_in_depth_and_sideways(backend):
    wide = replace(Config(), cluster=ClusterConfig(robot_width_m=0.5, min_points=1))
    z = [1000, 1500, 2001, 2501]
    assert labels(backend, points([0] * 4, z), wide) == [[0, 0, 1, 1]]
    assert labels(backend, points([0, 500, 1001, 1501], [1000] * 4), wide) == [[0, 0, 1, 1]]


@pytest.mark.parametrize("gap", ["depth_gap_m", "lateral_gap_m"])
def test_gap_and_robots_width_together_are_an_error(gap):
    with pytest.raises(ConfigError, match=f"cluster.{gap.replace('_', '-')} must be unset"):
        ClusterConfig(robot_width_m=0.5, **{gap: 0.5})


def test_gaps_that_are_not_given_have_their_defaults():
    assert ClusterConfig().gaps_m == (0.15, 0.27)
    assert ClusterConfig(depth_gap_m=0.0).gaps_m == (0.0, 0.27)
    assert ClusterConfig(lateral_gap_m=1.0).gaps_m == (0.15, 1.0)


def test_values_out_of_range_are_errors_that_name_the_flag():
    with pytest.raises(ConfigError, match=r"cluster\.depth-gap-m"):
        ClusterConfig(depth_gap_m=-1)


# SciPy


def single_linkage(x: np.ndarray, z: np.ndarray, settings_: Config) -> list[frozenset[int]]:
    """Return the sets of indices by single linkage along z, then along x within each set."""

    def split(index: np.ndarray, axis: np.ndarray, gap_m: float) -> list[np.ndarray]:
        if len(index) < 2:
            groups = np.ones(len(index))
        else:
            tree = linkage(axis[index, None].astype(float), "single")
            groups = fcluster(tree, gap_m * 1000, "distance")
        parts = [index[groups == g] for g in np.unique(groups)]
        return [part for part in parts if len(part) > settings_.cluster.min_points]

    depth_gap_m, lateral_gap_m = settings_.cluster.gaps_m
    sets = split(np.arange(len(z)), z, depth_gap_m)
    parts = [part for one in sets for part in split(one, x, lateral_gap_m)]
    return sorted((frozenset(part.tolist()) for part in parts), key=sorted)


@pytest.mark.parametrize("count", [1, 30, 1000])
@pytest.mark.parametrize("gaps", [(1, 5), (8, 100), (40, 20), (100, 400)])
@BACKENDS
def test_clusters_are_those_of_scipy(backend, count, gaps):
    rng = np.random.default_rng(count)
    x, z = rng.integers(-2000, 2000, count), rng.integers(300, 4000, count)
    settings_ = config(*gaps, min_points=2)
    found = np.asarray(backend.paper.cluster(points(x, z), 0.001, settings_).labels)[0]
    parts = [frozenset(np.flatnonzero(found == n).tolist()) for n in range(found.max() + 1)]
    assert sorted(parts, key=sorted) == single_linkage(x, z, settings_)


# twin


def random_points(seed: int, batch: int, n: int, spread: int) -> Features:
    rng = np.random.default_rng(seed)
    x, z = rng.integers(-spread, spread, (batch, n)), rng.integers(1, spread, (batch, n))
    return points(x, z, rng.random((batch, n)) < rng.random((batch, 1)))


@pytest.mark.twin
@pytest.mark.parametrize(
    ("batch", "n", "min_points"), [(1, 1, 0), (1, 7, 0), (3, 100, 2), (2, 1024, 10), (2, 5000, 2)]
)
@pytest.mark.parametrize("spread", [3, 500, 65535])
def test_clusters_equal_the_reference_on_points_of_any_spread(device, batch, n, spread, min_points):
    features = random_points(n + spread, batch, n, spread)
    given_ = features, 0.001, config(30, 60, min_points)
    assert_equal(stages.paper.cluster(*given_), reference.paper.cluster(*given_))


@pytest.mark.twin
@pytest.mark.parametrize("share", [1.0, 0.9])
@pytest.mark.parametrize("lateral_gap", [5, 10**4])
def test_clusters_equal_the_reference_with_as_many_clusters_as_points(device, lateral_gap, share):
    """Each point may be a cluster; the last one has the largest possible x."""
    x = MAX_LATERAL - 9 * np.arange(8192)[::-1]
    features = points(x, 7 * np.arange(8192), np.random.default_rng(0).random(8192) < share)
    given_ = features, 0.001, config(5, lateral_gap, 0)
    assert_equal(stages.paper.cluster(*given_), reference.paper.cluster(*given_))


# laws


hostile = st.lists(
    st.tuples(st.integers(-300, 300), st.integers(1, 300), st.booleans()), min_size=24, max_size=24
)
depth_gaps = st.sampled_from([0, 1, *range(17, 32)])
"""Gaps with two numbers of bins, so that few programs are compiled."""


@pytest.mark.twin
@given(hostile, depth_gaps, st.integers(0, 60), st.sampled_from([0, 3]))
@settings(max_examples=80)
def test_clusters_equal_the_reference_on_random_points(rows, depth_gap, lateral_gap, min_points):
    x, z, kept = (np.array(column) for column in zip(*rows, strict=True))
    given_ = points(x, z, kept), 0.001, config(depth_gap, lateral_gap, min_points)
    assert_equal(stages.paper.cluster(*given_), reference.paper.cluster(*given_))


def found(features: Features) -> np.ndarray:
    return np.asarray(stages.paper.cluster(features, 0.001, config(20, 60)).labels)


@pytest.mark.twin
@pytest.mark.parametrize("depth_gap", [0, 1])
def test_clusters_equal_the_reference_with_bins_of_one_depth_unit(depth_gap):
    z = np.array([[9, 1, 65535, 2, 9, 1, 4, 65534]])
    given_ = points(np.zeros_like(z), z), 0.001, config(depth_gap, 400, 1)
    assert_equal(stages.paper.cluster(*given_), reference.paper.cluster(*given_))


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=20)
def test_permuting_points_permutes_labels(seed):
    features = random_points(seed, 1, 200, 900)
    order = np.random.default_rng(seed).permutation(200)
    shuffled = Features(*(a[:, order] if a.ndim == 2 else a for a in features))
    before = found(features)
    after = found(shuffled)
    assert np.array_equal(after, before[:, order])


def test_padding_and_batching_change_nothing(device):
    features = random_points(1, 5, 300, 900)
    whole = found(features)
    for b in range(5):
        one = Features(*(a[b : b + 1] for a in features))
        got = found(padding(one, 700))[0]
        assert np.array_equal(got[:300], whole[b])
        assert np.all(got[300:] == -1)
