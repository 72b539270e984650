"""Extrinsics, mount, poses and topics of logs."""

import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxdet.errors import CalibrationError, CamerasError, ConfigError, FrameStatus, TopicError
from jaxdet.io import LogOptions, open_log
from tests.io_helpers import (
    COLOR,
    COLOR_FRAME,
    COLOR_K,
    COLOR_SIZE,
    DEPTH,
    DEPTH_FRAME,
    DEPTH_INFO,
    DEPTH_K,
    DEPTH_SIZE,
    SECOND,
    START,
    T_COLOR_DEPTH,
    T_DEPTH_COLOR,
    LogFile,
    make_scene,
    ros_header,
    ros_image,
    ros_info,
    ros_odometry,
    ros_tf,
    ros_type,
    write_calibration,
    write_images,
)


def test_the_extrinsics_topic_is_column_major_and_overrides_tf(tmp_path):
    path = tmp_path / "log.mcap"
    with LogFile(path) as log:
        write_calibration(log)
        message = ros_type("realsense2_camera_msgs/msg/Extrinsics")
        rotation = T_COLOR_DEPTH[:3, :3].T.reshape(-1)
        log.ros(
            "/cam/extrinsics/depth_to_color", message(rotation, T_COLOR_DEPTH[:3, 3].copy()), START
        )
        write_images(log, make_scene())
    with open_log(str(path)) as log:
        assert log.calibration.color_from_depth is not None
        np.testing.assert_allclose(log.calibration.color_from_depth.T, T_COLOR_DEPTH, atol=1e-12)
        assert "topic" in log.description.extrinsics_source
        assert not log.description.warnings
    with LogFile(path) as log:
        write_calibration(log)
        log.ros(
            "/cam/extrinsics/depth_to_color", message(np.eye(3).reshape(-1), np.zeros(3)), START
        )
        write_images(log, make_scene())
    with open_log(str(path)) as log:
        assert any("differs from TF" in text for text in log.description.warnings)


def test_extrinsics_of_the_driver_for_ros_1_are_read(tmp_path):
    with LogFile(tmp_path / "log.mcap") as log:
        write_calibration(log, tf=False)
        message = ros_type("realsense2_camera/msg/Extrinsics")
        rotation = T_COLOR_DEPTH[:3, :3].T.reshape(-1)
        found = message(ros_header(START, "c"), rotation, T_COLOR_DEPTH[:3, 3].copy())
        log.ros("/cam/extrinsics/depth_to_color", found, START)
        write_images(log, make_scene())
    with open_log(tmp_path / "log.mcap") as log:
        assert log.calibration.color_from_depth is not None
        np.testing.assert_allclose(log.calibration.color_from_depth.T, T_COLOR_DEPTH, atol=1e-12)


@pytest.mark.parametrize("with_tf", [True, False])
def test_extrinsics_of_another_camera_are_not_used(tmp_path, with_tf):
    path = tmp_path / "log.mcap"
    with LogFile(path) as log:
        for name in ("front", "rear"):
            for kind, size, K in (("color", COLOR_SIZE, COLOR_K), ("depth", DEPTH_SIZE, DEPTH_K)):
                info = ros_info(size, K, START, f"{name}_{kind}")
                log.ros(f"/{name}/{kind}/camera_info", info, START)
            image = ros_image(make_scene().color[0], "rgb8", START, f"{name}_color")
            log.ros(f"/{name}/color/image_raw", image, START)
            image = ros_image(make_scene().depth[0], "16UC1", START, f"{name}_depth")
            log.ros(f"/{name}/depth/image_raw", image, START)
        message = ros_type("realsense2_camera_msgs/msg/Extrinsics")
        shift = np.array([0.015, 0.0, 0.0])
        log.ros("/front/extrinsics/depth_to_color", message(np.eye(3).reshape(-1), shift), START)
        if with_tf:
            edge = "rear_color", "rear_depth", (0.05, 0.0, 0.0), (0, 0, 0, 1)
            log.ros("/tf_static", ros_tf(edge), START)
    with open_log(str(path), LogOptions(camera="front")) as log:
        assert log.calibration.color_from_depth is not None
        assert log.calibration.color_from_depth.translation == (0.015, 0.0, 0.0)
    if not with_tf:
        with open_log(str(path), LogOptions(camera="rear")) as log:
            assert log.calibration.color is None and not log.has_color
            assert "no extrinsics from depth to colour" in log.color_problem
        return
    with open_log(str(path), LogOptions(camera="rear")) as log:
        assert log.calibration.color_from_depth is not None
        assert log.calibration.color_from_depth.translation == (0.05, 0.0, 0.0)


