"""Baselines, compared with results by hand and with other code, and their common scoring."""

import warnings
from dataclasses import fields, replace
from importlib import import_module
from typing import Any

import numpy as np
import pytest

pytest.importorskip("sklearn")
pytest.importorskip("scipy")

from benchmarks.baselines import (
    BASELINES,
    detect_with,
    labels_of,
    points_of,
    prepare,
    run_frames,
    tune,
)
from benchmarks.baselines.dense import range_image
from benchmarks.baselines.frames import color_plane, labels_at, ordered
from benchmarks.paper.shots import Spec, frames_of, shot_of
from benchmarks.tests.boards import (
    BOXES,
    CALIBRATION,
    CONFIG,
    LEVEL,
    board_frame,
    board_picture,
    board_truth,
)
from jaxdet import reference
from jaxdet.config import MAX_POINTS, ClusterConfig
from jaxdet.eval import EvalConfig, score
from jaxdet.presets import preset
from jaxdet.reference.paper._ground import above_floor
from jaxdet.sim import sample_frames
from jaxdet.types import Calibration, Extrinsics, Frames, GroundPlane

PARAMS = {
    "hierarchical_ward": {"distance_m": 3.0},
    "hierarchical_default": {"clusters": 3},
    "rsc": {"tau": 0.4},
    "rsc_member": {"tau": 0.4},
    "rsc_mean": {"tau": 0.4},
    "rsc_count": {"clusters": 3},
    "ddc": {"ratio": 0.1},
}
"""Parameters of baselines whose defaults do not fit three boards."""
LINKAGES = ("scipy_single", "hierarchical_single")


@pytest.fixture(scope="module")
def frame():
    return board_frame()


@pytest.fixture(scope="module")
def truth():
    return board_truth()


def runnable(name):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        reason = BASELINES[name].missing
    if reason:
        pytest.skip(reason)
    return BASELINES[name]


@pytest.mark.parametrize("name", BASELINES)
def test_every_baseline_finds_the_boards(name, frame, truth):
    baseline = runnable(name)
    params = PARAMS.get(name, {})
    tallies = run_frames(baseline, [frame], [truth], params)
    figures = score(tallies)
    assert figures.recall == 1 and figures.precision == 1
    assert figures.position_error_m < 0.01
    found = detect_with(baseline, frame, CONFIG, params)
    assert found.points.labels.labels.dtype == np.int32 and found.num_obstacles.tolist() == [3]
    assert found.points.labels.labels[0, 0] in (0, 1, 2)
    few = replace(CONFIG, cluster=replace(CONFIG.cluster, min_points=MAX_POINTS))
    assert detect_with(baseline, frame, few, params).num_obstacles.tolist() == [0]


@pytest.mark.parametrize("name", BASELINES)
def test_every_baseline_runs_with_few_points(name, frame):
    baseline = runnable(name)
    for count in (0, 1, 2, 3, 11):
        kept = frame.features.kept & (np.arange(frame.features.kept.shape[1]) < count)
        few = frame._replace(features=frame.features._replace(kept=kept))
        found = detect_with(baseline, few, CONFIG)
        assert (found.points.labels.labels[~kept] == -1).all()


def test_baselines_have_titles_citations_and_grids_of_their_parameters():
    for name, baseline in BASELINES.items():
        assert baseline.name == name and baseline.citation and baseline.title
        known = {"depth_scale", *baseline.defaults, *(f.name for f in fields(ClusterConfig))}
        assert set(baseline.grid) <= known
        assert 5 <= len(baseline.trials()) <= 60 or name == "hierarchical_default"


def test_the_baseline_of_the_papers_rule_equals_the_reference(frame):
    rule = preset("paper")
    found = detect_with(BASELINES["paper"], frame, rule)
    expected = reference.paper.cluster(frame.features, 0.001, rule)
    np.testing.assert_array_equal(found.points.labels.labels, expected.labels)
    outlines = reference.paper.footprint(frame.features, expected, LEVEL, 0.001, rule)
    for ours, theirs in zip(found.obstacles, outlines, strict=True):
        np.testing.assert_array_equal(ours[:, :3], theirs[:, :3])
        assert not ours[:, 3:].any()


