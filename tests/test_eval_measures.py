"""Indices, partitions, matches and outlines: examples by hand, comparison with sklearn, laws."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxdet.eval import PairCounts, davies_bouldin, fowlkes_mallows, match, pair_counts, silhouette
from jaxdet.eval.polygon import area, clip, hull, inside, near_side, overlap

SQUARE = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]])
seeds = st.integers(0, 2**32 - 1)


@given(seeds, st.integers(2, 60), st.integers(1, 8), st.integers(1, 3))
def test_indices_equal_those_of_sklearn(seed, n, clusters, axes):
    metrics = pytest.importorskip("sklearn.metrics")
    rng = np.random.default_rng(seed)
    points, labels = rng.normal(size=(n, axes)), rng.integers(-1, clusters, n)
    used = labels >= 0
    count = len(np.unique(labels[used]))
    ours = silhouette(points, labels), davies_bouldin(points, labels)
    if count < 2:
        assert all(map(math.isnan, ours))
    elif count < used.sum():
        assert ours[0] == pytest.approx(metrics.silhouette_score(points[used], labels[used]))
        assert ours[1] == pytest.approx(metrics.davies_bouldin_score(points[used], labels[used]))
    else:
        assert ours == (0.0, 0.0)


def test_indices_of_degenerate_partitions_are_their_limits_or_nan():
    twice = np.array([[0.0, 0.0], [0.0, 0.0], [1.0, 0.0], [1.0, 0.0]])
    labels = np.array([0, 0, 7, 7])
    assert silhouette(twice, labels) == 1 and davies_bouldin(twice, labels) == 0
    assert silhouette(0 * twice, labels) == 0 and davies_bouldin(0 * twice, labels) == 0
    around = np.array([[-1.0], [1.0], [-2.0], [2.0]])
    assert davies_bouldin(around, labels) == math.inf
    assert math.isnan(silhouette(twice, np.full(4, -1)))


@given(seeds, st.floats(-1e3, 1e3), st.floats(0.01, 100))
def test_indices_do_not_depend_on_place_and_scale(seed, shift, scale):
    rng = np.random.default_rng(seed)
    points, labels = rng.normal(size=(30, 2)), rng.integers(-1, 4, 30)
    moved = scale * points + shift
    assert silhouette(moved, labels) == pytest.approx(silhouette(points, labels), abs=1e-5)
    assert davies_bouldin(moved, labels) == pytest.approx(davies_bouldin(points, labels), rel=1e-5)


def test_points_on_the_edges_of_a_hull_are_left_out():
    on_edges = np.array([[1.0, 0.0], [2.0, 1.5], [0.5, 2.0], [0.0, 1.0], [1.0, 1.0]])
    assert hull(np.vstack([on_edges, SQUARE])).tolist() == SQUARE.tolist()


def alone(labels, first):
    """Return labels in which each noise point is a separate cluster."""
    noise = labels < 0
    return np.where(noise, first + np.cumsum(noise), labels)


@given(seeds, st.integers(1, 40), st.integers(1, 6), st.integers(1, 6))
def test_the_fowlkes_mallows_index_equals_that_of_sklearn(seed, n, a, b):
    metrics = pytest.importorskip("sklearn.metrics")
    rng = np.random.default_rng(seed)
    labels, truth = rng.integers(-1, a, n), rng.integers(-1, b, n)
    counts = pair_counts(labels, truth)
    ours = fowlkes_mallows(counts)
    theirs = metrics.fowlkes_mallows_score(alone(truth, 100), alone(labels, 100))
    if counts.detected or counts.true:
        assert ours == pytest.approx(theirs)
    else:
        assert math.isnan(ours)
    swapped = pair_counts(truth, labels)
    assert swapped == PairCounts(counts.both, counts.true, counts.detected)
    order = rng.permutation(n)
    assert pair_counts(labels[order], truth[order]) == counts


def test_the_fowlkes_mallows_index_matches_a_hand_calculation():
    assert fowlkes_mallows(PairCounts(0, 0, 3)) == 0 == fowlkes_mallows(PairCounts(0, 3, 0))
    assert pair_counts(np.zeros(0, int), np.zeros(0, int)) == PairCounts(0, 0, 0)
    assert pair_counts(np.array([0, 0]), np.array([-1, -1])) == PairCounts(0, 1, 0)


def test_matches_of_detections_and_objects_are_those_found_by_hand():
    yes = np.array([False, True, True, False])
    tie = np.array([[0, 3, 3, 0], [0, 5, 0, 0]])
    assert match(tie, yes).tolist() == [2, 1]
    assert match(np.array([[5, 4, 0, 0], [0, 0, 1, 9]]), yes).tolist() == [0, 0]
    purer = np.array([[0, 3, 0, 2], [0, 3, 0, 1]])
    assert match(purer, yes).tolist() == [0, 1] == match(purer[::-1], yes)[::-1].tolist()
    assert match(np.zeros((0, 4), int), yes).tolist() == []
    assert match(np.zeros((2, 4), int), yes).tolist() == [0, 0]


def test_the_number_of_votes_decides_before_their_fraction():
    votes = np.array([[1, 500, 0, 499], [0, 0, 6, 4], [0, 1, 0, 0], [997, 0, 3, 0]])
    assert match(votes, np.arange(4) > 0, 0.0).tolist() == [1, 3, 0, 2]


@given(seeds, st.integers(3, 9))
def test_overlap_is_symmetric_and_bounded(seed, n):
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(n, 2)), rng.normal(size=(n, 2))
    assert 0 <= overlap(a, b) <= 1
    assert overlap(a, b) == pytest.approx(overlap(b, a), abs=1e-9)
    assert overlap(a, a) == pytest.approx(1)
    assert overlap(a, a + 100) == 0
    assert area(clip(hull(a), hull(b))) <= min(area(hull(a)), area(hull(b))) + 1e-9
    assert inside(hull(a), a, 1e-9).all() and inside(hull(a)[::-1], a, 1e-9).all()


def test_the_overlap_of_outlines_equals_that_of_opencv():
    cv2 = pytest.importorskip("cv2")
    rng = np.random.default_rng(5)
    for _ in range(50):
        a, b = (hull(rng.normal(size=(6, 2))) for _ in range(2))
        common, _ = cv2.intersectConvexConvex(a.astype(np.float32), b.astype(np.float32))
        expected = common / (area(a) + area(b) - common)
        assert overlap(a, b) == pytest.approx(expected, abs=1e-4)


def test_areas_and_overlaps_of_outlines_match_a_hand_calculation():
    assert area(SQUARE) == 4 and area(SQUARE[::-1]) == -4 and area(SQUARE[:2]) == 0
    assert math.isnan(overlap(SQUARE[:2], SQUARE[:2])) and overlap(SQUARE, SQUARE[:2]) == 0
    assert overlap(SQUARE, SQUARE[::-1] + [0, 1]) == pytest.approx(1 / 3)
    points = np.array([[1, 1], [2.05, 1], [2.2, 1], [-0.05, -0.05]])
    assert inside(SQUARE, points).tolist() == [True, False, False, False]
    assert inside(SQUARE, points, 0.1).tolist() == [True, True, False, True]
    dot = np.zeros((4, 2))
    assert inside(dot, np.array([[0.0, 0.0], [0.1, 0.0]]), 0.05).tolist() == [True, False]


def test_the_near_side_of_an_outline_matches_a_hand_calculation():
    assert len(near_side(SQUARE - 1)) == 0
    assert len(near_side(np.full((4, 2), np.nan))) == 0
    corner = near_side(SQUARE + 1, 0.5)
    assert sorted(set(map(tuple, corner.tolist()))) == sorted(
        {(1, 1), (1, 1.5), (1, 2), (1, 2.5), (1, 3), (1.5, 1), (2, 1), (2.5, 1), (3, 1)}
    )
