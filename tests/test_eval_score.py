"""Scores, the shares kept by the ground stage, and the ground truth of a simulated log."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxdet.eval import (
    Case,
    Score,
    Tally,
    keep_shares,
    nearest_on_floor,
    score,
    total,
    truth_of,
)
from jaxdet.eval.score import errors
from jaxdet.eval.tally import COUNTS
from jaxdet.results.metric import to_world
from jaxdet.types import Calibration, Extrinsics, Intrinsics
from tests.score_cases import frame_truth, tallies

NAN = math.nan
counts = st.lists(
    st.tuples(st.integers(0, 5), st.integers(0, 5), st.integers(0, 5)), min_size=1, max_size=6
)


@given(counts)
def test_figures_of_a_score_are_consistent(rows):
    figures = score(tallies(rows))
    tp, fp, fn = (sum(column) for column in zip(*rows, strict=True))
    if tp:
        p, r = tp / (tp + fp), tp / (tp + fn)
        assert figures.f1 == pytest.approx(2 * p * r / (p + r))
        assert figures.accuracy == pytest.approx(1 / (1 / p + 1 / r - 1))
        assert figures.accuracy <= figures.f1 <= figures.fmi_obstacles + 1e-12
    else:
        assert not figures.f1 or math.isnan(figures.f1)
    assert score([total(tallies(rows))]).to_dict() == pytest.approx(figures.to_dict(), nan_ok=True)


def test_totals_are_sums_over_frames():
    case = Case(1, 2.0, True, 0.1, -0.2, 0.5, -0.05)
    one = Tally(frames=1, fmi_sum=0.5, fmi_frames=1, cases=(case,))
    both = total([one, one])
    assert both == Tally(frames=2, fmi_sum=1.0, fmi_frames=2, cases=(case, case))
    assert total([]) == Tally() and both.to_dict()["frames"] == 2
    figures = score([one, Tally(fmi_sum=1.0, fmi_frames=1)])
    assert (figures.nearest_error_m, figures.nearest_bias_m) == (0.05, -0.05)
    assert figures.fmi == 0.75 and figures.width_error_m == pytest.approx(0.2)
    assert set(figures.to_dict()) == set(COUNTS) | set(Score._fields[:-1])
    assert score([Tally(pairs_true=3)]).fmi_pooled == 0 and math.isnan(score([one]).fmi_pooled)


def test_kept_fractions_are_of_measured_pixels_of_floor_and_obstacles():
    ids = np.array([[0, 0, 0, 0, 1, 1, 1, 2]])
    heights = np.array([[0, 0, 0, NAN, 0.03, 0.2, 0.3, 1.0]])
    z = np.array([[1, 1, 0, 1, 1, 1, 1, 1.0]])
    mask = np.array([[1, 0, 1, 1, 1, 1, 0, 1]], bool)
    got = keep_shares(mask, z, ids, heights, np.array([False, True]))
    assert (got.floor_pixels, got.floor_pixels_kept) == (2, 1)
    assert (got.obstacle_pixels, got.obstacle_pixels_kept) == (2, 1)
    assert score([got]).floor_kept == 0.5 == score([got]).obstacle_kept


def test_the_nearest_point_of_an_object_matches_a_hand_calculation():
    """The camera is 1 m up and looks straight down; a pixel is 0.1 times the depth wide."""
    ids, depth = np.zeros((1, 3, 7), int), np.ones((1, 3, 7), np.float16)
    ids[0, 1] = [4, 1, 1, 2, 0, 3, 0]
    depth[0, 1] = [0.5, 0.9, 0.96, 0.97, 1.0, 0.8, 1.0]
    truth = frame_truth()._replace(obstacle_id=ids, depth_m=depth)
    camera = Calibration(Intrinsics(7, 3, 10.0, 10.0, 6.0, 1.0))
    down = np.full(1, math.pi / 2)
    got = nearest_on_floor(truth, camera, np.ones(1), down, np.zeros(1), 0.05)
    # Object 1: its nearer pixel is below the step. Object 2: no pixel is above the step. Object 4:
    # cut by the left edge of the image.
    np.testing.assert_allclose(got, [[0.45, 0.291, 0.08, NAN]], atol=1e-3)
    level = nearest_on_floor(truth, camera, np.ones(1), np.zeros(1), np.zeros(1), 0.05)
    np.testing.assert_allclose(level[0, 0], math.hypot(0.9, 0.45), atol=1e-3)
    # The depth camera is 0.1 m to the left of the colour camera and 0.2 m above it.
    turn = (1.0, 0, 0, 0, 1.0, 0, 0, 0, 1.0)
    apart = Calibration(camera.depth, camera.depth, Extrinsics(turn, (-0.1, 0.0, -0.2)))
    moved = nearest_on_floor(truth, apart, np.ones(1), down, np.zeros(1), 0.05)
    np.testing.assert_allclose(moved, [[0.35, 0.191, 0.02, NAN]], atol=1e-3)
    with pytest.raises(ValueError, match="depth_m"):
        nearest_on_floor(frame_truth(), camera, np.ones(1), down, down, 0.05)


def test_ground_truth_of_a_log_is_read():
    T = np.repeat(np.eye(4)[None], 2, axis=0)
    T[:, :3, :3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]
    T[1, :3, :3] = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]
    T[:, :2, 3] = [[1, 2], [3, -1]]
    local = np.array([[0.5, 2.0], [1.0, 2.0], [1.0, 3.0], [0.5, 3.0]])
    world = to_world(np.broadcast_to(local, (2, 1, 4, 2)), T)
    log = SimpleNamespace(
        T_world_camera=T,
        visible_pixels=np.array([[5], [6]]),
        nearest_m=np.array([[1.0], [2.0]]),
        ground_min=np.array([[[0.5, 2.0]], [[0.6, 2.1]]]),
        ground_max=np.array([[[1.0, 3.0]], [[1.1, 3.1]]]),
        is_wall=np.array([False]),
        height_m=np.array([[0.1], [0.2]]),
        footprint_world=world,
    )
    got = truth_of(log, [1, 0], np.zeros((2, 2, 2), int))
    np.testing.assert_allclose(got.footprint, [[local]] * 2)
    assert got.height_m.tolist() == [[0.2], [0.1]]
    assert got.nearest_forward_m[0, 0] == 2.1 and got.visible_pixels[0, 0] == 6
    camera = Intrinsics(7, 3, 10.0, 10.0, 6.0, 1.0)
    turn = (1.0, 0, 0, 0, 1.0, 0, 0, 0, 1.0)
    apart = Calibration(camera, camera, Extrinsics(turn, (0.1, 0.0, -0.3)))
    moved = truth_of(log, [1, 0], np.zeros((2, 2, 2), int), calibration=apart)
    shift = np.array([-0.1, 0.3])  # the depth camera is to the right and behind
    np.testing.assert_allclose(moved.footprint, [[local + shift]] * 2)
    np.testing.assert_allclose(moved.ground_min, [[[0.5, 2.4]], [[0.4, 2.3]]])
    np.testing.assert_allclose(moved.ground_max, [[[1.0, 3.4]], [[0.9, 3.3]]])
    np.testing.assert_allclose(moved.nearest_forward_m, [[2.4], [2.3]])


def test_quantiles_of_errors_match_a_hand_calculation():
    cases = np.repeat(np.arange(11.0)[:, None], 7, axis=1)
    cases[::2, 3:] *= -1
    figures = errors(cases)
    for name in ("nearest", "position", "width"):
        assert (figures[f"{name}_error_m"], figures[f"{name}_error_p90_m"]) == (5.0, 9.0)
