"""Evaluation of an image of 40 x 60 pixels, compared with values computed by hand.

The image shows three objects and a wall.
"""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxdet.config import FootprintConfig
from jaxdet.eval import EvalConfig, FrameTruth, Tally, evaluate, evaluate_frames, score
from jaxdet.eval.frame import objects_of
from jaxdet.types import (
    Calibration,
    CellLabels,
    Cells,
    Detections,
    Extrinsics,
    Features,
    Intrinsics,
    Labels,
    Obstacles,
    Points,
)

CAMERA = Intrinsics(60, 40, 50.0, 50.0, 30.0, 20.0)
PIXELS = [(5, 15), (25, 35), (45, 55)]
"""First column and end of each of the three objects, in rows 10-30; the wall is in rows 0-3."""


def picture():
    ids = np.zeros((40, 60), np.uint8)
    ids[:4] = 4
    for number, (left, right) in enumerate(PIXELS, 1):
        ids[10:30, left:right] = number
    return ids


def truth(**changes):
    values = FrameTruth(
        picture()[None],
        np.array([[500, 500, 500, 240]]),
        np.array([[1.0, 2.0, 3.0, 8.0]]),
        np.array([[1.1, 2.1, 3.1, 8.1]]),
        np.array([False, False, False, True]),
    )
    return values._replace(**changes)


def detections(points, forward_mm, **outline):
    """Return detections of a frame from points (u, v, label) and forward distances of C [mm]."""
    u, v, labels = (np.array([column], np.int32) for column in zip(*points, strict=True))
    used = np.ones(u.shape, bool)
    features = Features(u, v, u, v, v, used, used, np.zeros(1, bool))
    c = np.zeros((1, len(forward_mm) + 3, 2), np.int32)
    c[0, : len(forward_mm), 1] = forward_mm
    obstacles = Obstacles(*[None] * 8, c, *[None] * 3)._replace(**outline)
    count, no = np.array([len(forward_mm)], np.int32), np.zeros(1, bool)
    corners = Points(features, Labels(labels, count))
    return Detections(count, no, ~no, obstacles, points=corners)


def on(number, label, count=3):
    left = PIXELS[number - 1][0]
    return [(left + i, 20, label) for i in range(count)]


def position_errors(tally):
    return [abs(case.position_error_m) for case in tally.cases if case.found]


def counted(tally):
    names = ("visible", "found", "detections", "matched", "false", "ignored")
    return tuple(getattr(tally, name) for name in names)


def test_three_detected_objects_are_three_matches():
    points = on(1, 0) + on(2, 1) + on(3, 2) + [(0, 39, -1)]
    tally = evaluate(detections(points, [1100, 2090, 3130]), truth())
    assert counted(tally) == (3, 3, 3, 3, 0, 0) and tally.frames == 1
    np.testing.assert_allclose(position_errors(tally), [0.0, 0.01, 0.03], atol=1e-9)
    assert [case.number for case in tally.cases] == [1, 2, 3]
    assert (tally.points, tally.points_right) == (10, 10)
    assert (tally.pairs_both, tally.pairs_detected, tally.pairs_true) == (9, 9, 9)
    figures = score([tally, tally])
    ones = ("recall", "precision", "f1", "accuracy", "fmi", "fmi_pooled", "point_accuracy")
    assert all(getattr(figures, name) == 1 for name in ones)
    assert figures.position_error_m == pytest.approx(0.01)
    assert figures.tally.frames == 2


def test_a_feature_belongs_to_the_object_at_its_depth():
    """Object 1 is at 1 m, the floor at 5 m; depth is smeared by up to 4 pixels."""
    depth = np.full((1, 40, 60), 5.0)
    depth[:, 10:30, 5:15] = 1.0
    known = truth(depth_m=depth)
    depth[:, 10:30, 18:] = 1.1
    # Features on object 1; next to it at its depth; too far from it; on the floor next to it at a
    # depth near both; on the object, and on the floor, at a depth that no surface there has.
    columns = [(10, 1000), (17, 1010), (19, 500), (18, 1050), (10, 3000), (17, 3000)]
    u, z = (np.array(values, np.int32) for values in zip(*columns, strict=True))
    v, used = np.full_like(u, 20), np.ones(u.shape, bool)
    features = Features(u, v, u, v, z, used, used, np.zeros(1, bool))
    assert objects_of(features, known, 0, 0.001, EvalConfig()).tolist() == [1, 1, 0, 0, 1, 0]
    assert objects_of(features, truth(), 0, 0.001, EvalConfig()).tolist() == [1, 0, 0, 0, 1, 0]


