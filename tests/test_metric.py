"""Conversion from integers to metres: rectangles by hand, Eq. 8-9 against a rigid transform."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxdet.config import FootprintConfig
from jaxdet.floor.plane import down_vector, flat_plane, ground_axes
from jaxdet.results import metric
from jaxdet.types import Obstacles

CONFIG = FootprintConfig(extension_m=0.2, margin_per_m2=0.0)


def outline(a: tuple, b: tuple, c: tuple, has_vertex: bool = False) -> Obstacles:
    """Return an obstacle with these points A, B and C."""
    point = np.array([[[3, -6, 9]]], np.int32)
    uv = np.zeros((1, 1, 2), np.int32)
    pa, pb, pc = (np.array([[p]], np.int32) for p in (a, b, c))
    count = np.ones((1, 1), np.int32)
    vertex = np.array([[has_vertex]])
    span = np.zeros((*pa.shape[:-1], 4), np.int32)
    total = np.stack(np.divmod(point, 1 << 16), axis=-1)
    return Obstacles(count, uv, uv, point, point, total, pa, pb, pc, vertex, 0 * pa, span)


def corners(*args: Any) -> np.ndarray:
    return metric.rectangles(outline(*args), 0.001, CONFIG)[0, 0]


def test_centroid_is_the_mean_of_the_points() -> None:
    one = outline((0, 0), (0, 0), (0, 0))
    found = metric.extents(one._replace(num_points=np.array([[2]], np.int32)), 0.001)
    assert found.centroid.dtype == np.float32
    np.testing.assert_array_equal(found.centroid[0, 0], np.float32([0.0015, -0.003, 0.0045]))
    np.testing.assert_array_equal(found.minimum[0, 0], np.float32([0.003, -0.006, 0.009]))


def test_the_distance_of_a_contour_is_that_of_its_nearest_point() -> None:
    points, count = np.array([[6, 8], [-3, 4], [5, 12]], np.int32), np.array([0, 2, 0, 1, 0])
    assert metric.nearest(points, count).tolist() == [0, 5, 0, 13, 0]
    assert metric.nearest(points[:0], count[:1]).tolist() == [0]
    assert not metric.nearest(points[:0], count[:0]).size


def test_contours_come_without_their_padding() -> None:
    contour = np.arange(2 * 3 * 4 * 2, dtype=np.int32).reshape(2, 3, 4, 2)
    used = np.array([[2, 0, 1], [4, 3, 0]], np.int32)
    row, slot = np.array([0, 0, 1, 1]), np.array([2, 1, 0, 1])
    points, count = metric.contour_lines(contour, used, row, slot)
    assert count.tolist() == [1, 0, 4, 3]
    expected = [contour[0, 2, :1], contour[1, 0], contour[1, 1, :3]]
    np.testing.assert_array_equal(points, np.concatenate(expected))
    backward = np.array([True, False, True, False])
    points, _ = metric.contour_lines(contour, used, row, slot, backward)
    expected[1] = expected[1][::-1]
    np.testing.assert_array_equal(points, np.concatenate(expected))


def test_without_a_vertex_the_rectangle_extends_away_from_the_camera() -> None:
    found = corners((-300, 1000), (300, 1000), (0, 990))
    np.testing.assert_allclose(found, [[-0.3, 1], [0.3, 1], [0.3, 1.2], [-0.3, 1.2]])


def test_margin_grows_with_the_square_of_the_nearest_depth() -> None:
    one = outline((-300, 1000), (300, 1000), (0, 990))
    near, far = (np.array([[[0, 0, z]]], np.int32) for z in (2000, 4000))
    config = FootprintConfig(extension_m=0.2, margin_m=0.01, margin_per_m2=0.01)
    found = metric.rectangles(one._replace(xyz_min=near, xyz_max=far), 0.001, config)[0, 0]
    expected = [[-0.35, 0.95], [0.35, 0.95], [0.35, 1.25], [-0.35, 1.25]]
    np.testing.assert_allclose(found, expected)


def test_the_rectangle_of_a_slanted_edge_extends_along_its_normal() -> None:
    found = corners((0, 2000), (300, 1600), (300, 1600))
    np.testing.assert_allclose(found[3] - found[0], [0.16, 0.12])
    np.testing.assert_allclose(found[2] - found[1], found[3] - found[0])


def test_with_a_vertex_the_opposite_edge_passes_through_c() -> None:
    found = corners((-300, 1200), (300, 1200), (50, 1000), True)
    np.testing.assert_allclose(found, [[-0.3, 1.2], [0.3, 1.2], [0.3, 1.0], [-0.3, 1.0]])


def test_the_rectangle_of_a_single_point_extends_forward() -> None:
    found = corners((100, 1000), (100, 1000), (100, 1000))
    np.testing.assert_allclose(found, [[0.1, 1], [0.1, 1], [0.1, 1.2], [0.1, 1.2]])


@pytest.mark.parametrize(("x", "side"), [(-500, -0.2), (500, 0.2), (0, 0.2)])
def test_the_rectangle_of_a_forward_edge_extends_away_from_the_axis(x: int, side: float) -> None:
    found = corners((x, 1000), (x, 1500), (x, 1000))
    np.testing.assert_allclose(found[3] - found[0], [side, 0])


@given(*[st.tuples(st.integers(-4000, 4000), st.integers(0, 4000)) for _ in range(3)])
def test_rectangles_have_right_angles(a: tuple, b: tuple, c: tuple) -> None:
    for vertex in (False, True):
        p = corners(a, b, c, vertex)
        np.testing.assert_allclose(p[0] + p[2], p[1] + p[3], atol=1e-12)
        assert abs(np.dot(p[1] - p[0], p[3] - p[0])) < 1e-9
        if not vertex:
            assert np.isclose(np.linalg.norm(p[3] - p[0]), 0.2)
            assert p[3, 1] >= p[0, 1]


def pose(yaw: float, pitch: float, roll: float, position: tuple) -> np.ndarray:
    """Return the pose of a camera with this ROS yaw, tilted down and rolled."""
    down = down_vector(np.array([pitch]), np.array([roll]))
    plane = flat_plane(np.ones(1), np.array([pitch]), np.array([roll]))
    right, forward = ground_axes(plane)[0] / 8192
    T = np.eye(4)
    c, s = np.cos(yaw), np.sin(yaw)
    axes = np.array([[s, c, 0], [-c, s, 0], [0, 0, -1.0]])  # columns: right, forward, down
    T[:3, :3] = axes @ np.stack([right, forward, down[0]])
    T[:3, 3] = position
    return T


@pytest.mark.parametrize("yaw", [0.0, 0.7, np.pi / 2, -2.0, np.pi])
@pytest.mark.parametrize(("pitch", "roll"), [(0, 0), (0.33, -0.17)])
def test_world_positions_equal_the_rigid_transform(yaw: float, pitch: float, roll: float) -> None:
    T = pose(yaw, pitch, roll, (2.0, -1.0, 0.6))
    sin, cos = metric.world_angle(T)
    theta = np.pi / 2 - yaw
    np.testing.assert_allclose([sin, cos], [np.sin(theta), np.cos(theta)], atol=1e-3)
    x, y = 0.4, 1.5
    found = metric.to_world(np.full((1, 1, 4, 2), (x, y)), T[None])[0, 0, 0]
    forward, right = (np.cos(yaw), np.sin(yaw)), (np.sin(yaw), -np.cos(yaw))
    expected = np.array([2.0, -1.0]) + x * np.array(right) + y * np.array(forward)
    np.testing.assert_allclose(found, expected, atol=3e-3)


def test_the_heading_of_a_camera_looking_straight_down_is_the_top_of_its_image() -> None:
    T = np.eye(4)
    T[:3, :3] = [[0, -1, 0], [-1, 0, 0], [0, 0, -1]]  # image up is world +X
    assert metric.world_angle(T) == (1.0, 0.0)


def test_positions_for_an_unknown_pose_are_nan() -> None:
    found = metric.to_world(np.zeros((1, 2, 4, 2)), np.full((1, 4, 4), np.nan))
    assert np.isnan(found).all()


@pytest.mark.parametrize(
    ("corners", "distance"),
    [
        ([(-1, 2), (1, 2), (1, 3), (-1, 3)], 2.0),
        ([(1, 3), (1, 2), (-1, 2), (-1, 3)], 2.0),  # reversed
        ([(3, 4), (5, 4), (5, 6), (3, 6)], 5.0),  # a corner
        ([(-1, -1), (1, -1), (1, 1), (-1, 1)], 0.0),  # the camera is inside
        ([(3, 4)] * 4, 5.0),  # a point
        ([(-2, 0), (2, 4), (0, 6), (-4, 2)], 2**0.5),
    ],
)
def test_distance_of_a_rectangle_is_that_of_its_nearest_point(corners, distance):
    found = metric.rectangle_distances(np.array([corners], np.float32))
    np.testing.assert_allclose(found, [distance])


def test_margin_extends_outward_if_the_vertex_is_nearer_than_ab():
    config = FootprintConfig(extension_m=0.2, margin_m=0.1, margin_per_m2=0.0)
    given = outline((-200, 1000), (200, 1000), (0, 800), True)
    found = metric.rectangles(given, 0.001, config)[0, 0]
    np.testing.assert_allclose(found.min(axis=0), [-0.3, 0.7])
    np.testing.assert_allclose(found.max(axis=0), [0.3, 1.1])
