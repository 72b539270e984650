"""Logs in the layouts of drivers: topics, frames, encodings and rates, from simulated logs.

Each log is read as the simulated one that it was made from. Names are from the drivers'
documentation, sources and issue threads.
"""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import pytest
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

from jaxdet.io import Log, LogOptions, open_log
from jaxdet.sim import SimConfig, write_log
from tests.io_foxglove import put_json, put_proto
from tests.io_helpers import LogFile, ros_header, ros_type
from tests.rewritten import Message, changed, read_messages, write_messages

COLOR, DEPTH = "/camera/camera/color", "/camera/camera/depth"
ALIGNED, EXTRINSICS = "/camera/camera/aligned_depth_to_color", "/camera/camera/extrinsics"
COLOR_FRAME, DEPTH_FRAME = "camera_color_optical_frame", "camera_depth_optical_frame"


class Layout(NamedTuple):
    """Topics, frames and encodings that a driver publishes."""

    form: str
    """Depth in the simulated log: ``raw`` (not aligned to colour), ``aligned`` or ``both``."""
    color: str
    depth: str
    """Topics of images; if ``form`` is ``both``, ``depth`` is aligned depth."""
    camera: str
    """Name of the camera."""
    frame: str
    """Optical frame of colour and of aligned depth."""
    depth_frame: str = ""
    color_encoding: str = "rgb8"
    depth_encoding: str = "16UC1"
    missing: float = float("nan")
    """Value of missing measurements, if depth is in metres."""
    model: str = "plumb_bob"
    coefficients: int = 5
    raw_depth: str = ""
    """Topic of raw depth, in addition to aligned depth."""
    info: str = ""
    """Topic of the only calibration; if empty, each image topic has one."""
    others: tuple[tuple[str, str], ...] = ()
    """Topics and encodings of images that are neither colour nor depth."""
    rate_hz: float = 30.0
    colors: int = 1
    """Every ``colors``-th colour image is recorded."""
    odom: str = "/odom"
    poses: str = "TF"
    """Source of poses: TF or a topic of odometry; empty if there are none."""