def test_single_linkages_of_both_libraries_give_the_same_clusters(frame):
    gap = {"distance_m": 0.07}
    one, two = (detect_with(BASELINES[k], frame, CONFIG, gap) for k in LINKAGES)
    np.testing.assert_array_equal(one.points.labels.labels, two.points.labels.labels)
    scaled = labels_of(BASELINES["scipy_single"], frame, CONFIG, {**gap, "depth_scale": 2.0})
    stretched = BASELINES["scipy_single"].run(points_of(frame) * [1, 2], **gap)
    np.testing.assert_array_equal(scaled, stretched)


def test_order_and_minimum_size_of_clusters():
    labels, z = np.array([4, 4, 2, 2, 2, 9, -1]), np.array([5, 3, 1, 9, 9, 0, 0])
    assert ordered(labels, z, z, 1).tolist() == [1, 1, 0, 0, 0, -1, -1]
    assert ordered(labels, z, z, 2).tolist() == [-1, -1, 0, 0, 0, -1, -1]


# --- Dense methods ---


def test_range_image_by_hand(frame):
    labels = range_image(frame, 10.0)
    assert (labels[~frame.keep] == -1).all()
    names = [np.unique(labels[22:78, left + 2 : right - 2]) for left, right, _ in BOXES]
    assert all(len(n) == 1 for n in names) and len({int(n[0]) for n in names}) == 3
    # An oblique wall whose depth grows by 8 mm per pixel: beta is 50 degrees at 1.2 m.
    slope = (1200 + 8 * np.arange(160)).astype(np.uint16)
    wall = frame._replace(z=np.tile(slope, (120, 1)), keep=np.ones((120, 160), bool))
    assert len(np.unique(range_image(wall, 30.0))) == 1
    assert len(np.unique(range_image(wall, 80.0))) > 100


def test_a_feature_takes_the_nearest_label_within_the_tolerance():
    image = np.full((5, 5), -1, np.int32)
    image[2, 2], image[2, 4] = 7, 8
    u, v = np.array([0, 3, 4, 0]), np.array([2, 2, 1, 0])
    assert labels_at(image, u, v).tolist() == [7, 7, 8, 7]
    assert labels_at(image, u, v, 1).tolist() == [-1, 7, 8, -1]


# --- Tuning and preprocessing ---


def test_tuning_chooses_the_best_value_of_the_grid(frame, truth):
    baseline = replace(BASELINES["scipy_single"], grid={"distance_m": (0.01, 0.2, 0.3, 9.0)})
    how = CONFIG, EvalConfig()
    best = tune(baseline, [frame], [truth], lambda figures: figures.f1, *how)
    assert best.params == {"distance_m": 0.2} and best.value == 1
    assert [value for _, value in best.trials[:4]] == [
        pytest.approx(v, nan_ok=True) for v in (0, 1, 1, 0)
    ]
    worst = tune(baseline, [frame], [truth], lambda figures: -figures.f1, *how)
    assert worst.params == {"distance_m": 0.01}


def test_tuning_searches_outside_of_the_grid(monkeypatch):
    """The best value of one parameter is outside of its grid, that of the other between values."""
    tuning = import_module("benchmarks.baselines.tune")
    monkeypatch.setattr(tuning, "run_frames", lambda *given: given[3])
    monkeypatch.setattr(tuning, "score", lambda params: params)

    def objective(params: Any) -> float:
        distance, samples = np.log(params["eps_m"] / 7), params["min_samples"] - 4
        return -abs(distance) - samples**2 - abs(params["depth_scale"] - 6)

    how = CONFIG, EvalConfig()
    best = tune(BASELINES["dbscan"], [], [], objective, *how).params
    assert 7 / 1.25 < best["eps_m"] < 7 * 1.25
    assert best["min_samples"] in (3, 4, 5) and best["depth_scale"] == 6.0
    choices = tune(BASELINES["hdbscan"], [], [], lambda params: params["single"], *how)
    assert choices.params["single"] is True


