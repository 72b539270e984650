"""Scores by hand: three objects on a 40 x 60 picture, and a wall."""

import math

import numpy as np
import pytest

from jaxdet.eval import EvalConfig, FrameTruth, Tally, evaluate, score
from jaxdet.types import Detections, Features, Labels, Obstacles

PIXELS = [(5, 15), (25, 35), (45, 55)]
"""Columns of the three objects, rows 10-30; the wall is rows 0-3."""


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


def detections(points, forward_mm):
    """One frame: ``points`` (u, v, label), ``forward_mm`` of each detection's point C."""
    u, v, labels = (np.array([column], np.int32) for column in zip(*points, strict=True))
    used = np.ones(u.shape, bool)
    features = Features(u, v, u, v, v, used, used, np.zeros(1, bool))
    c = np.zeros((1, len(forward_mm) + 3, 2), np.int32)
    c[0, : len(forward_mm), 1] = forward_mm
    obstacles = Obstacles(*[None] * 8, c, None)
    count = np.array([len(forward_mm)], np.int32)
    return Detections(features, Labels(labels, count), obstacles, np.ones(1, bool))


def on(number, label, count=3):
    left = PIXELS[number - 1][0]
    return [(left + i, 20, label) for i in range(count)]


def test_all_found():
    points = on(1, 0) + on(2, 1) + on(3, 2) + [(0, 39, -1)]
    tally = evaluate(detections(points, [1100, 2090, 3130]), truth())
    assert tally[:9] == (1, 3, 3, 3, 3, 0, 0, 0, 0)
    np.testing.assert_allclose(tally.position_errors, [0.0, 0.01, 0.03], atol=1e-9)
    figures = score([tally, tally])
    assert figures.recall == figures.precision == figures.f1 == 1
    assert figures.position_error_m == pytest.approx(0.01)
    assert figures.tally.frames == 2


def test_floor_wall_split_merge():
    floor = [(20, 37, 0), (21, 37, 0), (22, 37, 0)]
    wall = [(30, 1, 1), (31, 1, 1)]
    split = [*on(1, 2, 2), (10, 25, 3), (11, 25, 3)]
    merged = on(2, 4, 3) + on(3, 4, 2)
    got = evaluate(detections(floor + wall + split + merged, [0, 0, 1200, 1300, 2100]), truth())
    assert got[:9] == (1, 3, 2, 5, 3, 1, 1, 1, 1)
    figures = score([got])
    assert figures.recall == pytest.approx(2 / 3) and figures.precision == pytest.approx(3 / 4)


def test_tolerance():
    beside = [(3, 20, 0), (15 + 1, 20, 0), (10, 31, 0)]
    assert evaluate(detections(beside, [1000]), truth()).found == 1
    strict = EvalConfig(tolerance_px=1)
    assert evaluate(detections(beside, [1000]), truth(), config=strict).on_floor == 1
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
    ],
)
def test_what_is_asked_for(change, visible):
    assert evaluate(detections(on(1, 0), [1100]), truth(**change)).visible == visible


def test_nothing():
    none = evaluate(detections([(0, 0, -1)], []), truth())
    assert none[:4] == (1, 3, 0, 0) and score([none]).recall == 0
    assert math.isnan(score([none]).precision) and math.isnan(score([]).position_error_m)
    padding = evaluate(detections(on(1, 0), [1]), truth(), valid=np.zeros(1, bool))
    assert padding == Tally()
    with pytest.raises(ValueError, match="1 frames"):
        evaluate(detections(on(1, 0), [1]), truth(obstacle_id=np.zeros((2, 40, 60), int)))


def test_units():
    tally = evaluate(detections(on(1, 0), [11000]), truth(), depth_unit=0.0001)
    assert tally.position_errors[0] == pytest.approx(0)
