"""affinity: boosted trees that turn the features of a pair of surfaces into evidence."""

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
    """Return the evidence of one pair, computed tree by tree and node by node."""
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


def test_evidence_is_the_offset_plus_the_leaves_reached() -> None:
    """A table has two trees of one node each."""
    table = Affinity(np.array([[0], [3]]), np.array([[50], [9]]), np.array([[7, -7], [2, -1]]), 100)
    seen = np.zeros((3, NUM_FEATURES), np.int64)
    seen[1, 0], seen[2, 0], seen[2, 3] = 50, 51, 10
    assert evidence(seen, table).tolist() == [109, 109, 92]


@pytest.mark.parametrize("name", AFFINITIES)
@given(seen=pairs_seen)
def test_evidence_equals_that_found_by_walking_each_tree(name: str, seen: list[int]) -> None:
    table = affinity(name, UNIT)
    assert evidence(np.array([seen]), table).tolist() == [walked(np.array(seen), table)]


@pytest.mark.parametrize("name", AFFINITIES)
@given(seen=pairs_seen, what=st.sampled_from(sorted(GROWS)), by=st.integers(1, LARGE))
def test_evidence_is_monotonic_in_gaps_steps_and_lines_of_sight(
    name: str, seen: list[int], what: str, by: int
) -> None:
    """A larger gap or step, or more lines of sight between surfaces, never add evidence."""
    table = affinity(name, UNIT)
    before, after = np.array([seen]), np.array([seen])
    after[0, PAIR_FEATURES.index(what)] += by
    change = int(evidence(after, table)[0] - evidence(before, table)[0])
    assert change * GROWS[what] >= 0


@pytest.mark.parametrize("name", AFFINITIES)
def test_thresholds_of_lengths_scale_with_the_depth_unit(name: str) -> None:
    rng = np.random.default_rng(0)
    seen = rng.integers(0, 1000, (200, NUM_FEATURES))
    fine = np.where([one in LENGTHS for one in PAIR_FEATURES], 10 * seen, seen)
    expected = evidence(seen, affinity(name, UNIT))
    np.testing.assert_array_equal(evidence(fine, affinity(name, UNIT / 10)), expected)
    assert expected.min() < 0 < expected.max()


@pytest.mark.parametrize("name", AFFINITIES)
def test_trees_are_complete_and_their_values_bounded(name: str) -> None:
    table = affinity(name, UNIT)
    trees, nodes = table.feature.shape
    assert nodes == 2**table.depth - 1 and table.threshold.shape == (trees, nodes)
    assert table.value.shape == (trees, nodes + 1)
    assert table.feature.min() >= 0 and table.feature.max() < NUM_FEATURES
    assert abs(table.offset) < 20 << FRACTION_BITS


def test_only_the_newer_table_uses_the_last_five_features() -> None:
    """The table of ``tabletop`` was trained before the last five features existed."""
    assert affinity("tabletop", UNIT).feature.max() < PAIR_FEATURES.index("behind")
    assert affinity("surfaces", UNIT).feature.max() >= PAIR_FEATURES.index("behind")


def test_without_pairs_there_is_no_evidence() -> None:
    assert len(evidence(np.zeros((0, NUM_FEATURES), np.int64), affinity("surfaces", UNIT))) == 0