def cells(label, z, count):
    """Return detections of a frame whose cells have these labels and depths ``(R, C)`` [mm]."""
    label, z = (np.array(a, np.int32)[None] for a in (label, z))
    forward = [1000] * count
    grid = Cells(np.zeros_like(z), np.zeros_like(z), z)
    found = detections(on(1, 0), forward)._replace(points=None)
    return found._replace(cells=CellLabels(label, z > 0, grid))


def test_cells_vote_for_the_object_in_their_box():
    """With cells of 10 pixels, object 1 is in the first column and half of the second."""
    label = np.full((4, 6), -1)
    label[1:3, 0], label[1:3, 4] = 0, 1
    found = cells(label, np.full((4, 6), 1000), 2)
    got = evaluate(found, truth(), Calibration(CAMERA), side=10)
    assert counted(got) == (3, 2, 2, 2, 0, 0)
    with pytest.raises(ValueError, match="side"):
        evaluate(found, truth(), Calibration(CAMERA))


def test_cells_are_transformed_to_the_colour_camera():
    """The transform shifts pixels by 20, the width of an object, to the right at 1 m."""
    label = np.full((4, 6), -1)
    label[1:3, 0], label[1:3, 5] = 0, 1
    motion = Extrinsics((1.0, 0, 0, 0, 1.0, 0, 0, 0, 1.0), (0.4, 0.0, 0.0))
    calibration = Calibration(CAMERA, CAMERA, motion)
    got = evaluate(cells(label, np.full((4, 6), 1000), 2), truth(), calibration, side=10)
    # Detection 1 is outside of the colour image: it is ignored.
    assert counted(got) == (3, 1, 2, 1, 0, 1)


def test_detections_of_the_floor_are_false_and_splits_and_merges_are_counted():
    floor = [(20, 37, 0), (21, 37, 0), (22, 37, 0)]
    wall = [(30, 1, 1), (31, 1, 1)]
    split = [*on(1, 2, 3), (10, 25, 3), (11, 25, 3)]
    merged = on(2, 4, 3) + on(3, 4, 2)
    got = evaluate(detections(floor + wall + split + merged, [0, 0, 1200, 1300, 2100]), truth())
    assert counted(got) == (3, 2, 5, 2, 2, 1)
    assert (got.on_floor, got.on_wall, got.splits, got.merges) == (1, 1, 1, 1)
    assert (got.points, got.points_right) == (13, 6)
    # Detections have 3 (floor), 3, 2 and 5 points; objects have 5, 3 and 2 points.
    assert (got.pairs_both, got.pairs_detected, got.pairs_true) == (3 + 1 + 3 + 1, 17, 14)
    figures = score([got])
    assert figures.recall == pytest.approx(2 / 3) and figures.precision == pytest.approx(1 / 2)
    assert figures.accuracy == pytest.approx(2 / 5) and figures.f1 == pytest.approx(4 / 7)
    assert figures.fmi_obstacles == pytest.approx(math.sqrt(1 / 3))


def test_half_of_the_points_of_a_match_must_be_on_the_obstacle():
    nearby = [(0, 35, 0), (0, 36, 0)]
    assert evaluate(detections(on(1, 0, 2) + nearby, [1000]), truth()).found == 1
    got = evaluate(detections(on(1, 0, 2) + [*nearby, (0, 37, 0)], [1000]), truth())
    assert counted(got) == (3, 0, 1, 0, 1, 0) and got.on_floor == 1 and got.splits == 0
    loose = EvalConfig(match_share=0.4)
    points = on(1, 0, 2) + [*nearby, (0, 37, 0)]
    assert evaluate(detections(points, [1000]), truth(), config=loose).found == 1


def test_detections_of_objects_that_are_not_required_are_ignored():
    far = truth(nearest_m=np.array([[5.0, 2.0, 3.0, 8.0]]))
    points = on(1, 0) + [(10, 25, 1), (11, 25, 1)] + on(2, 2)
    got = evaluate(detections(points, [1000, 1000, 2000]), far)
    assert counted(got) == (2, 1, 3, 2, 0, 2)
    low = truth(height_m=np.array([[0.04, 0.5, 0.5, 2.0]]))
    assert evaluate(detections(points, [1000, 1000, 2000]), low).ignored == 2


