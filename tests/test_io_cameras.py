"""Several cameras in a log: names, choice of the camera, notes on the others."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest

from jaxdet.errors import CalibrationError, CamerasError, TopicError
from jaxdet.io import LogOptions, indexed, open_log
from jaxdet.io.topics import camera_name
from tests.io_both_ways import is_indexed, open_both_ways
from tests.io_helpers import (
    COLOR_FRAME,
    COLOR_K,
    COLOR_SIZE,
    START,
    STORE,
    LogFile,
    Scene,
    convert_log,
    make_scene,
    ros_compressed,
    ros_image,
    ros_info,
    ros_tf,
)


@pytest.mark.parametrize(
    "topic, name",
    [
        ("/camera/color/image_raw", "camera"),
        ("/camera/camera/depth/image_rect_raw", "camera"),
        ("/camera/camera/aligned_depth_to_color/image_raw", "camera"),
        ("/front/camera/color/image_raw/compressed", "front"),
        ("/front/depth/image_rect_raw/compressedDepth", "front"),
        ("/robot1/front_camera/rgb/image_rect_color", "robot1/front_camera"),
        ("/robot1/front_camera/depth_registered/sw_registered/image_rect", "robot1/front_camera"),
        ("/zed/zed_node/depth/depth_registered", "zed"),
        ("/camera/camera1/color/image_raw", "camera1"),
        ("/robot/robot_front/depth/image_raw", "robot/robot_front"),
        ("/oak/stereo/image_raw", "oak"),
        ("/depth_to_rgb/image_raw", "camera"),
        ("/front_rgb", "front"),
        ("/device_0/sensor_1/Color_0/image/data", "device_0"),
        ("/camera_1/rgbd", "camera_1"),
        ("rgb", "camera"),
    ],
)
def test_names_of_cameras_come_from_their_topics(topic, name):
    assert camera_name(topic) == name


def add_camera(log: LogFile, name: str, scene: Scene, info: bool = True) -> None:
    """Write colour and aligned depth of a camera, calibrated or not."""
    if info:
        message = ros_info(COLOR_SIZE, COLOR_K, START, COLOR_FRAME)
        log.ros(f"/{name}/color/camera_info", message, START)
    depth_topic = f"/{name}/aligned_depth_to_color/image_raw"
    for color, depth, at, depth_at in zip(*scene, strict=True):
        image = ros_image(depth, "16UC1", int(depth_at), name)
        log.ros(depth_topic, image, int(depth_at))
        log.ros(f"/{name}/color/image_raw", ros_image(color, "rgb8", int(at), name), int(at))


@pytest.fixture
def path(tmp_path):
    """Return a log of the cameras rear, front and one without a calibration."""
    with LogFile(tmp_path / "log.mcap") as log:
        for number, name in enumerate(("rear", "front", "side")):
            add_camera(log, name, make_scene(3 + number, number, COLOR_SIZE), name != "side")
    return str(tmp_path / "log.mcap")


def test_several_cameras_require_a_choice(path):
    with pytest.raises(CamerasError) as caught:
        open_log(path)
    assert caught.value.cameras == ("front", "rear")
    assert "several cameras: front, rear; choose one with --camera" in str(caught.value)
    for name, frames in (("front", 4), ("rear", 3)):
        with open_log(path, LogOptions(camera=name)) as log:
            assert (log.camera, log.label, log.num_frames) == (name, f"log, {name}", frames)
            assert f"/{name}/color/image_raw" in log.description.choices[1]
            assert [line.split(":")[0] for line in log.description.cameras] == [
                "front",
                "rear",
                "side",
            ]
            assert any("camera side is left out: " in text for text in log.description.warnings)
            image = make_scene(frames, frames - 3, COLOR_SIZE).color[1]
            assert (log.read([1], color=True).frames.color[0] == image).all()


def test_choosing_a_camera_that_is_missing_or_uncalibrated_is_an_error(path):
    with pytest.raises(TopicError, match=r"unknown camera 'left'.*one of: front, rear, side"):
        open_log(path, LogOptions(camera="left"))
    with pytest.raises(CalibrationError, match=r"--log\.color-info"):
        open_log(path, LogOptions(camera="side"))


def test_topics_choose_the_camera(path):
    with open_log(path, LogOptions(color="/rear/color/image_raw")) as log:
        assert (log.camera, log.label) == ("rear", "log")
        assert "/rear/aligned" in log.description.choices[0]


def test_flags_for_one_camera_require_a_choice(path):
    options = {"color_intrinsics": (50.0, 50.0, 20.0, 15.0)}
    with pytest.raises(
        TopicError, match=r"--log\.color-intrinsics applies to one camera.*; choose one with --cam"
    ):
        open_log(path, LogOptions(**options))
    with open_log(path, LogOptions(**options, camera="side")) as log:
        assert log.camera == "side"


def test_the_complete_one_of_two_cameras_is_used(tmp_path):
    path = tmp_path / "log.mcap"
    with LogFile(path) as log:
        add_camera(log, "front", make_scene(3, 0, COLOR_SIZE))
        add_camera(log, "side", make_scene(3, 1, COLOR_SIZE), info=False)
    with open_log(str(path)) as log:
        assert log.camera == "front" and log.label == "log, front"
        assert any("camera side is left out" in text for text in log.description.warnings)


def test_a_camera_without_calibration_does_not_cause_a_scan(tmp_path, monkeypatch):
    """A scan for transforms could only supply missing extrinsics."""
    monkeypatch.setattr(indexed, "_MAX_MOTIONS", 10)
    scene = make_scene(3, size=COLOR_SIZE)
    for name, info, by_index in (("side", None, True), ("rear", COLOR_K, False)):
        path = tmp_path / f"{name}.mcap"
        with LogFile(path) as log:
            add_camera(log, "front", scene)
            for number in range(40):
                edge = "odom", "base_link", (0.1 * number, 0, 0), (0, 0, 0, 1)
                log.ros("/tf", ros_tf(edge, stamp_ns=START + number), START + number)
            if info:
                message = ros_info(COLOR_SIZE, info, START, "rear_depth")
                log.ros(f"/{name}/depth/camera_info", message, START)
                message = ros_info(COLOR_SIZE, info, START, "rear_color")
                log.ros(f"/{name}/color/camera_info", message, START)
            depth = ros_image(scene.depth[0], "16UC1", START, "rear_depth")
            log.ros(f"/{name}/depth/image_raw", depth, START)
            log.ros(
                f"/{name}/color/image_raw",
                ros_image(scene.color[0], "rgb8", START, "rear_color"),
                START,
            )
        if by_index:
            with open_log(str(path)) as log:
                assert log.camera == "front" and is_indexed(log)
                left_out = f"camera {name} is left out"
                assert any(left_out in text for text in log.description.warnings)
            continue
        for camera, placed in (("front", True), (name, False)):
            with open_log(str(path), LogOptions(camera=camera)) as log:
                assert log.has_color is placed and (log.description.pairing is None) is placed


def jpeg_depth(log: LogFile, name: str, depth: np.ndarray, at: int) -> None:
    data = cv2.imencode(".jpg", np.clip(depth, 0, 255).astype("u1"))[1].tobytes()
    message = ros_compressed(data, "16UC1; jpeg compressed ", at, name)
    log.ros(f"/{name}/depth/image_raw/compressed", message, at)


def disparity(log: LogFile, name: str, depth: np.ndarray, at: int) -> None:
    image = ros_image(depth.astype("f4"), "32FC1", at, name)
    log.ros(f"/{name}/stereo/disparity", image, at)


def depth_of_64_bits(log: LogFile, name: str, depth: np.ndarray, at: int) -> None:
    log.ros(f"/{name}/depth/image_raw", ros_image(depth.astype("f8"), "64FC1", at, name), at)


def depth_of_8_bits(log: LogFile, name: str, depth: np.ndarray, at: int) -> None:
    log.ros(
        f"/{name}/depth_camera/depth_image", ros_image(depth.astype("u1"), "8UC1", at, name), at
    )


def depth_as_video(log: LogFile, name: str, depth: np.ndarray, at: int) -> None:
    log.json(f"/{name}/depth/image_raw/foxglove", "foxglove.CompressedVideo", {"data": ""}, at)


def without_encoding(log: LogFile, name: str, depth: np.ndarray, at: int) -> None:
    log.raw(f"/{name}/depth/image_raw", "flat", ("sensor_msgs/msg/Image", "", b""), b"", at)


UNREADABLE = [
    (jpeg_depth, "recorded as JPEG"),
    (disparity, "disparity in pixels"),
    (depth_of_64_bits, "encoding '64FC1' is not a supported depth encoding"),
    (depth_of_8_bits, "encoding '8UC1' is not a supported depth encoding"),
    (depth_as_video, "video is not supported"),
    (without_encoding, "flat"),
]


@pytest.mark.parametrize(
    ("write", "reason", "form"),
    [(*case, "mcap") for case in UNREADABLE]
    + [(*case, form) for case in UNREADABLE[:4] for form in ("db3", "bag")],
)
@pytest.mark.parametrize("names", [("front", "rear"), ("robot2/front", "robot1/front")])
def test_a_camera_whose_depth_cannot_be_read_is_reported(tmp_path, names, write, reason, form):
    """The other camera is read as if it were alone; colour of the unreadable one is not used."""
    good, bad = names
    scene = make_scene(3, size=COLOR_SIZE)
    with LogFile(tmp_path / "log.mcap") as log:
        log.ros(f"/{good}/color/camera_info", ros_info(COLOR_SIZE, COLOR_K, START, "a"), START)
        log.ros(f"/{bad}/color/camera_info", ros_info(COLOR_SIZE, COLOR_K, START, "b"), START)
        for color, depth, at in zip(scene.color, scene.depth, scene.depth_ns.tolist(), strict=True):
            image = ros_image(depth, "16UC1", at, "a")
            log.ros(f"/{good}/aligned_depth_to_color/image_raw", image, at)
            log.ros(f"/{bad}/color/image_raw", ros_image(color, "rgb8", at, "b"), at)
            write(log, bad, depth, at)
    path = tmp_path / "log.mcap"
    if form != "mcap":
        path = convert_log(path, tmp_path / ("log.bag" if form == "bag" else "other"))
    with open_both_ways(str(path)) as log:
        assert (log.camera, log.label) == (good, log.name) and not log.has_color
        assert log.description.cameras_left_out == (bad,)
        assert [line.split(":")[0] for line in log.description.cameras] == sorted(names)
        [warning] = [text for text in log.description.warnings if "is left out" in text]
        assert (
            warning.startswith(f"camera {bad} is left out: {path}: /{bad}/") and reason in warning
        )
        np.testing.assert_array_equal(log.read(range(3)).frames.depth, scene.depth)
    with pytest.raises(TopicError, match=reason):
        open_log(str(path), LogOptions(camera=bad))
    with open_log(str(path), LogOptions(depth=f"/{good}/aligned_depth_to_color/image_raw")) as log:
        assert not log.description.cameras_left_out


def write_silent(path: Path, form: str, topics: Sequence[str], *, frames: int = 2) -> Path:
    """Write a log with colour images and topics without messages."""
    with LogFile(path / "log.mcap") as log:
        for number in range(frames):
            image = ros_image(np.zeros((30, 40, 3), "u1"), "rgb8", START + number, "x")
            log.ros("/cam/color/image_raw", image, START + number)
        name = "sensor_msgs/msg/Image"
        text = STORE.generate_msgdef(name, ros_version=2)[0].encode()
        for topic in topics:
            log.declare(topic, "cdr", (name, "ros2msg", text))
    if form == "mcap":
        return path / "log.mcap"
    return convert_log(path / "log.mcap", path / ("log.bag" if form == "bag" else "other"))


@pytest.mark.parametrize("scan", [False, True])
@pytest.mark.parametrize("form", ["mcap", "db3", "bag"])
def test_topics_without_messages_are_described(tmp_path, form, scan):
    path = write_silent(tmp_path, form, ["/cam/depth/image_raw", "/other/image"])
    with pytest.raises(
        TopicError, match=r"no messages on /cam/depth/image_raw; .*driver"
    ) as caught:
        open_log(str(path), LogOptions(scan=scan))
    topics = {topic.topic: (topic.num_messages, topic.problem) for topic in caught.value.topics}
    assert topics == {
        "/cam/color/image_raw": (2, ""),
        "/cam/depth/image_raw": (0, "no messages"),
        "/other/image": (0, "no messages"),
    }
    with pytest.raises(TopicError, match=r"/image_raw: no messages; set --log\.depth"):
        open_log(str(path), LogOptions(depth="/cam/depth/image_raw", scan=scan))


@pytest.mark.parametrize("topics", [[], ["/cam/depth/image_raw"]])
def test_a_log_without_messages_is_an_error(tmp_path, topics):
    path = write_silent(tmp_path, "mcap", topics, frames=0)
    with pytest.raises(TopicError, match="the log has no messages") as caught:
        open_log(str(path))
    assert [topic.topic for topic in caught.value.topics] == topics


def test_a_topic_without_messages_in_one_split_is_counted_in_the_others(tmp_path):
    scene = make_scene(2, size=COLOR_SIZE)
    later = scene._replace(depth_ns=scene.depth_ns + 10**8, color_ns=scene.color_ns + 10**8)
    for number, (one, declared) in enumerate(((scene, "rear"), (later, "front"))):
        with LogFile(tmp_path / f"log_{number}.mcap") as log:
            add_camera(log, "front", one)
            for kind in ("color", "depth"):
                log.declare(f"/{declared}/{kind}/image_raw", "cdr", ("other/msg/Type", "", b""))
    with open_both_ways(str(tmp_path)) as log:
        topics = {
            topic.topic: (topic.num_messages, topic.schema) for topic in log.description.topics
        }
        assert topics["/front/color/image_raw"] == (4, "sensor_msgs/msg/Image")
        assert topics["/rear/color/image_raw"] == (0, "other/msg/Type")
        assert not log.description.warnings and not log.description.cameras


def test_the_error_names_all_cameras_if_none_can_be_read(tmp_path):
    depth = make_scene(1).depth[0]
    with LogFile(tmp_path / "log.mcap") as log:
        for number, (write, _) in enumerate(UNREADABLE):
            write(log, f"camera{number}", depth, START)
    with pytest.raises(TopicError, match="no topic with depth images") as caught:
        open_log(str(tmp_path / "log.mcap"))
    for number, (_, reason) in enumerate(UNREADABLE):
        assert f"/camera{number}/" in str(caught.value) and reason in str(caught.value)


def test_other_images_of_a_camera_are_not_another_camera(tmp_path):
    scene = make_scene(2, size=COLOR_SIZE)
    with LogFile(tmp_path / "log.mcap") as log:
        add_camera(log, "oak", scene)
        for depth, at in zip(scene.depth, scene.depth_ns.tolist(), strict=True):
            grey = ros_image(depth.astype("u1"), "mono8", at, "oak")
            for topic in ("/oak/stereo/disp", "/oak/disparity/disparityImage"):
                log.ros(topic, ros_image(depth.astype("f4"), "32FC1", at, "oak"), at)
            jpeg_depth(log, "oak", depth, at)
            for topic in (
                "/oak/depth/image_colored",
                "/oak/stereo/disparity_viz",
                "/depth_camera/left/image_rect",
                "/flir/depth/mask",
                "/x/rgb_to_depth/image",
            ):
                log.ros(topic, grey, at)
    with open_both_ways(str(tmp_path / "log.mcap")) as log:
        assert log.camera == "oak" and not log.description.cameras