def test_prepared_frames_equal_the_stages_of_the_reference():
    depth, _ = board_picture()
    rng = np.random.default_rng(1)
    color = rng.integers(0, 255, (2, 120, 160, 3), np.uint8)
    zeros = np.zeros(2, np.int64)
    plane = GroundPlane(*(np.repeat(a, 2) for a in LEVEL))
    valid = np.array([True, False])
    frames = Frames(
        np.stack([depth, depth]), CALIBRATION, zeros, zeros, valid, color=color, plane=plane
    )
    prepared = prepare(frames)
    assert len(prepared) == 1
    aligned = reference.paper.align(frames.depth, CALIBRATION)
    keep = above_floor(aligned.z, plane, CALIBRATION, CONFIG)
    corners, found = CONFIG.features.max_corners, prepared[0].features
    u, v, valid = (a[0, :corners] for a in (found.u, found.v, found.valid))
    assert valid.sum() > 50 and keep[0, v[valid], u[valid]].all()
    np.testing.assert_array_equal(found.z[0, :corners][valid], aligned.z[0, v[valid], u[valid]])
    np.testing.assert_array_equal(prepared[0].keep, keep[0])
    n = int(found.kept[0].sum())
    assert points_of(prepared[0]).shape == (n, 2) and points_of(prepared[0], "xyz").shape == (n, 3)

    # Every second pixel of 160 columns, row by row.
    u, v, x, y, z = (a[0, corners:] for a in found[:5])
    assert u[:81].tolist() == [*range(1, 160, 2), 1] and v[79:81].tolist() == [1, 3]
    np.testing.assert_array_equal(found.kept[0, corners:], keep[0, 1::2, 1::2].ravel())
    on_grid = np.where(keep[0], depth, 0)[1::2, 1::2].ravel()
    np.testing.assert_array_equal(z, on_grid)
    for place, pixel, centre in ((x, u, 79.5), (y, v, 59.5)):
        assert np.abs(place - (pixel - centre) / 120 * z).max() <= 1

    flags = replace(
        CONFIG, ground=replace(CONFIG.ground, camera_height_m=1.0, camera_pitch_rad=0.0)
    )
    again = prepare(frames._replace(plane=None), flags)
    np.testing.assert_array_equal(again[0].keep, prepared[0].keep)
    none = replace(CONFIG, ground=replace(CONFIG.ground, source="none"))
    assert not prepare(frames._replace(plane=None), none)[0].plane.valid[0]


def test_each_frame_corrects_its_floor():
    (frame,) = sample_frames("mixed", 3, 1, width=320, height=240)
    shot = shot_of(Spec("mixed", 3, 1), frame)
    height, pitch, roll = shot.mount
    frames = frames_of([shot._replace(mount=(height, pitch + np.radians(2), roll))])
    (prepared,) = prepare(frames)
    want = reference.find_floors(frames, frames.plane, CONFIG)
    plane = color_plane(want.plane, frames.calibration)
    assert want.own[0] and prepared.plane == plane
    assert abs(want.plane.pitch[0] - pitch) < np.radians(1)
    aligned = reference.paper.align(frames.depth, frames.calibration)
    keep = above_floor(aligned.z, plane, frames.calibration, CONFIG)
    np.testing.assert_array_equal(prepared.keep, keep[0])


def test_ramps_begin_at_the_same_place_for_both_cameras():
    """The colour camera is 0.2 m ahead of a level depth camera and 0.1 m above it."""
    color_from_depth = Extrinsics((1, 0, 0, 0, 1, 0, 0, 0, 1), (0.0, 0.1, -0.2))
    camera = CALIBRATION.depth
    calibration = Calibration(camera, camera, color_from_depth)
    ramp = LEVEL._replace(ramp_start=np.array([1.5]), ramp_slope=np.array([0.1]))
    moved = color_plane(ramp, calibration)
    np.testing.assert_allclose(moved.height, 1.1)
    np.testing.assert_allclose(moved.ramp_start, 1.3)
    assert moved.ramp_slope == ramp.ramp_slope
    assert color_plane(ramp, CALIBRATION) == ramp


def test_a_missing_module_is_named():
    lost = replace(BASELINES["dbscan"], needs=("no_such_module",))
    assert "no_such_module" in str(lost.missing)
    assert BASELINES["dbscan"].missing is None