LAYOUTS = {
    "RealSense": Layout(
        "raw",
        "/camera/camera/color/image_raw",
        "/camera/camera/depth/image_rect_raw",
        "camera",
        COLOR_FRAME,
        DEPTH_FRAME,
        others=(
            ("/camera/camera/infra1/image_rect_raw", "mono8"),
            ("/camera/camera/infra2/image_rect_raw", "mono8"),
        ),
        colors=2,
    ),
    "RealSense of ROS 1, aligned": Layout(
        "both",
        "/camera/color/image_raw",
        "/camera/aligned_depth_to_color/image_raw",
        "camera",
        COLOR_FRAME,
        DEPTH_FRAME,
        raw_depth="/camera/depth/image_rect_raw",
    ),
    "RealSense of a robot": Layout(
        "raw",
        "/robot1/D455_1/color/image_raw",
        "/robot1/D455_1/depth/image_rect_raw",
        "robot1/D455_1",
        "D455_1_color_optical_frame",
        "D455_1_depth_optical_frame",
        rate_hz=15.0,
    ),
    "OAK-D": Layout(
        "aligned",
        "/oak/rgb/image_raw",
        "/oak/stereo/image_raw",
        "oak",
        "oak_rgb_camera_optical_frame",
        color_encoding="bgr8",
        model="rational_polynomial",
        coefficients=8,
        others=(("/oak/left/image_raw", "mono8"), ("/oak/right/image_raw", "mono8")),
    ),
    "OAK-D of a TurtleBot 4": Layout(
        "aligned",
        "/oakd/rgb/preview/image_raw",
        "/oakd/stereo/image_raw",
        "oakd",
        "oakd_rgb_camera_optical_frame",
        color_encoding="bgr8",
        model="rational_polynomial",
        coefficients=8,
        rate_hz=10.0,
    ),
    "ZED": Layout(
        "aligned",
        "/zed/zed_node/rgb/color/rect/image",
        "/zed/zed_node/depth/depth_registered",
        "zed",
        "zed_left_camera_frame_optical",
        color_encoding="bgra8",
        depth_encoding="32FC1",
        others=(
            ("/zed/zed_node/left/color/rect/image", "bgra8"),
            ("/zed/zed_node/right/color/rect/image", "bgra8"),
            ("/zed/zed_node/confidence/confidence_map", "32FC1"),
            ("/zed/zed_node/disparity/disparity_image", "32FC1"),
        ),
        rate_hz=15.0,
        odom="/zed/zed_node/odom",
    ),
    "ZED of older drivers, in millimetres": Layout(
        "aligned",
        "/zed2/zed_node/rgb/image_rect_color",
        "/zed2/zed_node/depth/depth_registered",
        "zed2/zed_node",
        "zed2_left_camera_optical_frame",
        color_encoding="bgra8",
        others=(("/zed2/zed_node/confidence/confidence_map", "32FC1"),),
        rate_hz=15.0,
    ),
    "Orbbec": Layout(
        "raw",
        "/camera/color/image_raw",
        "/camera/depth/image_raw",
        "camera",
        "camera_color_optical_frame",
        "camera_depth_optical_frame",
        coefficients=8,
        others=(("/camera/ir/image_raw", "mono16"),),
    ),
    "Kinect 2": Layout(
        "aligned",
        "/kinect2/hd/image_color_rect",
        "/kinect2/hd/image_depth_rect",
        "kinect2/hd",
        "kinect2_rgb_optical_frame",
        color_encoding="bgr8",
        others=(("/kinect2/sd/image_ir_rect", "mono16"), ("/kinect2/hd/image_mono", "mono8")),
    ),
    "Azure Kinect": Layout(
        "both",
        "/rgb/image_raw",
        "/depth_to_rgb/image_raw",
        "camera",
        "rgb_camera_link",
        "depth_camera_link",
        color_encoding="bgra8",
        model="rational_polynomial",
        coefficients=8,
        raw_depth="/depth/image_raw",
        others=(("/ir/image_raw", "mono16"), ("/rgb_to_depth/image_raw", "bgra8")),
    ),
    "Azure Kinect, in metres": Layout(
        "raw",
        "/rgb/image_raw",
        "/depth/image_raw",
        "camera",
        "rgb_camera_link",
        "depth_camera_link",
        color_encoding="bgra8",
        depth_encoding="32FC1",
        model="rational_polynomial",
        coefficients=8,
        others=(("/ir/image_raw", "mono16"),),
        rate_hz=5.0,
    ),
    "Spot": Layout(
        "aligned",
        "/spot/camera/frontleft/image",
        "/spot/depth_registered/frontleft/image",
        "spot/frontleft",
        "frontleft_fisheye",
        rate_hz=10.0,
        odom="/spot/odometry",
    ),
    "Gazebo": Layout(
        "aligned",
        "/rgbd_camera/image",
        "/rgbd_camera/depth_image",
        "camera",
        "rgbd_camera_optical_frame",
        depth_encoding="32FC1",
        missing=float("inf"),
        info="/rgbd_camera/camera_info",
        rate_hz=10.0,
        poses="/model/robot/odometry",
        odom="/model/robot/odometry",
    ),
    "Gazebo Classic": Layout(
        "aligned",
        "/camera/image_raw",
        "/camera/depth/image_raw",
        "camera",
        "camera_link_optical",
        depth_encoding="32FC1",
    ),
    "RealSense without a namespace, compact names": Layout(
        "raw",
        "/color/image_raw",
        "/depth/image_rect_raw",
        "camera",
        COLOR_FRAME,
        DEPTH_FRAME,
    ),
    "RealSense on a Stretch, in the gripper": Layout(
        "aligned",
        "/gripper_camera/color/image_rect_raw",
        "/gripper_camera/aligned_depth_to_color/image_raw",
        "gripper_camera",
        "gripper_camera_color_optical_frame",
    ),
    "Clearpath's robots": Layout(
        "raw",
        "/a200_0000/sensors/camera_0/color/image",
        "/a200_0000/sensors/camera_0/depth/image",
        "a200_0000/sensors/camera_0",
        "camera_0_color_optical_frame",
        "camera_0_depth_optical_frame",
        odom="/a200_0000/platform/odom",
    ),
    "Husky of ROS 1": Layout(
        "raw",
        "/realsense/color/image_raw",
        "/realsense/depth/image_rect_raw",
        "realsense",
        "camera_realsense_color_optical_frame",
        "camera_realsense_depth_optical_frame",
    ),
    "OAK-D, not aligned": Layout(
        "raw",
        "/oak/rgb/image_raw",
        "/oak/stereo/image_raw",
        "oak",
        "oak_rgb_camera_optical_frame",
        "oak_right_camera_optical_frame",
        color_encoding="bgr8",
        others=(
            ("/oak/left/image_raw", "mono8"),
            ("/oak/right/image_raw", "mono8"),
            ("/oak/left/image_rect", "mono8"),
            ("/oak/right/image_rect", "mono8"),
        ),
    ),
    "OAK-D of depthai_examples": Layout(
        "aligned",
        "/stereo_inertial_publisher/color/image",
        "/stereo_inertial_publisher/stereo/depth",
        "inertial_publisher",
        "oak_rgb_camera_optical_frame",
        color_encoding="bgr8",
        others=(("/stereo_inertial_publisher/right/image_rect", "mono8"),),
    ),
    "two ZEDs": Layout(
        "aligned",
        "/zed_multi/zed_front/rgb/color/rect/image",
        "/zed_multi/zed_front/depth/depth_registered",
        "zed_multi/zed_front",
        "zed_front_left_camera_frame_optical",
        color_encoding="bgra8",
        depth_encoding="32FC1",
    ),
    "Orbbec, registered by the camera": Layout(
        "aligned",
        "/camera_01/color/image_raw",
        "/camera_01/depth/image_raw",
        "camera_01",
        "camera_01_color_optical_frame",
        others=(
            ("/camera_01/left_ir/image_raw", "mono8"),
            ("/camera_01/right_ir/image_raw", "mono8"),
        ),
    ),
    "Astra and Kinect of openni2_launch": Layout(
        "both",
        "/camera/rgb/image_raw",
        "/camera/depth_registered/image_raw",
        "camera",
        "camera_rgb_optical_frame",
        "camera_depth_optical_frame",
        raw_depth="/camera/depth/image_raw",
        others=(("/camera/ir/image", "mono16"),),
    ),
    "TIAGo": Layout(
        "aligned",
        "/xtion/rgb/image_rect_color",
        "/xtion/depth_registered/image_raw",
        "xtion",
        "xtion_rgb_optical_frame",
        others=(("/xtion/rgb/image_raw", "rgb8"),),
    ),
    "Kinect 2, quarter HD with one calibration": Layout(
        "aligned",
        "/kinect2/qhd/image_color_rect",
        "/kinect2/qhd/image_depth_rect",
        "kinect2/qhd",
        "kinect2_rgb_optical_frame",
        color_encoding="bgr8",
        info="/kinect2/qhd/camera_info",
    ),
    "Kinect 2, resolution of the sensor": Layout(
        "aligned",
        "/kinect2/sd/image_color_rect",
        "/kinect2/sd/image_depth_rect",
        "kinect2/sd",
        "kinect2_ir_optical_frame",
        color_encoding="bgr8",
        info="/kinect2/sd/camera_info",
        others=(("/kinect2/sd/image_ir_rect", "mono16"),),
    ),
    "Azure Kinect with a namespace": Layout(
        "both",
        "/k4a/rgb/image_raw",
        "/k4a/depth_to_rgb/image_raw",
        "k4a",
        "rgb_camera_link",
        "depth_camera_link",
        color_encoding="bgra8",
        raw_depth="/k4a/depth/image_raw",
        others=(("/k4a/ir/image_raw", "mono16"), ("/k4a/rgb_to_depth/image_raw", "bgra8")),
    ),
    "Spot, not registered": Layout(
        "raw",
        "/spot/camera/frontleft/image",
        "/spot/depth/frontleft/image",
        "spot/frontleft",
        "frontleft_fisheye",
        "frontleft",
        rate_hz=10.0,
        odom="/spot/odometry",
    ),
    "Spot of ROS 1": Layout(
        "both",
        "/camera/back/image",
        "/depth_registered/back/image",
        "back",
        "back_fisheye",
        "back",
        raw_depth="/depth/back/image",
    ),
    "Gazebo with the topics of its world": Layout(
        "aligned",
        "/world/w/model/robot/link/camera_link/sensor/rgbd/image",
        "/world/w/model/robot/link/camera_link/sensor/rgbd/depth_image",
        "world/w/model/robot/link/camera_link",
        "robot/camera_link/rgbd",
        depth_encoding="32FC1",
        missing=float("-inf"),
        info="/world/w/model/robot/link/camera_link/sensor/rgbd/camera_info",
    ),
    "Isaac Sim, several cameras": Layout(
        "aligned",
        "/rgb_left",
        "/depth_left",
        "left",
        "carter_camera_stereo_left",
        depth_encoding="32FC1",
        missing=float("inf"),
        info="/camera_info_left",
    ),
    "Webots": Layout(
        "aligned",
        "/my_robot/camera/image_color",
        "/my_robot/range_finder/image",
        "my_robot/range_finder",
        "camera",
        color_encoding="bgra8",
        depth_encoding="32FC1",
        missing=float("inf"),
    ),
    "Isaac Sim": Layout(
        "aligned",
        "/rgb",
        "/depth",
        "camera",
        "sim_camera",
        depth_encoding="32FC1",
        info="/camera_info",
        odom="/chassis/odom",
    ),
}


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, float], Path]:
    """Return a function that makes the simulated log of a form and a rate once."""
    folder = tmp_path_factory.mktemp("layouts")

    def path_of(form: str, rate_hz: float) -> Path:
        path = folder / f"{form}_{rate_hz:g}.mcap"
        if not path.exists():
            size: dict[str, Any] = {"frames": 6, "width": 160, "height": 120}
            how = {"depth_form": form, "rate_hz": rate_hz, "extrinsics": "tf"}
            write_log(path, SimConfig(**size, **how))
        return path

    return path_of


