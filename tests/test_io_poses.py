"""Poses of logs: their sources, and poses that cannot be used."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxdet.errors import CalibrationError, TopicError
from jaxdet.io import LogOptions, indexed, open_log
from jaxdet.io.motion import quaternions
from tests.io_both_ways import open_both_ways
from tests.io_foxglove import write_foxglove
from tests.io_helpers import (
    COLOR_FRAME,
    DEPTH_FRAME,
    START,
    LogFile,
    make_scene,
    ros_odometry,
    ros_tf,
    write_calibration,
    write_images,
)

NO_TURN = (0.0, 0.0, 0.0, 1.0)


@pytest.mark.parametrize("form", ["proto", "json"])
def test_poses_in_frame_messages_require_the_name_of_their_frame(tmp_path, form):
    path = str(write_foxglove(tmp_path / "x.mcap", make_scene(), form, pose=True))
    with open_log(path) as log:
        assert log.T_world_camera is None
        assert any("/pose" in text for text in log.description.warnings)
    with open_log(path, LogOptions(base_frame=DEPTH_FRAME)) as log:
        assert log.T_world_camera is not None
        assert log.described(next(log.batches(3)).notes).num_poses == 3
        expected = np.array([-0.015, 0.001, 0.0])
        turned = log.T_world_camera[0, :3, :3]
        assert log.T_base_camera is not None
        np.testing.assert_allclose(turned @ turned.T, np.eye(3), atol=1e-12)
        T_map_depth = log.T_world_camera[0] @ np.linalg.inv(log.T_base_camera)
        np.testing.assert_allclose(T_map_depth[:3, 3], expected, atol=1e-12)


def write(path, topics, base=True, late_ns=0):
    scene = make_scene(2)
    with LogFile(path) as log:
        write_calibration(log, tf=False)
        edges = [(COLOR_FRAME, DEPTH_FRAME, (0.015, 0, 0), NO_TURN)]
        edges += [("base_link", COLOR_FRAME, (0, 0, 0.3), NO_TURN)] if base else []
        log.ros("/tf_static", ros_tf(*edges), START)
        for topic in topics:
            for at in scene.color_ns.tolist():
                log.ros(
                    topic, ros_odometry("odom", "base_link", (1, 2, 0), NO_TURN, at + late_ns), at
                )
        write_images(log, scene)
    return str(path)


def test_offsets_of_the_clock_of_poses_are_applied(tmp_path):
    for late_s in (0, 3, -100_000):
        path = write(tmp_path / f"{late_s}.mcap", ["/odom"], late_ns=late_s * 1_000_000_000)
        with open_both_ways(path) as log:
            about = log.described(next(log.batches(2)).notes)
        assert about.num_poses == 2
        assert any("--log.pose-offset-s 0" in text for text in about.warnings) == bool(late_s)
    with open_log(path, LogOptions(pose_offset_s=0.0)) as log:
        about = log.described(next(log.batches(2)).notes)
    assert about.num_poses == 0 and any("no frame has a pose" in item for item in about.warnings)


def test_several_pose_topics_are_an_error(tmp_path):
    path = write(tmp_path / "x.mcap", ["/a/odom", "/b/odom"])
    with open_log(path) as log:
        assert log.T_world_camera is None
        assert any("--log.odom" in text for text in log.description.warnings)
    with open_log(path, LogOptions(odom="/b/odom")) as log:
        assert log.T_world_camera is not None
        np.testing.assert_allclose(log.T_world_camera[:, :3, 3], [[1.015, 2, 0.3]] * 2)
    with pytest.raises(TopicError, match=r"/a/odom, /b/odom"):
        open_log(path, LogOptions(odom="/c"))


def test_odometry_that_is_not_connected_to_the_camera_is_not_used(tmp_path):
    with open_log(write(tmp_path / "x.mcap", ["/odom"], base=False)) as log:
        assert log.T_world_camera is None and log.T_base_camera is None
        assert any("'base_link'" in text for text in log.description.warnings)


def test_a_missing_base_frame_is_an_error(tmp_path):
    path = write(tmp_path / "x.mcap", [])
    with pytest.raises(CalibrationError, match=r"--log\.base-frame"):
        open_log(path, LogOptions(base_frame="nowhere"))


def test_a_cycle_is_an_error_that_names_file_and_topic(tmp_path):
    with LogFile(tmp_path / "x.mcap") as log:
        write_calibration(log, tf=False)
        names = (DEPTH_FRAME, "base_link"), ("base_link", DEPTH_FRAME)
        log.ros("/tf_static", ros_tf(*((*pair, (0, 0, 0), NO_TURN) for pair in names)), START)
        write_images(log, make_scene())
    with pytest.raises(CalibrationError, match=r"x\.mcap: /tf_static: the transforms form a cycle"):
        open_log(str(tmp_path / "x.mcap"))


def test_extrinsics_are_required_without_tf(tmp_path):
    path = write(tmp_path / "x.mcap", ["/odom"])
    with open_log(path, LogOptions(tf=False)) as log:
        assert not log.has_color and "--log.color-from-depth" in log.color_problem
    given = LogOptions(tf=False, color_from_depth=(0, 0, 0, *NO_TURN))
    with open_log(path, given) as log:
        assert log.T_base_camera is None and log.T_world_camera is None


@pytest.mark.parametrize(
    ("first", "world", "lacking"), [(15, "odom", 0), (8, "map", 7), (0, "map", 0), (18, "odom", 0)]
)
def test_the_world_is_a_frame_in_which_poses_are_known(tmp_path, first, world, lacking):
    scene = make_scene(20)
    with LogFile(tmp_path / "x.mcap") as log:
        write_calibration(log)
        log.ros("/tf_static", ros_tf(("base_link", DEPTH_FRAME, (0, 0, 1), NO_TURN)), START)
        for i, at in enumerate(scene.color_ns.tolist()):
            edges = [("odom", "base_link", (i, 0, 0), NO_TURN)]
            edges += [("map", "odom", (5, i, 0), NO_TURN)] if i >= first else []
            log.ros("/tf", ros_tf(*edges, stamp_ns=at), at)
        write_images(log, scene)
    path = str(tmp_path / "x.mcap")
    with open_both_ways(path) as log:
        assert log.world_frame == world and log.T_world_camera is not None
        assert np.isnan(log.T_world_camera[:, 0, 0]).sum() == lacking
        warnings = log.described(next(log.batches(20)).notes).warnings
    warning = f"{lacking} of 20 frames have no pose; see --log.world-frame, --log.odom and "
    warning += "--log.pose-offset-s"
    assert (warning in warnings) == (lacking > 0)
    for part in ({"start": "0.6"}, {"stop": "0.2"}, {"every": 7}):
        with open_log(path, LogOptions(**part)) as log:
            assert log.world_frame == world


@pytest.mark.parametrize("whole", [True, False])
@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0, 0.0), (np.nan, 0.0, 0.0, np.nan)])
def test_an_invalid_transform_does_not_affect_others_in_its_message(
    tmp_path, monkeypatch, turn, whole
):
    if not whole:
        monkeypatch.setattr(indexed, "_MAX_MOTIONS", 0)
    scene = make_scene(20)
    with LogFile(tmp_path / "x.mcap") as log:
        write_calibration(log, tf=False)
        finger = "gripper", "finger", (0, 0, 0), turn
        edges = (COLOR_FRAME, DEPTH_FRAME, (0.015, 0, 0), NO_TURN), finger
        log.ros("/tf_static", ros_tf(*edges, ("base_link", COLOR_FRAME, (0, 0, 1), NO_TURN)), START)
        for i, at in enumerate(scene.color_ns.tolist()):
            edge = "odom", "base_link", (i, 0, 0), NO_TURN
            log.ros("/tf", ros_tf(finger, edge, stamp_ns=at), at)
        write_images(log, scene)
    for found in (open_both_ways(str(tmp_path / "x.mcap")), open_log(str(tmp_path / "x.mcap"))):
        with found as log:
            assert log.T_world_camera is not None and log.T_base_camera is not None
            x = np.interp(scene.depth_ns - START, scene.color_ns - START, np.arange(20)) + 0.015
            np.testing.assert_allclose(log.T_world_camera[:, 0, 3], x, atol=1e-9)
            (text,) = (text for text in log.description.warnings if "finger" in text)
            assert "'finger': 21 transforms were ignored: quaternion (" in text


def test_quaternions_equal_those_of_scipy() -> None:
    turns = Rotation.random(200, random_state=1)
    half = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1], [0.6, 0.8, 0, 0]]
    turns = Rotation.concatenate([turns, Rotation.from_quat(half)])
    found = quaternions(turns.as_matrix())
    assert (found[:, 3] >= 0).all()
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0, rtol=1e-15)
    np.testing.assert_allclose(Rotation.from_quat(found).as_matrix(), turns.as_matrix(), atol=1e-14)
    alone = [quaternions(R) for R in turns.as_matrix()]
    np.testing.assert_array_equal(found, alone)
    assert np.isnan(quaternions(np.full((1, 3, 3), np.nan))).all()