def test_detections_on_ignored_objects_may_be_matches_or_ignored():
    """Half of a detection is on an ignored object.

    If the other half is on a required object, the detection is a match; if the other half is on the
    floor, the detection is ignored.
    """
    far = truth(nearest_m=np.array([[1.0, 5.0, 3.0, 8.0]]))
    got = evaluate(detections(on(1, 0) + on(2, 0), [1100]), far)
    assert counted(got) == (2, 1, 1, 1, 0, 0)
    wall, floor = [(30, 1, 0), (31, 1, 0)], [(20, 37, 0), (21, 37, 0)]
    got = evaluate(detections(wall + floor, [1000]), truth())
    assert (got.on_wall, got.false, got.on_floor) == (1, 0, 0)


def test_features_next_to_an_object_count_within_the_tolerance():
    nearby = [(3, 20, 0), (15 + 1, 20, 0), (10, 31, 0)]
    assert evaluate(detections(nearby, [1000]), truth()).found == 1
    strict = EvalConfig(tolerance_px=1)
    assert evaluate(detections(nearby, [1000]), truth(), config=strict).on_floor == 1
    near_wall = truth()
    near_wall.obstacle_id[0, 4:9] = 4
    corner = [(7, 8, 0), (8, 9, 0)]
    assert evaluate(detections(corner, [1000]), near_wall).matched == 1


@pytest.mark.parametrize(
    ("change", "visible"),
    [
        ({"visible_pixels": np.array([[399, 400, 401, 999]])}, 2),
        ({"nearest_m": np.array([[0.14, 4.0, 4.01, 1.0]])}, 1),
        ({"nearest_m": np.array([[np.nan, 1.0, 1.0, 1.0]])}, 2),
        ({"is_wall": np.array([True, True, True, True])}, 0),
        ({"height_m": np.array([[0.05, 0.06, 0.02, 1.0]])}, 1),
    ],
)
def test_objects_are_required_by_visibility_distance_kind_and_height(change, visible):
    assert evaluate(detections(on(1, 0), [1100]), truth(**change)).visible == visible


def test_empty_frames_have_no_matches():
    none = evaluate(detections([(0, 0, -1)], []), truth())
    assert counted(none) == (3, 0, 0, 0, 0, 0) and score([none]).recall == 0
    assert math.isnan(score([none]).precision) and math.isnan(score([]).position_error_m)
    assert score([none]).accuracy == 0 and math.isnan(score([]).accuracy)
    padding = evaluate(detections(on(1, 0), [1]), truth(), valid=np.zeros(1, bool))
    assert padding == Tally()
    with pytest.raises(ValueError, match="1 frames"):
        evaluate(detections(on(1, 0), [1]), truth(obstacle_id=np.zeros((2, 40, 60), int)))


def test_position_errors_are_in_metres():
    tally = evaluate(detections(on(1, 0), [11000]), truth(), Calibration(CAMERA, depth_unit=0.0001))
    assert position_errors(tally)[0] == pytest.approx(0)


def box(left, right, near, far):
    return [[left, near], [right, near], [right, far], [left, far]]


