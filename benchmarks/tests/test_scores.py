"""Confidence intervals of scores, and ground truth objects grouped by their distance."""

import math

import numpy as np
import pytest

from benchmarks.scores.bootstrap import difference_intervals, intervals
from benchmarks.scores.group import group_objects
from jaxdet.eval import Case, Tally, score
from tests.score_cases import frame_truth, tallies

NAN = math.nan


def test_intervals():
    rng = np.random.default_rng(1)
    units = [
        Tally(visible=10, found=int(found), cases=(Case(1, 1.0, True, 0.01 * found, *[NAN] * 3),))
        for found in rng.binomial(10, 0.8, 80)
    ]
    got = intervals(units, resamples=400)
    low, high = got["recall"]
    assert low < score(units).recall < high
    # 800 trials at 0.8: a standard error of 0.0141.
    assert high - low == pytest.approx(2 * 1.96 * 0.0141, rel=0.25)
    assert got["f1"] == intervals(units, resamples=400)["f1"]
    assert intervals(units, seed=1)["recall"] != got["recall"]
    assert got["position_error_m"].low <= score(units).position_error_m
    assert math.isnan(got["coverage"].low) and intervals([]) == {}
    wide = intervals(units, level=0.99, resamples=400)["recall"]
    assert wide.low <= low and wide.high >= high


def test_differences():
    ours, theirs = tallies([(4, 0, 1), (3, 1, 0)] * 20), tallies([(3, 0, 2), (2, 1, 1)] * 20)
    gain = difference_intervals(ours, theirs, resamples=200)
    assert gain["recall"].low > 0
    assert difference_intervals(ours, ours, resamples=50)["f1"] == (0, 0)
    with pytest.raises(ValueError, match="40 units against 39"):
        difference_intervals(ours, theirs[1:])


def test_groups():
    plain = frame_truth()
    got = group_objects(plain, 0.4, 0.1)
    assert got.obstacle_id.tolist() == [[[0, 1, 1, 3, 4]]]
    assert got.visible_pixels.tolist() == [[30, 0, 30, 40]]
    assert got.height_m[0, 0] == 0.6 and np.isnan(got.nearest_m[0, 1])
    np.testing.assert_allclose(got.ground_min[0, 0], [0, 1])
    np.testing.assert_allclose(got.ground_max[0, 0], [1.3, 1.07])
    assert np.isfinite(got.footprint[0, 0]).all(axis=-1).sum() == 6
    assert plain.obstacle_id.tolist() == [[[0, 1, 2, 3, 4]]]
    for gaps in ((0.2, 0.1), (0.4, 0.01)):
        assert group_objects(plain, *gaps).obstacle_id.tolist() == plain.obstacle_id.tolist()
    assert group_objects(plain, 0.4, 1.0).visible_pixels.tolist() == [[60, 0, 0, 40]]
    with pytest.raises(ValueError, match="ground_min"):
        group_objects(plain._replace(ground_min=None), 0.4, 0.1)