def test_missing_extrinsics_are_an_error_that_names_the_flag(tmp_path):
    path = str(tmp_path / "log.mcap")
    with LogFile(tmp_path / "log.mcap") as log:
        write_calibration(log, tf=False)
        write_images(log, make_scene())
    with open_log(path) as log:
        assert log.calibration.color is None and log.calibration.depth[2:6] == DEPTH_K
        assert not log.has_color and not log.has_color_camera and log.color_shape is None
        assert "--log.color-from-depth" in log.color_problem
        note = "colour camera without extrinsics: pictures show "
        assert any(text.startswith(f"{note}depth") for text in log.description.notes)
        assert log.read([0, 1, 2], color=True).status == (FrameStatus.OK,) * 3
        batch = log.read([0, 1, 2], color=True, need_color=True)
        assert batch.status == (FrameStatus.NO_COLOR,) * 3
        assert "--log.color-from-depth" in batch.errors[0]
    given = LogOptions(color_from_depth=(0.015, 0, 0, 0, 0, 0, 1))
    with open_log(path, given) as log:
        assert log.calibration.color_from_depth is not None
        assert log.calibration.color_from_depth.translation == (0.015, 0.0, 0.0)


@pytest.mark.parametrize("scale", [None, 1, 2])
def test_images_of_one_tf_frame_and_lens_need_no_extrinsics(tmp_path, scale):
    """Some drivers set the same frame for all cameras of a device."""
    path = tmp_path / "log.mcap"
    size = tuple(side // (scale or 1) for side in COLOR_SIZE)
    K = tuple(value / scale for value in COLOR_K) if scale else DEPTH_K
    with LogFile(path) as log:
        write_calibration(log, aligned=True)
        log.ros(DEPTH_INFO, ros_info(size, K, START, COLOR_FRAME), START)
        for color, at in zip(make_scene().color, range(START, START + 5), strict=False):
            depth = np.full(size[::-1], 1500, np.uint16)
            log.ros(DEPTH, ros_image(depth, "16UC1", at, COLOR_FRAME), at)
            log.ros(COLOR, ros_image(color, "rgb8", at, COLOR_FRAME), at)
    if scale:
        with open_log(str(path)) as log:
            assert "frame" in log.description.extrinsics_source
        return
    with open_log(str(path)) as log:
        text = (
            f"both images are in TF frame {COLOR_FRAME!r}, but their camera matrices differ; pass "
        )
        assert not log.has_color and f"{text}--log.color-from-d" in log.color_problem
    for given in ({"camera_frame": COLOR_FRAME}, {"depth_aligned": True}):
        with open_log(str(path), LogOptions(**given)) as log:
            assert log.has_color


def test_calibrations_with_field_names_of_ros_1_are_read(tmp_path):
    """rosbags-convert writes such messages."""

    class Converted(LogFile):
        def raw(self, topic, encoding, schema, data, log_ns):
            name, kind, text = schema
            if name == "sensor_msgs/msg/CameraInfo":
                for letter in "dkrp":
                    text = re.sub(rb"(float64\[\d*\]) %c\n" % ord(letter), upper, text)
                assert b"] K\n" in text
            super().raw(topic, encoding, (name, kind, text), data, log_ns)

    def upper(found):
        return found[0].upper().replace(b"FLOAT", b"float")

    path = tmp_path / "log.mcap"
    with Converted(path) as log:
        write_calibration(log)
        write_images(log, make_scene())
    with open_log(str(path)) as log:
        color = log.calibration.image
        assert (color.fx, color.fy, color.cx, color.cy) == COLOR_K
        assert not log.description.warnings


@pytest.mark.parametrize("name", ["color_from_depth", "depth_intrinsics"])
def test_aligned_depth_uses_the_colour_camera(name):
    value = (0, 0, 0, 0, 0, 0, 1) if name == "color_from_depth" else (50, 50, 20, 15)
    flag = name.replace("_", "-")
    with pytest.raises(ConfigError, match=rf"log\.depth-aligned and log\.{flag} exclude"):
        LogOptions(depth_aligned=True, **{name: value})
    LogOptions(depth_aligned=False, **{name: value})


def test_mount_and_poses_come_from_tf_and_odometry(tmp_path):
    static = ros_tf(
        ("base_footprint", "base_link", (0, 0, 0.1), (0, 0, 0, 1)),
        ("base_link", COLOR_FRAME, (0.1, 0.0, 0.4), (-0.5, 0.5, -0.5, 0.5)),
        (COLOR_FRAME, DEPTH_FRAME, (0.015, 0, 0), (0, 0, 0, 1)),
    )
    turn = np.array([0.0, 0.0, np.sin(0.2), np.cos(0.2)])
    for form in ("tf", "odom"):
        with LogFile(tmp_path / "log.mcap") as log:
            write_calibration(log, tf=False)
            log.ros("/tf_static", static, START)
            for step in range(2):
                at = START + step * SECOND // 10
                pose = (1.0 + step, 0.0, 0.0), (turn if step else (0, 0, 0, 1))
                edge = "odom", "base_footprint", *pose
                message = ros_tf(edge, stamp_ns=at) if form == "tf" else ros_odometry(*edge, at)
                log.ros(f"/{form}", message, at)
            write_images(log, scene := make_scene(4))
        with open_log(str(tmp_path / "log.mcap")) as log:
            assert log.base_frame == "base_footprint" and log.T_base_camera is not None
            np.testing.assert_allclose(log.T_base_camera[:3, 3], [0.1, -0.015, 0.5])
            np.testing.assert_allclose(log.T_base_camera[:3, 2], [1, 0, 0], atol=1e-12)
            poses = next(log.batches(5)).frames.T_world_camera
            assert poses is not None and np.isnan(poses[4]).all()
            np.testing.assert_allclose(poses[0, :3, 3], [1.1, -0.015, 0.5])
            part = (scene.depth_ns[3] - START) * 1e-8  # fraction between first and last pose
            turned = Rotation.from_rotvec([0, 0, 0.4 * part]).apply([0.1, -0.015, 0.5])
            np.testing.assert_allclose(poses[3, :3, 3], turned + [1 + part, 0, 0], atol=1e-6)
            assert form in log.description.pose_source.lower()
            read, lost = log.read([1, 3]), log.without_images([1, 3], FrameStatus.TIMEOUT, "why")
            assert (lost.camera_frame, lost.world_frame) == (read.camera_frame, read.world_frame)
            assert (read.camera_frame, read.world_frame) == (DEPTH_FRAME, "odom")
            assert lost.status == (FrameStatus.TIMEOUT,) * 2 and lost.errors == ("why",) * 2
            for name in ("number", "stamp_ns", "color_stamp_ns", "T_world_camera"):
                one, other = getattr(read.frames, name), getattr(lost.frames, name)
                np.testing.assert_array_equal(one, other)
        with pytest.raises(CalibrationError, match=r"'nope' and .*change --log\.world-frame"):
            open_log(str(tmp_path / "log.mcap"), LogOptions(world_frame="nope"))


def test_ambiguous_topics_of_several_cameras_are_an_error(tmp_path):
    with LogFile(tmp_path / "log.mcap") as log:
        for name in ("a", "b"):
            image = ros_image(make_scene().color[0], "rgb8", START, COLOR_FRAME)
            log.ros(f"/{name}/color/image_raw", image, START)
            depth = ros_image(make_scene().depth[0], "16UC1", START, DEPTH_FRAME)
            log.ros(f"/{name}/depth/image_raw", depth, START)
            for kind, size, K in (("color", COLOR_SIZE, COLOR_K), ("depth", DEPTH_SIZE, DEPTH_K)):
                info = ros_info(size, K, START, f"{kind}_optical")
                log.ros(f"/{name}/{kind}/camera_info", info, START)
        log.ros("/tf_static", ros_tf((DEPTH_FRAME, COLOR_FRAME, *T_DEPTH_COLOR)), START)
    with pytest.raises(CamerasError, match=r"several cameras: a, b; choose one with --camera"):
        open_log(str(tmp_path / "log.mcap"))
    with open_log(str(tmp_path / "log.mcap"), LogOptions(color="/b/color/image_raw")) as log:
        assert log.description.choices[0].startswith("depth: /b/depth/image_raw")
    for kind, images in (("color", "color/image_raw"), ("depth", "depth/image_raw")):
        known = rf"--log\.{kind} to one of: /a/{images}, /b/{images}$"
        with pytest.raises(TopicError, match=known):
            open_log(str(tmp_path / "log.mcap"), LogOptions(**{kind: "/c"}))
