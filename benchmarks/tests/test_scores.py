"""Confidence intervals of scores, and ground truth objects grouped by their distance."""

import math

import numpy as np
import pytest

from benchmarks.scores.bootstrap import intervals
from benchmarks.scores.group import group_objects
from benchmarks.scores.negatives import negative_samples, with_negatives
from jaxdet.config import FeaturesConfig
from jaxdet.eval import Case, FrameTruth, Tally, score
from jaxdet.sim import SimConfig
from jaxdet.sim.config import calibration_of
from jaxdet.types import Detections, Features, Labels, Points
from tests.score_cases import frame_truth

NAN = math.nan
CALIBRATION = calibration_of(SimConfig(width=160, height=120))


def test_intervals_contain_the_figure_and_have_the_width_of_the_standard_error():
    rng = np.random.default_rng(1)
    units = [
        Tally(visible=10, found=int(found), cases=(Case(1, 1.0, True, 0.01 * found, *[NAN] * 3),))
        for found in rng.binomial(10, 0.8, 80)
    ]
    got = intervals(units, resamples=400)
    low, high = got["recall"]
    assert low < score(units).recall < high
    # 800 trials with probability 0.8: a standard error of 0.0141.
    assert high - low == pytest.approx(2 * 1.96 * 0.0141, rel=0.25)
    assert got["f1"] == intervals(units, resamples=400)["f1"]
    assert intervals(units, seed=1)["recall"] != got["recall"]
    assert got["position_error_m"].low <= score(units).position_error_m
    assert math.isnan(got["coverage"].low) and intervals([]) == {}
    wide = intervals(units, level=0.99, resamples=400)["recall"]
    assert wide.low <= low and wide.high >= high


def test_obstacles_closer_than_both_gaps_are_one_group():
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


def textured():
    """Return an image with four patches of texture and its truth: two on floor, an object, far."""
    color = np.full((120, 160, 3), 128, np.uint8)
    patch = np.kron(np.indices((5, 5)).sum(axis=0) % 2, np.ones((6, 6))).astype(np.uint8)[..., None]
    depth, ids = np.full((120, 160), 2.0), np.zeros((120, 160), np.int32)
    for v, u in ((5, 5), (5, 100), (80, 5), (80, 100)):
        color[v : v + 30, u : u + 30] = 200 * patch
    ids[80:110, 5:35] = 1
    depth[60:, 80:] = 5.0
    pixels = np.array([[900]])
    truth = FrameTruth(ids[None], pixels, pixels, pixels, np.array([False]), depth_m=depth[None])
    return color, truth


def test_negative_samples_are_groups_of_corners_on_floor_in_range():
    samples = negative_samples(*textured(), FeaturesConfig(min_distance=5.0), 3.0)
    assert samples.shape == (120, 160) and samples.max() == 2
    for v, u in ((20, 20), (20, 115)):
        near = samples[v - 20 : v + 20, u - 20 : u + 20]
        assert len(np.unique(near[near > 0])) == 1
    assert not samples[60:].any()


def test_a_negative_sample_with_a_detected_point_is_no_true_negative():
    color, truth = textured()
    samples = negative_samples(color, truth, FeaturesConfig(min_distance=5.0), 3.0)
    v, u = (axis[:1] for axis in np.nonzero(samples == 1))
    one, yes = np.ones((1, 1), np.int32), np.ones((1, 1), bool)
    points = Features(u[None], v[None], one, one, one, yes, yes, overflow=yes[0])
    tally = Tally(visible=3, found=2, false=1)
    for label, true_negatives in ((-1, 2), (0, 1)):
        labels = Labels(np.full((1, 1), label, np.int32), np.array([label + 1]))
        found = Detections(
            labels.num_obstacles, yes[0], yes[0], None, points=Points(points, labels)
        )
        one_more = with_negatives(tally, samples, found, CALIBRATION)
        expected = (2 + true_negatives) / (2 + true_negatives + 1 + 1)
        assert score([one_more]).accuracy == pytest.approx(expected)