def renamed(body: Any, frames: dict[str, str]) -> Any:
    """Return a message with renamed frames."""
    if isinstance(body, dict):
        return {name: renamed(value, frames) for name, value in body.items()}
    if isinstance(body, list):
        return [renamed(value, frames) for value in body]
    return frames.get(body, body) if isinstance(body, str) else body


def info_topic(image: str) -> str:
    return f"{image.rpartition('/')[0]}/camera_info"


def published(layout: Layout, messages: Iterable[Message]) -> list[Message]:
    """Return the messages of a simulated log as a driver publishes them."""
    frames = {COLOR_FRAME: layout.frame, DEPTH_FRAME: layout.depth_frame or DEPTH_FRAME}
    shown = ALIGNED if layout.form in ("aligned", "both") else DEPTH
    topics = {
        f"{COLOR}/image_raw": layout.color,
        f"{COLOR}/camera_info": layout.info or info_topic(layout.color),
        f"{shown}/image_raw": layout.depth,
        f"{shown}/camera_info": "" if layout.info else info_topic(layout.depth),
        "/odom": layout.odom,
        "/tf": "/tf" if layout.poses == "TF" else "",
    }
    raw = layout.raw_depth or layout.depth
    topics |= {f"{DEPTH}/image_rect_raw": raw, f"{DEPTH}/camera_info": info_topic(raw)}
    colors = 0

    def change(message: Message) -> list[Message] | None:
        nonlocal colors
        if not (topic := topics.get(message.topic, message.topic)):
            return []
        message.topic, message.body = topic, renamed(message.body, frames)
        if message.kind == "sensor_msgs/CameraInfo":
            lens = {"distortion_model": layout.model, "d": [0.0] * layout.coefficients}
            message.body |= lens
        if topic == layout.color:
            colors += 1
            show_color(message, layout.color_encoding)
            return [message, *decoys(layout, message)] if colors % layout.colors == 0 else []
        if topic in (layout.depth, layout.raw_depth) and layout.depth_encoding == "32FC1":
            depth = message.pixels.astype(np.float32) / np.float32(1000)
            depth[depth == 0] = layout.missing
            message.show(depth, "32FC1")
        return None

    return changed(messages, change)


