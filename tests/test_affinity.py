"""affinity: tables of boosted trees that weigh what is seen of two surfaces."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxdet.affinity import (
    FRACTION_BITS,
    GROWS,
    LENGTHS,
    PAIR_FEATURES,
    Affinity,
    affinity,
    evidence,
)
from jaxdet.config import AFFINITIES

UNIT = 0.001
LARGE = 4000


def walked(seen: np.ndarray, table: Affinity) -> int:
    """The evidence of one pair, a tree and a node at a time."""
    total = table.offset
    for feature, threshold, value in zip(table.feature, table.threshold, table.value, strict=True):
        node = 0
        while node < len(feature):
            larger = seen[feature[node]] > threshold[node]
            node = 2 * node + (2 if larger else 1)
        total += value[node - len(feature)]
    return int(total)


NUM_FEATURES = len(PAIR_FEATURES)
pairs_seen = st.lists(st.integers(-200, LARGE), min_size=NUM_FEATURES, max_size=NUM_FEATURES)


def test_by_hand() -> None:
    """Two trees of one node."""
    table = Affinity(np.array([[0], [3]]), np.array([[50], [9]]), np.array([[7, -7], [2, -1]]), 100)
    seen = np.zeros((3, NUM_FEATURES), np.int64)
    seen[1, 0], seen[2, 0], seen[2, 3] = 50, 51, 10
    assert evidence(seen, table).tolist() == [109, 109, 92]


@pytest.mark.parametrize("name", AFFINITIES)
@given(seen=pairs_seen)
def test_as_walked(name: str, seen: list[int]) -> None:
    table = affinity(name, UNIT)
    assert evidence(np.array([seen]), table).tolist() == [walked(np.array(seen), table)]


@pytest.mark.parametrize("name", AFFINITIES)
@given(seen=pairs_seen, what=st.sampled_from(sorted(GROWS)), by=st.integers(1, LARGE))
def test_sense(name: str, seen: list[int], what: str, by: int) -> None:
    """A larger gap, a larger step, more lines one sees through never speak for a pair."""
    table = affinity(name, UNIT)
    before, after = np.array([seen]), np.array([seen])
    after[0, PAIR_FEATURES.index(what)] += by
    change = int(evidence(after, table)[0] - evidence(before, table)[0])
    assert change * GROWS[what] >= 0


@pytest.mark.parametrize("name", AFFINITIES)
def test_lengths_follow_the_depth_unit(name: str) -> None:
    rng = np.random.default_rng(0)
    seen = rng.integers(0, 1000, (200, NUM_FEATURES))
    fine = np.where([one in LENGTHS for one in PAIR_FEATURES], 10 * seen, seen)
    expected = evidence(seen, affinity(name, UNIT))
    np.testing.assert_array_equal(evidence(fine, affinity(name, UNIT / 10)), expected)
    assert expected.min() < 0 < expected.max()


@pytest.mark.parametrize("name", AFFINITIES)
def test_complete_trees(name: str) -> None:
    table = affinity(name, UNIT)
    trees, nodes = table.feature.shape
    assert nodes == 2**table.depth - 1 and table.threshold.shape == (trees, nodes)
    assert table.value.shape == (trees, nodes + 1)
    assert table.feature.min() >= 0 and table.feature.max() < NUM_FEATURES
    assert abs(table.offset) < 20 << FRACTION_BITS


def test_a_table_weighs_what_it_names() -> None:
    """That of ``tabletop`` is older than the last five of what is seen."""
    assert affinity("tabletop", UNIT).feature.max() < PAIR_FEATURES.index("behind")
    assert affinity("surfaces", UNIT).feature.max() >= PAIR_FEATURES.index("behind")


def test_nothing() -> None:
    assert len(evidence(np.zeros((0, NUM_FEATURES), np.int64), affinity("surfaces", UNIT))) == 0
