"""floor_frames: floors as integers, and the positions of points relative to them."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from jaxdet.floor.frame import (
    FRAME_BITS,
    STEEPEST_SLOPE,
    UNKNOWN_HEIGHT,
    floor_frames,
    on_floor,
)
from jaxdet.floor.plane import down_vector, flat_plane, ground_axes, unknown_plane
from jaxdet.floor.units import ANGLES, Scale, prior_units

UNIT = 0.001


def test_the_floor_frame_of_a_level_camera_keeps_right_and_forward() -> None:
    plane = flat_plane(np.array([0.4, 1.0]), np.zeros(2), np.zeros(2))
    frame, fine = floor_frames(plane, UNIT), floor_frames(plane, UNIT / 10)
    xyz = np.array([[-100, 20], [400, -50], [1000, 3000]])
    right, forward, height = on_floor(frame[0], xyz)
    assert right.tolist() == [-100, 20] and forward.tolist() == [1000, 3000]
    assert height.tolist() == [0, 450]
    assert on_floor(frame[1], xyz)[2].tolist() == [600, 1050]
    assert on_floor(fine[1], 10 * xyz)[2].tolist() == [6000, 10500]


@given(
    st.integers(-40 * ANGLES, 80 * ANGLES),
    st.integers(-180 * ANGLES, 180 * ANGLES),
    st.lists(st.tuples(*[st.integers(-4000, 4000)] * 3), min_size=1, max_size=5),
)
def test_the_floor_frame_of_a_rotated_camera_has_true_heights_and_lengths(
    pitch: int, roll: int, points: list
) -> None:
    angles = np.radians(np.array([[pitch], [roll]]) / ANGLES)
    plane = flat_plane(np.array([0.5]), *angles)
    xyz = np.array(points).T
    right, forward, height = on_floor(floor_frames(plane, UNIT)[0], xyz)
    down = down_vector(plane.pitch, plane.roll)[0]
    assert np.abs(500 - down @ xyz - height).max() <= 2.0
    length = np.sqrt(right**2.0 + forward**2.0 + (500 - height) ** 2.0)
    np.testing.assert_allclose(length, np.sqrt((xyz**2.0).sum(axis=0)), atol=4)


@given(st.floats(-0.6, 1.3), st.floats(-3.0, 3.0))
def test_axes_are_those_of_the_plane(pitch: float, roll: float) -> None:
    """The axes agree within half a step of both angles, plus rounding."""
    plane = flat_plane(*(np.array([a]) for a in (0.5, pitch, roll)))
    axes = floor_frames(plane, UNIT)[0, :9].reshape(3, 3)
    known = np.concatenate(
        [ground_axes(plane)[0], np.rint(down_vector(plane.pitch, plane.roll) * 8192)]
    )
    assert np.abs(axes - known).max() <= np.radians(1 / ANGLES) * (1 << FRAME_BITS) + 1


def test_forward_of_a_floor_frame_seen_from_above_is_the_top_of_the_image() -> None:
    plane = flat_plane(np.array([0.5]), np.array([np.pi / 2]), np.zeros(1))
    right, forward, height = on_floor(floor_frames(plane, UNIT)[0], np.array([[100], [-50], [400]]))
    assert (right.tolist(), forward.tolist(), height.tolist()) == ([100], [50], [100])


def test_without_a_floor_the_frame_is_that_of_a_level_camera() -> None:
    """All points are high above the floor."""
    frame = floor_frames(unknown_plane(1), UNIT)[0]
    right, forward, height = on_floor(frame, np.array([[5], [700], [900]]))
    assert (right.tolist(), forward.tolist(), height.tolist()) == ([5], [900], [UNKNOWN_HEIGHT])


def test_steepness_of_ramps_is_clipped() -> None:
    plane = flat_plane(np.ones(2), np.zeros(2), np.zeros(2))
    plane = plane._replace(ramp_start=np.ones(2), ramp_slope=np.array([1e9, -1e9]))
    steepest = STEEPEST_SLOPE << FRAME_BITS
    assert floor_frames(plane, UNIT)[:, -1].tolist() == [steepest, -steepest]


def test_rolls_a_full_turn_apart_give_equal_floor_frames() -> None:
    roll = np.radians([190.0, -170.0, 180.0, -180.0, 359.0, -1.0])
    given = prior_units(flat_plane(np.full(6, 0.5), np.zeros(6), roll), Scale(UNIT, 0.004))
    assert given[:, 1].tolist() == [ANGLES * deg for deg in (-170, -170, -180, -180, -1, -1)]


def test_ramps_raise_the_floor() -> None:
    plane = flat_plane(np.ones(3), np.zeros(3), np.zeros(3))
    plane = plane._replace(
        ramp_start=np.array([1.5, 1.5, np.inf]), ramp_slope=np.array([0.125, -0.25, 0])
    )
    forward = np.array([-3, 0, 1500, 1508, 2300])
    xyz = np.stack([0 * forward, 1000 + 0 * forward, forward])
    heights = [on_floor(one, xyz)[2].tolist() for one in floor_frames(plane, UNIT)]
    assert heights == [[0, 0, 0, -1, -100], [0, 0, 0, 2, 200], [0] * 5]
    fine = floor_frames(plane, UNIT / 10)[0]
    assert on_floor(fine, 10 * xyz)[2].tolist() == [0, 0, 0, -10, -1000]