def show_color(message: Message, encoding: str) -> None:
    """Put an image into another encoding."""
    rgb = message.pixels
    if encoding == "rgb8":
        return
    bgr = rgb[..., ::-1]
    opaque = np.full((*rgb.shape[:2], 1), 255, np.uint8)
    message.show(np.concatenate([bgr, opaque], axis=2) if encoding == "bgra8" else bgr, encoding)


def decoys(layout: Layout, like: Message) -> Iterable[Message]:
    """Yield images of other kinds at the time of a colour image, each with a calibration."""
    grey = like.pixels[..., 0]
    images = {"mono8": grey, "mono16": grey.astype(np.uint16) << 8, "32FC1": grey / np.float32(2)}
    for topic, encoding in layout.others:
        (other,) = changed([like])
        other.topic = topic
        other.show(images.get(encoding, like.pixels), encoding)
        yield other


def same_log(found: Log, expected: Log) -> None:
    """Assert that frames, colour, calibration, mount and poses are equal."""
    assert found.calibration == expected.calibration
    batches = [log.read(range(log.num_frames), color=True).frames for log in (found, expected)]
    for name in ("depth", "color", "stamp_ns", "color_stamp_ns", "valid", "T_world_camera"):
        np.testing.assert_array_equal(*(getattr(frames, name) for frames in batches), name)
    np.testing.assert_array_equal(found.T_base_camera, expected.T_base_camera)


