"""Pairing of colour and depth, interpolation of poses, and the tree of transforms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from jaxdet.errors import CalibrationError, FrameStatus
from jaxdet.io import LogOptions, open_log
from jaxdet.io.messages import TransformMessage
from jaxdet.io.motion import (
    MARGIN_S,
    MAX_GAP_S,
    MotionSamples,
    difference,
    interpolate,
    inverse,
    motion_matrix,
)
from jaxdet.io.timeline import nearest
from jaxdet.io.transforms import TransformTree
from tests.io_helpers import (
    COLOR,
    COLOR_FRAME,
    DEPTH,
    DEPTH_FRAME,
    START,
    STORE,
    LogFile,
    make_scene,
    ros_image,
    write_calibration,
    write_log,
)

MS = 1_000_000
STAMPS = st.lists(st.integers(0, 60), max_size=12).map(lambda s: np.array(sorted(s), np.int64) * MS)


@pytest.mark.parametrize(
    ("depth", "color", "expected"),
    [
        ([4, 37, 70], [0, 33, 66], [0, 1, 2]),
        ([4, 37, 70], [33, 66], [0, 0, 1]),  # the first colour image was dropped
        (
            [0, 33, 66, 99],
            [0, 66],
            [0, 0, 1, 1],
        ),  # colour at half the rate: frame 1 is equally far from both images
        ([0], [101, 268], [0]),
        ([0], [151], [-1]),
        ([50], [40, 60], [0]),
        ([10, 10], [10, 10, 10], [0, 0]),
        ([1], [], [-1]),
        ([], [1], []),
    ],
)
def test_nearest_colour_images_are_those_found_by_hand(depth, color, expected):
    stamps = [np.array(items, np.int64) * MS for items in (depth, color)]
    assert nearest(*stamps, 0.15).tolist() == expected


@given(STAMPS, STAMPS, st.integers(0, 40))
def test_the_nearest_image_has_the_smallest_time_difference_within_the_tolerance(
    depth, color, tolerance_ms
):
    found = nearest(depth, color, tolerance_ms / 1e3)
    for stamp, number in zip(depth, found, strict=True):
        apart = np.abs(color - stamp)
        if not len(color) or apart.min() > tolerance_ms * MS:
            assert number == -1
        else:
            assert number == np.flatnonzero(apart == apart.min())[0]


def test_interpolated_rotations_equal_slerp():
    random = np.random.default_rng(0)
    sample_ns = np.cumsum(random.integers(10 * MS, 90 * MS, 40))
    rotations = Rotation.random(40, rng=1)
    samples = np.concatenate([random.normal(size=(40, 3)), rotations.as_quat()], axis=1)
    samples[::3, 3:] *= -1  # negated quaternions are the same rotations
    at = np.sort(random.integers(sample_ns[0], sample_ns[-1], 200))
    T = interpolate(at, sample_ns, samples)
    expected = Slerp(sample_ns / 1e9, rotations)(at / 1e9).as_matrix()
    np.testing.assert_allclose(T[:, :3, :3], expected, atol=1e-6)
    for axis in range(3):
        line = np.interp(at, sample_ns, samples[:, axis])
        np.testing.assert_allclose(T[:, axis, 3], line, atol=1e-9)
    exact = interpolate(sample_ns, sample_ns, samples)
    np.testing.assert_allclose(exact, motion_matrix(samples[:, :3], samples[:, 3:]), atol=1e-12)


def test_poses_are_held_at_the_ends_and_unknown_beyond_and_in_gaps():
    second, margin = 1000 * MS, round(MARGIN_S * 1e9)
    sample_ns = np.array([0, second, second + round((MAX_GAP_S + 1) * 1e9)])
    samples = np.array([[0, 0, 0, 0, 0, 0, 1], [1, 0, 0, 0, 0, 0, 1], [5, 0, 0, 0, 0, 0, 1.0]])
    at = np.array([-margin - 1, -margin, second // 4, 2 * second, sample_ns[2] + margin])
    x = interpolate(at, sample_ns, samples)[:, 0, 3]
    np.testing.assert_array_equal(x, [np.nan, 0, 0.25, np.nan, 5])


def test_poses_are_interpolated_up_to_the_longest_gap():
    longest = round(MAX_GAP_S * 1e9)
    samples = np.array([[0, 0, 0, 0, 0, 0, 1], [2, 0, 0, 0, 0, 0, 1.0]])
    for gap, middle in ((longest - 1, 1.0), (longest, 1.0), (longest + 1, np.nan)):
        x = interpolate(np.array([0, gap // 2, gap]), np.array([0, gap]), samples)[:, 0, 3]
        np.testing.assert_allclose(x, [0, middle, 2], atol=1e-6)


def edge(parent, child, x, stamp_ns=0):
    return TransformMessage(stamp_ns, parent, child, (x, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))


def test_transforms_are_chained_and_cycles_and_contradictions_are_errors():
    tree = TransformTree()
    tree.add([edge("base", "a", 1), edge("a", "b", 2), edge("base", "c", 10)], static=True)
    T = tree.fixed("c", "b")
    assert T is not None and T[0, 3] == -7 and tree.fixed("c", "nowhere") is None
    tree.add([edge("base", "a", 1.5), edge("c", "b", 3)], static=True)
    assert len(tree.warnings) == 2
    tree.add([edge("b", "base", 1)], static=True)
    with pytest.raises(CalibrationError, match=r"cycle.*--log\.color-from-depth"):
        tree.fixed("c", "b")


def test_moving_transforms_are_poses_and_not_calibration():
    tree = TransformTree()
    tree.add([edge("base", "camera", 1)], static=True)
    for step in range(3):
        tree.add([edge("odom", "base", step, step * 100 * MS)], static=False)
    tree.settle()
    assert tree.fixed("odom", "camera") is None
    T = tree.at("odom", "camera", np.array([50 * MS, 900 * MS]))
    assert T is not None and T[0, 0, 3] == 1.5 and np.isnan(T[1]).all()


def test_repeated_equal_transforms_hold_at_all_times():
    """A mount may be on ``/tf``; a transform that moves by 1 mm holds only near its samples."""
    stamps = np.array([-5000, 100, 700, 60_000]) * MS
    for last, known in ((1.0, [True] * 4), (1.001, [False, True, False, False])):
        tree = TransformTree()
        for step, x in enumerate((1.0, 1.0, last)):
            tree.add([edge("odom", "base", x, step * 100 * MS)], static=False)
        tree.settle()
        T = tree.at("odom", "base", stamps)
        assert T is not None
        T = np.broadcast_to(T, (4, 4, 4))
        assert np.isfinite(T).all(axis=(1, 2)).tolist() == known


def test_inverse_and_difference_of_transforms_match_a_hand_calculation():
    first = motion_matrix(np.array([1.0, 2, 3]), Rotation.from_euler("z", 0.2).as_quat())
    second = motion_matrix(np.array([1.0, 2, 3.5]), Rotation.from_euler("z", -0.1).as_quat())
    np.testing.assert_allclose(inverse(first) @ first, np.eye(4), atol=1e-12)
    np.testing.assert_allclose(difference(first, second), (0.5, 0.3))


NO_TURN = (0.0, 0.0, 0.0, 1.0)


def test_the_last_of_several_transforms_with_one_timestamp_counts():
    samples = MotionSamples()
    for x in (1.0, 2.0):
        samples.add(START, (x, 0.0, 0.0), NO_TURN)
    assert samples.at(np.array([START]))[0, 0, 3] == 2.0


def transform(parent, child, x=0.0, at=START):
    return TransformMessage(at, parent, child, (x, 0.0, 0.0), NO_TURN)


def test_static_transforms_override_moving_ones_with_another_parent():
    tree = TransformTree()
    tree.add([transform("odom", "camera")], static=False)
    tree.add([transform("base", "camera", 2.0)], static=True)
    tree.settle()
    T = tree.fixed("base", "camera")
    assert T is not None and T[0, 3] == 2.0
    assert tree.parent("camera") == "base"


@pytest.mark.parametrize("once", [False, True])
def test_a_single_moving_transform_is_static_only_if_requested(once):
    tree = TransformTree()
    tree.add([transform("base", "camera")], static=False, once_is_static=once)
    tree.settle()
    assert (tree.fixed("base", "camera") is not None) is once


def test_images_with_equal_timestamps_are_ordered_by_log_time(tmp_path):
    scene, path = make_scene(2), tmp_path / "x.mcap"
    with LogFile(path) as log:
        write_calibration(log)
        for number, at in (
            (1, START + 9_000_000),
            (0, START + 5_000_000),
        ):  # the image with the later log time is written first
            log.ros(DEPTH, ros_image(scene.depth[number], "16UC1", START, DEPTH_FRAME), at)
            log.ros(COLOR, ros_image(scene.color[number], "rgb8", START, COLOR_FRAME), at)
    for scan in (False, True):
        with open_log(str(path), LogOptions(scan=scan)) as log:
            batch = log.read([0, 1], color=True)
            np.testing.assert_array_equal(batch.frames.color, scene.color[[0, 0]])
            np.testing.assert_array_equal(batch.frames.depth, scene.depth)


def raw(log, topic, data, at):
    name = "sensor_msgs/msg/Image"
    text = STORE.generate_msgdef(name, ros_version=2)[0].encode()
    log.raw(topic, "cdr", (name, "ros2msg", text), data, at)


def test_an_image_with_an_unreadable_timestamp_keeps_its_position(tmp_path):
    scene, path = make_scene(5), tmp_path / "x.mcap"
    with LogFile(path) as log:
        write_calibration(log)
        for i, (color, depth, at, depth_at) in enumerate(zip(*scene, strict=True)):
            log.ros(COLOR, ros_image(color, "rgb8", int(at), COLOR_FRAME), int(at))
            if i == 2:
                raw(log, DEPTH, b"\0\1\0\0", int(depth_at))
            else:
                log.ros(DEPTH, ros_image(depth, "16UC1", int(depth_at), DEPTH_FRAME), int(depth_at))
    for scan in (False, True):
        with open_log(str(path), LogOptions(scan=scan)) as log:
            [batch] = log.batches(5)
            bad, good = FrameStatus.DECODE_ERROR, FrameStatus.OK
            assert batch.status == (good, good, bad, good, good)
            assert batch.frames.stamp_ns.tolist() == scene.depth_ns.tolist()


@pytest.mark.parametrize("scan", [False, True])
def test_a_clock_that_begins_at_zero_is_used(tmp_path, scan):
    scene = make_scene(4)
    scene = scene._replace(
        color_ns=np.arange(4) * 33_333_333 + 4_000_000, depth_ns=np.arange(4) * 33_333_333
    )
    path = write_log(tmp_path / "x.mcap", scene)
    with open_log(str(path), LogOptions(scan=scan)) as log:
        [batch] = log.batches(4)
        assert batch.status == (FrameStatus.OK,) * 4, batch.errors
        np.testing.assert_array_equal(batch.frames.depth, scene.depth)
        assert log.described(batch.notes).pairing.num_with_color == 4