def test_shape_errors_match_a_hand_calculation():
    """Object 1 is the square [0, 1] x [1, 2], detected as the rectangle [0, 0.8] x [1, 1.5]."""
    low = np.array([[[0, 1], [np.nan, np.nan], [np.nan, np.nan], [9, 9]]])
    high = np.array([[[1, 1], [np.nan, np.nan], [np.nan, np.nan], [9, 9]]])
    footprint = np.full((1, 4, 16, 2), np.nan)
    footprint[0, 0, :4] = box(0, 1, 1, 2)
    where = truth(
        ground_min=low,
        ground_max=high,
        footprint=footprint,
        visible_pixels=np.array([[500, 0, 0, 240]]),
        nearest_forward_m=np.array([[1.0, np.nan, np.nan, 8.1]]),
        nearest_floor_m=np.array([[1.1, np.nan, np.nan, 8.1]]),
    )
    a, b = np.zeros((1, 4, 2), int), np.zeros((1, 4, 2), int)
    a[0, 0], b[0, 0] = (0, 1000), (800, 1000)
    outline = {"a": a, "b": b, "has_vertex": np.zeros((1, 4), bool), "xyz_min": np.zeros((1, 4, 3))}
    outline |= {"direction": np.zeros((1, 4, 2)), "span": np.zeros((1, 4, 4))}
    # A is the nearest point.
    outline["nearest"] = np.stack(np.divmod((a**2).sum(-1), 1 << 18), axis=-1)
    found = detections(on(1, 0), [1000], **outline)
    config = EvalConfig(
        footprint=FootprintConfig(extension_m=0.5, margin_per_m2=0.0),
        coverage_margin_m=0.005,
    )
    got = evaluate(found, where, config=config)
    # Points every centimetre from 0 to 1; the last one covered is at 0.80.
    assert (got.near_points, got.near_covered, got.near_asked, got.near_safe) == (101, 81, 101, 81)
    case = got.cases[0]
    assert case.width_error_m == pytest.approx(-0.2) and case.position_error_m == 0
    assert case.iou == pytest.approx(0.4)
    assert case.nearest_error_m == pytest.approx(-0.1)  # error of A
    short = EvalConfig(footprint=config.footprint, coverage_range_m=1.2)
    assert evaluate(found, where, config=short).near_points == round(math.sqrt(0.44) * 100) + 1
    hidden = where._replace(nearest_forward_m=np.array([[1.1, np.nan, np.nan, 8.1]]))
    assert evaluate(found, hidden, config=config).near_points == 0
    missed = detections([(0, 39, -1)], [], **{name: part[:, 1:] for name, part in outline.items()})
    got = evaluate(missed, where, config=config)
    assert (got.near_points, got.near_asked, got.near_safe) == (0, 101, 0)
    assert score([got]).safe_coverage == 0 and math.isnan(score([got]).coverage)


def test_internal_indices_match_a_hand_calculation():
    points = on(1, 0) + on(2, 1)
    config = EvalConfig(indices=True)
    got = evaluate_frames(detections(points, [1, 2]), truth(), config=config)[0]
    assert got.index_frames == 1 and 0.8 < got.silhouette_sum < 1
    single = evaluate(detections(on(1, 0), [1]), truth(), config=config)
    assert single.index_frames == 0 and math.isnan(score([single]).silhouette)


points_anywhere = st.lists(
    st.tuples(st.integers(0, 59), st.integers(0, 39), st.integers(-1, 3)), min_size=1, max_size=30
)


@given(points_anywhere, st.randoms(use_true_random=False))
def test_order_of_points_and_labels_does_not_change_the_counts(points, random):
    """Counts do not depend on the order of points. Labels matter only for ties."""
    forward = [1000, 2000, 2500, 3000]
    one = evaluate(detections(points, forward), truth())
    shuffled = random.sample(points, len(points))
    assert evaluate(detections(shuffled, forward), truth()) == one
    turned = [(u, v, label if label < 0 else 3 - label) for u, v, label in points]
    other = evaluate(detections(turned, forward[::-1]), truth())
    # Of two equally good detections, either one may be the false positive.
    same = ("found", "matched", "visible", "points_right", "pairs_both", "pairs_true", "merges")
    assert all(getattr(other, name) == getattr(one, name) for name in same)
    assert one.found + one.false + one.ignored == one.detections == 4
    assert one.matched == one.found <= one.visible == len(one.cases) == 3
    # If half of the points are on the floor and half on an obstacle, both are counted.
    assert max(one.on_floor, one.splits) <= one.false and one.on_wall <= one.ignored
    assert one.points_right <= one.points <= len(points)
    assert one.pairs_both <= min(one.pairs_detected, one.pairs_true)


@given(st.lists(st.tuples(st.integers(0, 59), st.integers(0, 39)), min_size=1, max_size=30))
def test_ground_truth_as_detections_has_no_errors(pixels):
    """Labels taken from the image itself have neither misses nor false positives."""
    ids = picture()
    points = [(u, v, int(ids[v, u]) - 1) for u, v in pixels if ids[v, u] != 4]
    strict = EvalConfig(tolerance_px=0)
    if points:
        tally = evaluate(detections(points, [1000, 2000, 3000]), truth(), config=strict)
        assert tally.found == len({label for *_, label in points if label >= 0})
        assert tally.points_right == tally.points == len(points)
        assert tally.pairs_both == tally.pairs_detected == tally.pairs_true