@pytest.mark.parametrize("driver", LAYOUTS)
def test_logs_of_each_driver_equal_the_simulated_one(simulated, tmp_path, driver):
    layout = LAYOUTS[driver]
    path = simulated(layout.form, layout.rate_hz)
    messages = read_messages(path)
    kept = [m for m in messages if m.topic != f"{COLOR}/image_raw"]
    images = [m for m in messages if m.topic == f"{COLOR}/image_raw"]
    fewer = [*kept, *images[layout.colors - 1 :: layout.colors]]
    plain = write_messages(tmp_path / "plain.mcap", fewer)
    log_path = write_messages(tmp_path / "log.mcap", published(layout, messages))
    with open_log(log_path) as found, open_log(plain) as expected:
        about = found.description
        chosen = {topic.chosen_as: topic.topic for topic in about.topics if topic.chosen_as}
        assert chosen == {"color": layout.color, "depth": layout.depth}
        assert found.camera == layout.camera and not about.warnings
        frame = layout.frame if layout.form != "raw" else layout.depth_frame
        assert found.camera_frame == frame and found.color_frame == layout.frame
        rates = {topic.topic: topic.rate_hz for topic in about.topics}
        assert rates[layout.depth] == pytest.approx(layout.rate_hz, rel=0.02)
        same_log(found, expected)


@pytest.mark.parametrize("form", ["raw", "aligned"])
@pytest.mark.parametrize("encoding", ["protobuf", "json", "cdr"])
@pytest.mark.parametrize("compressed", [False, True])
def test_logs_of_the_foxglove_sdk_equal_the_simulated_one(
    simulated, tmp_path, form, encoding, compressed
):
    """Each transform is a separate message; CDR has the types of ``foxglove_msgs``."""
    path = simulated(form, 30.0)
    with LogFile(tmp_path / "log.mcap") as log:
        for message in read_messages(path):
            write_foxglove(log, message, encoding, compressed)
    with open_log(tmp_path / "log.mcap") as found, open_log(path) as expected:
        assert not found.description.warnings
        same_log(found, expected)


def write_foxglove(log: LogFile, message: Message, encoding: str, compressed: bool) -> None:
    """Write a message in the schemas of Foxglove, which has none for odometry."""
    body, at = message.body, message.log_ns
    if message.kind == "tf2_msgs/TFMessage":
        for item in body["transforms"]:
            ends = {"parent_frame_id": item["header"]["frame_id"]}
            ends["child_frame_id"] = item["child_frame_id"]
            put(log, message.topic, FrameTransform, ends | item["transform"], at, encoding)
        return
    if message.kind not in ("sensor_msgs/Image", "sensor_msgs/CameraInfo"):
        return
    stamp = body["header"]["stamp"]
    fields: dict[str, Any] = {"frame_id": body["header"]["frame_id"]}
    size = {"width": body["width"], "height": body["height"]}
    if message.kind == "sensor_msgs/CameraInfo":
        fields |= size | {"distortion_model": body["distortion_model"], "D": body["d"]}
        fields |= {"K": body["k"], "R": body["r"], "P": body["p"]}
        kind: Any = CameraCalibration
    elif compressed:
        pixels = message.pixels
        png = cv2.imencode(".png", pixels[..., ::-1] if pixels.ndim == 3 else pixels)[1]
        fields |= {"data": png.tobytes(), "format": "png"}
        kind = CompressedImage
    else:
        fields |= size | {"encoding": body["encoding"], "step": body["step"], "data": body["data"]}
        kind = RawImage
    at = stamp["sec"] * 10**9 + stamp["nanosec"]
    put(log, message.topic, kind, fields, at, encoding)


