"""cluster, slice by slice: by hand, against SciPy's graphs, and the twin."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from jaxdet import reference, stages
from jaxdet.config import REACH
from jaxdet.reference._slices import components
from jaxdet.types import Features
from tests.scenes import assert_equal, points
from tests.slices import BACKENDS, config, labels, row_labels, rows_of


def grid_row(x, z, kept=None) -> Features:
    """A row of a grid, after one corner that is not kept."""
    kept = np.ones(len(x), bool) if kept is None else kept
    return points([0, *x], [0, *z], [False, *kept])


# by hand


@BACKENDS
def test_sideways_gaps_in_a_slice(backend):
    x = [0, 50, 100, 151, 200]
    assert labels(backend, points(x, [1010] * 5), config()) == [0, 0, 0, 1, 1]


@BACKENDS
def test_the_second_cut_joins_what_the_first_one_parts(backend):
    x = [0, 0, 0]
    assert labels(backend, points(x, [1090, 1110, 1149]), config()) == [0, 0, 0]
    # 1040 and 1110 are in different slices of both cuts, and nothing lies between.
    assert labels(backend, points(x, [1040, 1110, 1149]), config()) == [0, 1, 1]


@BACKENDS
def test_a_wall_beside_two_things_does_not_join_them(backend):
    """Depth first would: the wall reaches over both depths."""
    wall_z = np.arange(1000, 2000, 20)
    x = np.concatenate([np.full(50, -900), [0] * 3, [20] * 3])
    z = np.concatenate([wall_z, [1200] * 3, [1700] * 3])
    sliced = labels(backend, points(x, z), config(min_points=2))
    assert sliced == [0] * 50 + [1] * 3 + [2] * 3
    deep = labels(backend, points(x, z), config(min_points=2, slice_m=0.0))
    assert deep == [0] * 50 + [1] * 6


@BACKENDS
def test_small_sets_are_dropped(backend):
    x, z = [0, 10, 20, 500], [1000] * 4
    assert labels(backend, points(x, z), config(min_points=2)) == [0, 0, 0, -1]


@BACKENDS
def test_a_surface_goes_on_behind_a_nearer_thing(backend):
    x, z = [-400, -300, 0, 300, 400], [2000, 2005, 1000, 2050, 2060]
    row = grid_row(x, z)
    assert row_labels(backend, row, config(1, lateral_gap_m=0.1)) == [1, 1, 0, 1, 1]
    assert row_labels(backend, row, config(1, lateral_gap_m=0.1, occluder_m=0.5)) == [1, 1, 0, 2, 2]
    assert row_labels(backend, row, config(1, lateral_gap_m=0.1, occluder_m=0)) == [1, 1, 0, 2, 2]
    deeper = grid_row(x, [2000, 2005, 1000, 2150, 2160])
    assert row_labels(backend, deeper, config(1, lateral_gap_m=0.1)) == [1, 1, 0, 2, 2]
    for slope, want in ((0.07, 2), (0.08, 1)):  # 145 mm farther, 600 mm aside
        sloped = config(1, lateral_gap_m=0.1, occluder_slope=slope)
        assert row_labels(backend, deeper, sloped) == [1, 1, 0, want, want]


@BACKENDS
def test_corners_are_in_no_row(backend):
    row = grid_row([-400, 0, 400], [2000, 1000, 2000])
    assert row_labels(backend, row, config(1)) == [1, 0, 1]
    assert row_labels(backend, row, config(2)) == [1, 0, 2]
    assert row_labels(backend, row, config(4)) == [1, 0, 2]


@BACKENDS
def test_rows_are_apart(backend):
    row = grid_row([-400, 0, 400], [2000, 1000, 2000])
    row = row._replace(v=np.array([[0, 0, 1, 1]], np.int32))
    assert row_labels(backend, row, config(1)) == [1, 0, 2]


@pytest.mark.parametrize(("holes", "want"), [(0, 1), (2, 1), (3, 0)])
@BACKENDS
def test_holes_up_to_a_number_and_nothing_seen_between(backend, holes, want):
    x, z = [-200, 0, 0, 0, 200], [2000, 0, 0, 0, 2000]
    kept = [True, False, False, False, True]
    found = row_labels(backend, grid_row(x, z, kept), config(1, max_holes=holes))
    assert found == [0, -1, -1, -1, want]
    floor = grid_row(x, [2000, 0, 2400, 0, 2000], kept)
    assert row_labels(backend, floor, config(1, max_holes=holes)) == [0, -1, -1, -1, 1]


@BACKENDS
def test_the_search_ends_after_a_number_of_pixels(backend):
    for between, want in ((REACH - 1, 1), (REACH, 2)):
        x = np.concatenate([[-400], np.zeros(between), [400]])
        z = np.concatenate([[2000], np.full(between, 1000), [2000]])
        assert row_labels(backend, grid_row(x, z), config(1))[-1] == want


# SciPy


def test_components_are_scipys():
    rng = np.random.default_rng(0)
    for links in (0, 5, 60, 100, 400):
        first, second = rng.integers(0, 100, (2, links))
        ours = components(100, first, second)
        graph = coo_matrix((np.ones(links), (first, second)), (100, 100))
        count, theirs = connected_components(graph, directed=False)
        assert len(np.unique(ours)) == count
        assert len(np.unique(np.stack([ours, theirs]), axis=1).T) == count
        assert np.all(ours <= np.arange(100))


@pytest.mark.parametrize("count", [1, 40, 500])
@BACKENDS
def test_sideways_links_are_those_of_all_pairs_in_a_slice(backend, count):
    rng = np.random.default_rng(count)
    x, z = rng.integers(-800, 800, count), rng.integers(300, 1200, count)
    settings_ = config(lateral_gap_m=0.03, slice_m=0.04, occluder_m=0)
    found = labels(backend, points(x, z), settings_)
    links = [
        (i, j)
        for start in (0, 20)
        for i in range(count)
        for j in range(i)
        if (z[i] + start) // 40 == (z[j] + start) // 40 and abs(x[i] - x[j]) <= 30
    ]
    first, second = np.array(links, int).reshape(-1, 2).T
    graph = coo_matrix((np.ones(len(links)), (first, second)), (count, count))
    sets = connected_components(graph, directed=False)[1]
    order = sorted(set(sets), key=lambda s: (z[sets == s].min(), x[sets == s].min()))
    assert found == [order.index(s) for s in sets]


# twin


@pytest.mark.parametrize(
    ("batch", "n", "corners"), [(1, 1, 1), (1, 7, 1), (3, 100, 50), (2, 5000, 50), (1, 8192, 1)]
)
@pytest.mark.parametrize("spread", [3, 500, 65535])
def test_twin(device, cluster_form, batch, n, spread, corners):
    features = rows_of(np.random.default_rng(n + spread), batch, n, corners, spread)
    given_ = features, 0.001, config(corners, min_points=2)
    assert_equal(stages.cluster(*given_), reference.cluster(*given_))


@pytest.mark.parametrize("unit", [0.0001, 0.001, 0.02])
def test_twin_in_other_units(device, cluster_form, unit):
    features = rows_of(np.random.default_rng(9), 3, 900, 100, 3000)
    given_ = features, unit, config(100)
    assert_equal(stages.cluster(*given_), reference.cluster(*given_))


def test_one_long_chain(device, cluster_form):
    """The worst case for the components: all points in one path, in a random order."""
    order = np.random.default_rng(0).permutation(8192)
    z = 1000 + 5 * (order % 4096)
    features = points(40 * (order % 2), z)
    given_ = features, 0.001, config(8192, slice_m=0.012)
    want = reference.cluster(*given_)
    assert want.num_obstacles.tolist() == [1]
    assert_equal(stages.cluster(*given_), want)


hostile = st.lists(
    st.tuples(
        st.integers(-60, 60),
        st.integers(0, 90),
        st.integers(-30, 30),
        st.booleans(),
        st.integers(0, 1),
    ),
    min_size=24,
    max_size=24,
)


@given(
    hostile,
    st.integers(0, 60),
    st.integers(1, 60),
    st.integers(0, 2),
    st.integers(1, 24),
    st.sampled_from([0, 1, 20]),
)
@settings(max_examples=120, deadline=None)
def test_twin_on_anything(rows, gap, depth, holes, corners, height):
    x, z, y, kept, step = (np.array(column) for column in zip(*rows, strict=True))
    features = points(x, z, kept & (z > 0))._replace(
        y=y[None].astype(np.int32), v=np.cumsum(step)[None].astype(np.int32)
    )
    settings_ = config(
        corners,
        depth_gap_m=gap / 1000,
        slice_m=depth / 1000,
        max_holes=holes,
        occluder_m=0.06,
        occluder_slope=gap / 60,
        surface_height_m=height / 1000,
        surface_gap_m=gap / 2000,
    )
    given_ = features, 0.001, settings_
    assert_equal(stages.cluster(*given_), reference.cluster(*given_))


def test_shuffled_corners_get_the_same_labels():
    features = rows_of(np.random.default_rng(3), 1, 300, 300, 900)
    order = np.random.default_rng(5).permutation(300)
    shuffled = Features(*(a[:, order] if a.ndim == 2 else a for a in features))
    settings_ = config(300, min_points=1)
    before = labels(stages, features, settings_)
    assert labels(stages, shuffled, settings_) == [before[i] for i in order]


def test_more_reach_only_joins_sets():
    features = rows_of(np.random.default_rng(8), 1, 400, 100, 1500)
    counts = [
        len(set(labels(stages, features, config(100, lateral_gap_m=gap)))) for gap in (0, 0.05, 0.5)
    ]
    assert all(a > b for a, b in pairwise(counts))
