"""Outlines on the floor: contours, their straight parts, and fitted rectangles."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from jaxdet.config import FootprintConfig
from jaxdet.floor.plane import DIRECTION_BITS
from jaxdet.presets import PRESETS
from jaxdet.reference._outlines import (
    contours,
    fitted_direction,
    fitted_span,
    inner,
    straight_parts,
)
from jaxdet.results import metric
from jaxdet.types import MAX_CONTOUR, Obstacles

LONG = 1500
FITTED = FootprintConfig(margin_per_m2=0.0)


def turned(points: np.ndarray, degrees: float, to: tuple[float, float] = (0, 0)) -> np.ndarray:
    """Rotate points counter-clockwise, then move them, in integer units."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.rint(points @ np.array([[c, s], [-s, c]]) + to).astype(np.int64)


def corner(wide: int, deep: int, step: int = 20) -> np.ndarray:
    """Return the two visible sides of a box, from left to right."""
    side = [(0, y) for y in range(deep, 0, -step)]
    return np.array(side + [(x, 0) for x in range(0, wide + 1, step)])


def degrees_of(direction: np.ndarray) -> float:
    return float(np.degrees(np.arctan2(direction[1], direction[0])))


def lengths(span: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Return the lengths of a span along and across its direction, in the unit of the points."""
    return (span[1::2] - span[::2]) / np.linalg.norm(direction)


def fitted(direction: np.ndarray, span: np.ndarray) -> Obstacles:
    """Return an obstacle whose outline has this direction and span."""
    pair, point = np.zeros((1, 1, 2), np.int32), np.zeros((1, 1, 3), np.int32)
    count, vertex = np.ones((1, 1), np.int32), np.zeros((1, 1), bool)
    outline = direction[None, None].astype(np.int32), span[None, None].astype(np.int32)
    return Obstacles(count, pair, pair, point, point, point, pair, pair, pair, vertex, *outline)


def span_of(points: np.ndarray, direction: np.ndarray, long: int = LONG) -> np.ndarray:
    """Return the span of cells that are all reliable."""
    return fitted_span(points, direction, long, np.ones(len(points), bool))


def rectangle(points: np.ndarray) -> np.ndarray:
    """Return the fitted rectangle of an object with these visible points, ``(4, 2)``."""
    direction = fitted_direction(points)
    span = span_of(points, direction)
    return metric.rectangles(fitted(direction, span), 1.0, FITTED)[0, 0]


# by hand


def test_contour_is_the_nearest_cell_of_each_column() -> None:
    label = np.array([[-1, 0, 0, 1], [0, 0, 1, 1], [-1, 0, -1, 1]])
    right = np.array([[0, -3, 4, 30], [-9, -4, 3, 31], [0, -5, 0, 32]])
    forward = np.array([[0, 80, 70, 50], [60, 70, 40, 40], [0, 75, 0, 60]])
    points, count = contours(label, right, forward, 3)
    assert count.tolist() == [3, 2, 0]
    assert points[0, :3].tolist() == [[-9, 60], [-4, 70], [4, 70]]
    assert points[1, :2].tolist() == [[3, 40], [31, 40]]
    assert not points[0, 3:].any() and not points[2].any()
    assert points.shape == (3, 4, 2) and points.dtype == np.int32


def test_contours_are_limited_to_the_number_of_slots() -> None:
    label = np.array([[0, 1, 2]])
    points, count = contours(label, label, label + 5, 2)
    assert count.tolist() == [1, 1] and points[:, 0].tolist() == [[0, 5], [1, 6]]
    wide = np.zeros((2, MAX_CONTOUR), np.int64)
    x = np.broadcast_to(np.arange(wide.shape[1]), wide.shape)
    points, count = contours(wide, x, wide + 100, 1)
    assert count.tolist() == [MAX_CONTOUR]
    np.testing.assert_array_equal(points[0, :, 0], np.arange(MAX_CONTOUR))
    _, none = contours(wide - 1, wide, wide, 4)
    assert none.tolist() == [0, 0, 0, 0]


def test_a_straight_contour_is_not_split() -> None:
    wall = np.array([(x, 2000 + x // 4) for x in range(-800, 800, 50)])
    assert straight_parts(wall, 150, 400, 400) == [0]
    assert straight_parts(wall[:1], 150, 400, 400) == [0]
    assert straight_parts(wall[:0], 150, 400, 400) == [0]


def test_an_inner_corner_splits_a_contour_and_an_outer_corner_does_not() -> None:
    room = [(-800, y) for y in range(1000, 3000, 100)] + [(x, 3000) for x in range(-800, 800, 100)]
    assert straight_parts(np.array(room), 150, 400, 400) == [0, 20]
    box = corner(1000, 1200, 50) @ np.array([[1, -1], [1, 1]]) + (0, 2000)
    assert straight_parts(box, 150, 400, 400) == [0]


def test_the_contour_of_a_corridor_is_split_into_three_parts() -> None:
    left = [(-700, y) for y in range(800, 4000, 100)]
    across = [(x, 4000) for x in range(-700, 700, 100)]
    right = [(700, y) for y in range(4000, 800, -100)]
    assert straight_parts(np.array(left + across + right), 150, 400, 400) == [0, 32, 46]


def test_contours_are_not_split_at_small_bends_or_into_short_sides() -> None:
    dent = np.array([(x, 2000 + (140 if 0 <= x < 400 else 0)) for x in range(-800, 800, 50)])
    assert straight_parts(dent, 150, 300, 400) == [0]
    niche = [(-200, y) for y in range(1800, 2100, 50)] + [(x, 2100) for x in range(-200, 200, 50)]
    assert straight_parts(np.array(niche), 50, 600, 400) == [0]
    assert len(straight_parts(np.array(niche), 50, 200, 400)) == 2


def test_contours_are_split_at_bends_above_the_threshold() -> None:
    """A bend of 150 is within the threshold of 150, a bend of 151 is not."""
    for deep, parts in ((150, [0]), (151, [0, 10])):
        t = np.arange(21) * 50
        line = np.stack([t, deep - np.abs(t - 500) * deep // 500], axis=1)
        line = line @ np.array([[4, 3], [-3, 4]]) + (0, 10000)
        assert straight_parts(line, 5 * 150, 400, 10**6) == parts


def test_contours_with_large_coordinates_are_split_like_small_ones() -> None:
    """Lengths and products of the full 16-bit range fit in 64 bits."""
    room = [(-800, y) for y in range(1000, 3000, 100)] + [(x, 3000) for x in range(-800, 800, 100)]
    far = np.array(room, np.int32) * 40
    assert straight_parts(far, 150 * 40, 400 * 40, 400 * 40) == [0, 20]


def test_a_jump_is_a_corner_only_when_it_is_deep() -> None:
    """An object is visible between the legs of a table."""
    legs = [(x, 2000) for x in range(-500, 0, 50)] + [(x, 2400) for x in range(0, 500, 50)]
    legs += [(x, 2000) for x in range(500, 1000, 50)]
    assert straight_parts(np.array(legs), 150, 400, 200) == [0]
    assert len(straight_parts(np.array(legs), 90, 400, 200)) > 1
    assert len(straight_parts(np.array(legs), 150, 400, 500)) > 1


def test_fitted_directions_of_lines_and_single_points_match_a_hand_calculation() -> None:
    one = 1 << DIRECTION_BITS
    assert fitted_direction(np.array([[700, 900]])).tolist() == [one, 0]
    flat = np.stack([np.arange(-300, 300, 20), np.full(30, 1200)], axis=1)
    assert fitted_direction(flat).tolist() == [one, 0]
    assert fitted_direction(flat[:, ::-1]).tolist() == [one, 0]
    assert degrees_of(fitted_direction(turned(flat, 30))) == pytest.approx(30, abs=0.1)


def test_the_span_of_an_obstacle_matches_a_hand_calculation() -> None:
    points = np.array([[3, 9], [-2, 5], [1, 7]])
    assert span_of(points, np.array([1, 0]), LONG).tolist() == [-2, 3, 5, 9]
    assert span_of(points, np.array([3, 4]), LONG).tolist() == [14, 45, 15, 23]
    assert span_of(points[:1], np.array([512, 0]), 0).tolist() == [1536, 1536, 4608, 4608]


def test_smeared_points_in_front_of_a_wall_are_trimmed() -> None:
    """A wall is 3 m long, and one point in forty is 0.5 m in front of it."""
    x = np.arange(-1500, 1500, 10)
    wall = np.stack([x, np.where(np.arange(300) % 40 == 0, 1500, 2000)], axis=1)
    direction = np.array([1 << DIRECTION_BITS, 0])
    assert lengths(span_of(wall, direction), direction).tolist() == [2990, 0]
    assert lengths(span_of(wall, direction, 4000), direction).tolist() == [2990, 500]


def test_ends_bent_in_the_margins_do_not_make_a_rectangle_deeper() -> None:
    """The object is 0.9 m wide; its left third, in the margin, bends 0.3 m toward the camera."""
    x = np.arange(-450, 450, 10)
    wall = np.stack([x, 2000 + np.minimum(x + 150, 0)], axis=1)
    direction, relied = np.array([1 << DIRECTION_BITS, 0]), inner(x < -150)
    assert lengths(fitted_span(wall, direction, LONG, relied), direction).tolist() == [890, 0]
    assert lengths(span_of(wall, direction), direction).tolist() == [890, 300]
    assert fitted_direction(wall[relied]).tolist() == direction.tolist()


def test_an_object_only_in_a_margin_is_measured_there() -> None:
    assert inner(np.array([True, True, False, False])).tolist() == [False, False, True, True]
    assert inner(np.array([True, True, False])).all() and inner(np.ones(5, bool)).all()


def test_the_margin_grows_with_the_square_of_z() -> None:
    """At 2 m, the margin is 1 cm plus four times 5 mm."""
    one = fitted(np.array([512, 0]), 512 * np.array([-100, 500, 2000, 2300]))
    one = one._replace(xyz_min=np.array([[[-100, 0, 2000]]], np.int32))
    config = FootprintConfig(margin_m=0.01, margin_per_m2=0.005)
    corners = metric.rectangles(one, 0.001, config)[0, 0]
    np.testing.assert_allclose(corners[:2], [[-0.13, 1.97], [0.53, 1.97]], atol=1e-12)
    plain = PRESETS["paper"].footprint
    wide = metric.rectangles(one, 0.001, replace(plain, margin_m=0.03))
    same = replace(plain, margin_m=0.01, margin_per_m2=0.005)
    np.testing.assert_allclose(metric.rectangles(one, 0.001, same), wide, atol=1e-12)


def test_a_fitted_rectangle_matches_a_hand_calculation() -> None:
    """For a box 0.6 m wide, 1.0 to 1.3 m ahead, A and B are the near side, with a margin."""
    edge, span = np.array([512, 0]), 512 * np.array([-100, 500, 1000, 1300])
    config = FootprintConfig(margin_m=0.03, margin_per_m2=0.0)
    corners = metric.rectangles(fitted(edge, span), 0.001, config)[0, 0]
    np.testing.assert_allclose(
        corners, [[-0.13, 0.97], [0.53, 0.97], [0.53, 1.33], [-0.13, 1.33]], atol=1e-12
    )


def test_ab_is_the_side_nearest_to_the_camera() -> None:
    """An object to the left shows its right side, one to the right its left side."""
    left = metric.rectangles(fitted(np.array([1, 0]), np.array([-900, -700, -500, 500])), 1, FITTED)
    right = metric.rectangles(fitted(np.array([1, 0]), np.array([700, 900, -500, 500])), 1, FITTED)
    assert set(left[0, 0, :2, 0]) == {-700} and set(right[0, 0, :2, 0]) == {700}


def test_the_rectangle_of_a_single_point_has_a_margin() -> None:
    config, point = FootprintConfig(margin_m=0.02, margin_per_m2=0.0), np.array([[300, 1200]])
    direction = fitted_direction(point)
    one = fitted(direction, span_of(point, direction))
    corners = metric.rectangles(one, 0.001, config)[0, 0]
    np.testing.assert_allclose(corners.min(axis=0), [0.28, 1.18])
    np.testing.assert_allclose(corners.max(axis=0), [0.32, 1.22])


# known rectangles, and OpenCV


@pytest.mark.parametrize("angle", [0, 10, 27, 45, 63, 80])
@pytest.mark.parametrize(("wide", "deep"), [(600, 300), (300, 600), (1200, 200)])
def test_rectangle_of_a_rotated_box_is_exact(angle: int, wide: int, deep: int) -> None:
    points = turned(corner(wide, deep), angle, (150, 1800))
    direction = fitted_direction(points)
    assert degrees_of(direction) == pytest.approx(angle, abs=1.0)
    along, across = lengths(span_of(points, direction), direction)
    assert along == pytest.approx(wide, abs=20) and across == pytest.approx(deep, abs=20)
    true = turned(np.array([[0, 0], [wide, 0], [wide, deep], [0, deep]]), angle, (150, 1800))
    apart = np.linalg.norm(rectangle(points)[:, None] - true, axis=2)
    assert apart.min(axis=1).max() < 25 and len(set(apart.argmin(axis=1))) == 4


@pytest.mark.parametrize("angle", [3, 27, 61, 88])
def test_rectangle_of_a_noisy_box_is_within_the_noise(angle: int) -> None:
    noise = np.random.default_rng(angle).normal(0, 6, (46, 2))
    points = turned(corner(600, 300), angle, (-150, 1800))
    points = np.rint(points + noise[: len(points)]).astype(np.int64)
    assert degrees_of(fitted_direction(points)) == pytest.approx(angle, abs=2.5)


@given(st.integers(0, 89), st.integers(100, 900), st.integers(100, 900))
def test_the_fitted_rectangle_equals_that_of_opencv(angle: int, wide: int, deep: int) -> None:
    """The minimum-area rectangle around all sides of a box, two of them visible, is the box."""
    s, t = np.linspace(0, wide, 25), np.linspace(0, deep, 25)
    sight = [(0, b) for b in t] + [(a, 0) for a in s]
    hidden = [(wide, b) for b in t] + [(a, deep) for a in s]
    contour, behind = (turned(np.array(part), angle, (20, 1500)) for part in (sight, hidden))
    points = np.concatenate([contour, behind])
    size = sorted(cv2.minAreaRect(points.astype(np.float32))[1])
    direction = fitted_direction(contour)
    found = sorted(lengths(span_of(points, direction), direction))
    np.testing.assert_allclose(found, size, atol=4)


# laws

clouds = arrays(
    np.int64, st.tuples(st.integers(1, 40), st.just(2)), elements=st.integers(-3000, 3000)
)


@given(clouds)
def test_the_rectangle_holds_all_points(points: np.ndarray) -> None:
    direction = fitted_direction(points)
    assert direction[0] > 0 and direction[1] >= 0
    span = span_of(points, direction, 1 << 20)
    found = metric.rectangles(fitted(direction, span), 1.0, FITTED)[0, 0]
    center, along, across = found.mean(axis=0), found[1] - found[0], found[3] - found[0]
    for side in (along, across):
        reach = np.abs((points - center) @ side)
        assert (reach <= side @ side / 2 + 1e-3 * (1 + np.linalg.norm(side))).all()
    assert abs(along @ across) < 1e-3
    near, far = (np.linalg.norm(found[[i, i + 1]].mean(axis=0)) for i in (0, 2))
    assert near <= far + 1e-9


@given(clouds)
def test_no_other_direction_brings_the_contour_nearer_to_the_visible_edges(
    points: np.ndarray,
) -> None:
    def cost(c: int, s: int) -> int:
        """Return the cost of edges that face the camera at the origin; huge if none does."""
        away = [[1 << 40] * len(points)]
        for axis in ((c, s), (-s, c)):
            places = [axis[0] * x + axis[1] * y for x, y in points.tolist()]
            if min(places) > 0:
                away.append([a - min(places) for a in places])
            elif max(places) < 0:
                away.append([max(places) - a for a in places])
        return sum(min(one) for one in zip(*away, strict=True)) // 512

    turns = np.radians(np.arange(90))
    every = [cost(round(512 * np.cos(t)), round(512 * np.sin(t))) for t in turns]
    assert cost(*fitted_direction(points).tolist()) == min(every)


@given(clouds)
def test_the_order_of_points_has_no_influence(points: np.ndarray) -> None:
    direction = fitted_direction(points)
    assert fitted_direction(points[::-1]).tolist() == direction.tolist()
    span = span_of(points, direction)
    assert span_of(points[::-1], direction).tolist() == span.tolist()


@given(arrays(np.int64, (3, 9), elements=st.integers(-1, 3)), st.integers(0, 2**32 - 1))
def test_points_of_contours_are_positions_of_cells(label: np.ndarray, seed: int) -> None:
    rng = np.random.default_rng(seed)
    right, forward = rng.integers(-900, 900, (2, *label.shape))
    points, count = contours(label, right, forward, 4)
    for number in range(4):
        column = np.flatnonzero((label == number).any(axis=0))
        assert count[number] == len(column)
        for k, c in enumerate(column):
            own = np.flatnonzero(label[:, c] == number)
            distance = right[own, c] ** 2 + forward[own, c] ** 2
            row = own[np.argmin(distance)]
            assert points[number, k].tolist() == [right[row, c], forward[row, c]]


@given(st.lists(st.tuples(st.integers(-2000, 2000), st.integers(500, 4000)), max_size=30))
def test_parts_are_in_order_and_their_sides_long_enough(contour: list) -> None:
    points = np.array(contour, np.int64).reshape(-1, 2)
    parts = straight_parts(points, 150, 400, 400)
    assert parts[0] == 0 and parts == sorted(set(parts))
    assert parts[-1] < max(len(points), 1)


def test_both_sides_of_a_corner_must_be_long_enough():
    left = [(-600, y) for y in (2800, 2900)]
    across = [(x, 3000) for x in range(-600, 600, 100)]
    assert straight_parts(np.array(left + across), 100, 300, 200) == [0]
    assert straight_parts(np.array(left + across), 100, 150, 200) == [0, 2]