def put(
    log: LogFile, topic: str, kind: Any, fields: dict[str, Any], at: int, encoding: str
) -> None:
    """Write a message of Foxglove in an encoding."""
    if encoding != "cdr":
        (put_proto if encoding == "protobuf" else put_json)(log, topic, kind, fields, at)
        return
    point, turn = (ros_type(f"geometry_msgs/msg/{name}") for name in ("Vector3", "Quaternion"))
    make: dict[str, Callable[[Any], Any]] = {"data": lambda data: np.frombuffer(data, np.uint8)}
    make |= {"translation": lambda t: point(**t), "rotation": lambda q: turn(**q)}
    make |= dict.fromkeys("DKRP", lambda values: np.array(values, np.float64))
    values = {
        name.lower() if name in "DKRP" else name: make.get(name, lambda same: same)(value)
        for name, value in fields.items()
    }
    stamp = ros_header(at, "").stamp
    message = ros_type(kind.DESCRIPTOR.full_name.replace("foxglove.", "foxglove_msgs/msg/"))
    log.ros(topic, message(stamp, **values), at)


def test_the_two_front_cameras_of_a_spot_are_separate_cameras(simulated, tmp_path):
    layout = LAYOUTS["Spot"]
    path = simulated(layout.form, layout.rate_hz)
    left = published(layout, read_messages(path))

    def to_the_right(message: Message) -> list[Message] | None:
        if "frontleft" not in message.topic:
            return []
        message.topic = message.topic.replace("frontleft", "frontright")
        return None

    both = write_messages(tmp_path / "log.mcap", [*left, *changed(left, to_the_right)])
    for camera in ("spot/frontleft", "spot/frontright"):
        options = LogOptions(camera=camera)
        with open_log(both, options) as found, open_log(path) as expected:
            same_log(found, expected)


@pytest.mark.parametrize(
    ("driver", "color", "other", "frame", "wide"),
    [
        ("ZED", "rgb/color/rect/image", "stereo/color/rect/image", "", 2),
        ("ZED", "left/color/rect/image", "right/color/rect/image", "zed_right_optical", 1),
        ("OAK-D", "rgb/image_raw", "rgb/preview/image_raw", "", 0.5),
        ("OAK-D", "left/image_rect_color", "right/image_rect_color", "oak_right_optical", 1),
    ],
)
def test_colour_with_the_frame_and_size_of_depth_is_preferred(
    simulated, tmp_path, driver, color, other, frame, wide
):
    given = LAYOUTS[driver]
    root = given.color[: -len("rgb/image_raw" if driver == "OAK-D" else "rgb/color/rect/image")]
    layout = given._replace(color=root + color, others=())

    def add(message: Message) -> list[Message] | None:
        if message.topic not in (layout.color, info_topic(layout.color)):
            return None
        (more,) = changed([message])
        more.topic = message.topic.replace(
            root + color.rpartition("/")[0], root + other.rpartition("/")[0]
        )
        header = more.body["header"]
        header["frame_id"] = frame or header["frame_id"]
        if message.kind == "sensor_msgs/Image":
            more.show(cv2.resize(more.pixels, None, fx=wide, fy=1))
        return [message, more]

    path = simulated(layout.form, layout.rate_hz)
    both = changed(published(layout, read_messages(path)), add)
    with open_log(write_messages(tmp_path / "log.mcap", both)) as found, open_log(path) as expected:
        assert {topic.topic for topic in found.description.topics} >= {root + color, root + other}
        assert not found.description.warnings
        same_log(found, expected)


def test_the_rectified_image_is_used_with_rectified_depth(simulated, tmp_path):
    """Its calibration has no distortion, so that of the camera must not be applied to depth."""
    layout = LAYOUTS["Kinect 2, quarter HD with one calibration"]
    path = simulated(layout.form, layout.rate_hz)

    def distort(message: Message) -> list[Message] | None:
        if message.kind == "sensor_msgs/CameraInfo":
            message.body["d"] = [0.05, -0.1, 0.0, 0.0, 0.0]
        if message.topic != layout.color:
            return None
        (raw,) = changed([message])
        raw.topic = raw.topic.removesuffix("_rect")
        return [message, raw]

    messages = changed(published(layout, read_messages(path)), distort)
    with open_log(write_messages(tmp_path / "log.mcap", messages)) as found, open_log(path) as log:
        assert found.calibration.image[:6] == log.calibration.image[:6]
        assert found.calibration.image.distortion == "none"
