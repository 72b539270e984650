"""Logs for tests of ``jaxdet.io``, written with rosbags, mcap and the schemas of Foxglove."""

import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer
from mcap_protobuf.schema import register_schema
from rosbags.convert.converter import convert
from rosbags.rosbag1 import Writer as BagWriter
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from jaxdet.errors import FrameStatus
from jaxdet.io import Log
from jaxdet.io.motion import inverse, motion_matrix

REALSENSE = {
    "realsense2_camera_msgs/msg/Extrinsics": "float64[9] rotation\nfloat64[3] translation\n",
    "realsense2_camera_msgs/msg/RGBD": (
        "std_msgs/Header header\nsensor_msgs/CameraInfo rgb_camera_info\n"
        "sensor_msgs/CameraInfo depth_camera_info\nsensor_msgs/Image rgb\n"
        "sensor_msgs/Image depth\n"
    ),
}
REALSENSE_ROS1 = {
    "realsense2_camera/msg/Extrinsics": "std_msgs/Header header\n"
    + REALSENSE["realsense2_camera_msgs/msg/Extrinsics"]
}
_STAMPED = "builtin_interfaces/Time timestamp\nstring frame_id\n"
FOXGLOVE = {
    "foxglove_msgs/msg/RawImage": f"{_STAMPED}uint32 width\nuint32 height\nstring encoding\n"
    "uint32 step\nuint8[] data\n",
    "foxglove_msgs/msg/CompressedImage": f"{_STAMPED}uint8[] data\nstring format\n",
    "foxglove_msgs/msg/CameraCalibration": f"{_STAMPED}uint32 width\nuint32 height\n"
    "string distortion_model\nfloat64[] d\nfloat64[9] k\nfloat64[9] r\nfloat64[12] p\n",
    "foxglove_msgs/msg/FrameTransform": "builtin_interfaces/Time timestamp\n"
    "string parent_frame_id\nstring child_frame_id\n"
    "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n",
}
STORE = get_typestore(Stores.ROS2_JAZZY)
for _name, _text in {**REALSENSE, **REALSENSE_ROS1, **FOXGLOVE}.items():
    STORE.register(get_types_from_msg(_text, _name))

COLOR, DEPTH = "/cam/color/image_raw", "/cam/depth/image_rect_raw"
COLOR_INFO, DEPTH_INFO = "/cam/color/camera_info", "/cam/depth/camera_info"
COLOR_FRAME, DEPTH_FRAME = "color_optical", "depth_optical"
COLOR_SIZE, DEPTH_SIZE = (40, 30), (32, 24)
COLOR_K, DEPTH_K = (50.0, 51.0, 20.5, 14.5), (30.0, 30.5, 15.5, 11.5)
T_DEPTH_COLOR = (-0.015, 0.001, 0.0), (0.0, 0.1, 0.0, np.sqrt(0.99))
T_COLOR_DEPTH = inverse(motion_matrix(*(np.array(item) for item in T_DEPTH_COLOR)))
SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND


class LogFile:
    """Writer of an MCAP file; a context manager."""

    def __init__(
        self, path: Path, compression: str = "zstd", crc: bool = True, **options: Any
    ) -> None:
        self._stream = path.open("wb")
        self._writer = Writer(
            self._stream,
            compression=getattr(CompressionType, compression.upper()),
            enable_crcs=crc,
            **options,
        )
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}

    def __enter__(self) -> "LogFile":
        self._writer.start("ros2", "tests")
        return self

    def __exit__(self, *_: object) -> None:
        self._writer.finish()
        self._stream.close()

    def raw(
        self, topic: str, encoding: str, schema: tuple[str, str, bytes], data: bytes, log_ns: int
    ) -> None:
        self.declare(topic, encoding, schema)
        self._writer.add_message(self._channels[topic], log_ns, data, log_ns)

    def declare(self, topic: str, encoding: str, schema: tuple[str, str, bytes]) -> None:
        name, kind, text = schema
        if name not in self._schemas:
            self._schemas[name] = self._writer.register_schema(name, kind, text)
        if topic not in self._channels:
            schema_id = self._schemas[name]
            self._channels[topic] = self._writer.register_channel(topic, encoding, schema_id)

    def ros(self, topic: str, message: Any, log_ns: int, little_endian: bool = True) -> None:
        name = message.__msgtype__
        text = STORE.generate_msgdef(name, ros_version=2)[0].encode()
        data = bytes(STORE.serialize_cdr(message, name, little_endian=little_endian))
        self.raw(topic, "cdr", (name, "ros2msg", text), data, log_ns)

    def proto(self, topic: str, message: Any, log_ns: int) -> None:
        name = message.DESCRIPTOR.full_name
        if name not in self._schemas:
            self._schemas[name] = register_schema(self._writer, type(message))
        self.raw(topic, "protobuf", (name, "", b""), message.SerializeToString(), log_ns)

    def json(self, topic: str, schema: str, message: dict[str, Any], log_ns: int) -> None:
        text = json.dumps({"type": "object"}).encode()
        data = json.dumps(message).encode()
        self.raw(topic, "json", (schema, "jsonschema", text), data, log_ns)


def ros_type(name: str) -> Any:
    return STORE.types[name]


def ros_header(stamp_ns: int, frame: str) -> Any:
    time = ros_type("builtin_interfaces/msg/Time")(*divmod(stamp_ns, SECOND))
    return ros_type("std_msgs/msg/Header")(time, frame)


def ros_image(
    pixels: np.ndarray,
    encoding: str,
    stamp_ns: int,
    frame: str,
    padding: int = 0,
    big: bool = False,
) -> Any:
    """Return an Image of any dtype; ``big`` sets the byte order and swaps multi-byte pixels."""
    height, width = pixels.shape[:2]
    rows = pixels.astype(pixels.dtype.newbyteorder(">" if big else "<")).reshape(height, -1)
    data = np.ascontiguousarray(rows).view(np.uint8).reshape(height, -1)
    data = np.pad(data, ((0, 0), (0, padding)), constant_values=255)
    header = ros_header(stamp_ns, frame)
    flat = np.ascontiguousarray(data).reshape(-1)
    image = ros_type("sensor_msgs/msg/Image")
    return image(header, height, width, encoding, int(big), data.shape[1], flat)


def ros_compressed(data: bytes, form: str, stamp_ns: int, frame: str) -> Any:
    message = ros_type("sensor_msgs/msg/CompressedImage")
    return message(ros_header(stamp_ns, frame), form, np.frombuffer(data, np.uint8))


def encode_rvl(pixels: np.ndarray) -> bytes:
    """Return an RVL stream by Wilson's encoder, pixel by pixel."""
    nibbles: list[int] = []

    def number(value: int) -> None:
        while True:
            low, value = value & 7, value >> 3
            nibbles.append(low | 8 if value else low)
            if not value:
                return

    flat, at, previous = [int(value) for value in pixels.reshape(-1)], 0, 0
    while at < len(flat):
        for wanted in (True, False):
            end = at
            while end < len(flat) and (flat[end] == 0) == wanted:
                end += 1
            number(end - at)
            for value in flat[at:end] if not wanted else ():
                delta, previous = value - previous, value
                number(2 * delta if delta >= 0 else -2 * delta - 1)
            at = end
    nibbles += [0] * (-len(nibbles) % 8)
    words = np.array(nibbles, np.uint32).reshape(-1, 8)
    return (words << np.arange(28, -1, -4, dtype=np.uint32)).sum(axis=1).astype("<u4").tobytes()


def matrix9(K: tuple[float, ...]) -> list[float]:
    return [K[0], 0.0, K[2], 0.0, K[1], K[3], 0.0, 0.0, 1.0]


def ros_info(
    size: tuple[int, int],
    K: tuple[float, ...],
    stamp_ns: int,
    frame: str,
    model: str = "plumb_bob",
    D: tuple[float, ...] = (0.0,) * 5,
    P: tuple[float, ...] | None = None,
) -> Any:
    roi = ros_type("sensor_msgs/msg/RegionOfInterest")(0, 0, 0, 0, False)
    k = matrix9(K)
    p = P or (*k[:3], 0.0, *k[3:6], 0.0, *k[6:], 0.0)
    arrays = [np.array(item, np.float64) for item in (D, k, np.eye(3).reshape(-1), p)]
    info = ros_type("sensor_msgs/msg/CameraInfo")
    return info(ros_header(stamp_ns, frame), size[1], size[0], model, *arrays, 0, 0, roi)


def _ros_motion(t: Any, q: Any, point: str) -> tuple[Any, Any]:
    vector = ros_type(f"geometry_msgs/msg/{point}")(*(float(item) for item in t))
    return vector, ros_type("geometry_msgs/msg/Quaternion")(*(float(item) for item in q))


def ros_tf(*edges: tuple[str, str, Any, Any], stamp_ns: int = START) -> Any:
    """Return a TFMessage of (parent, child, translation, quaternion)."""
    transform = ros_type("geometry_msgs/msg/Transform")
    stamped = ros_type("geometry_msgs/msg/TransformStamped")
    items = [
        stamped(ros_header(stamp_ns, parent), child, transform(*_ros_motion(t, q, "Vector3")))
        for parent, child, t, q in edges
    ]
    return ros_type("tf2_msgs/msg/TFMessage")(items)


def ros_odometry(parent: str, child: str, t: Any, q: Any, stamp_ns: int) -> Any:
    geometry = "geometry_msgs/msg/"
    pose = ros_type(geometry + "Pose")(*_ros_motion(t, q, "Point"))
    zero = [ros_type(geometry + "Vector3")(0.0, 0.0, 0.0) for _ in range(2)]
    twist = ros_type(geometry + "Twist")(*zero)
    covariance = np.zeros(36)
    return ros_type("nav_msgs/msg/Odometry")(
        ros_header(stamp_ns, parent),
        child,
        ros_type(geometry + "PoseWithCovariance")(pose, covariance),
        ros_type(geometry + "TwistWithCovariance")(twist, covariance),
    )


class Scene(NamedTuple):
    """Random images with timestamps; depth is some milliseconds earlier than colour."""

    color: np.ndarray
    depth: np.ndarray
    color_ns: np.ndarray
    depth_ns: np.ndarray


def make_scene(count: int = 3, seed: int = 0, size: tuple[int, int] = DEPTH_SIZE) -> Scene:
    random = np.random.default_rng(seed)
    color = random.integers(0, 256, (count, COLOR_SIZE[1], COLOR_SIZE[0], 3), np.uint8)
    depth = random.integers(1, 9000, (count, size[1], size[0])).astype(np.uint16)
    depth[random.random(depth.shape) < 0.3] = 0
    stamps = START + np.arange(count) * 33_333_333
    return Scene(color, depth, stamps, stamps - 4_000_000)


def write_calibration(log: LogFile, aligned: bool = False, tf: bool = True) -> None:
    log.ros(COLOR_INFO, ros_info(COLOR_SIZE, COLOR_K, START, COLOR_FRAME), START)
    if not aligned:
        log.ros(DEPTH_INFO, ros_info(DEPTH_SIZE, DEPTH_K, START, DEPTH_FRAME), START)
        if tf:
            log.ros("/tf_static", ros_tf((DEPTH_FRAME, COLOR_FRAME, *T_DEPTH_COLOR)), START)


def write_images(log: LogFile, scene: Scene, depth_topic: str = DEPTH) -> None:
    frame = COLOR_FRAME if "aligned" in depth_topic else DEPTH_FRAME
    for color, depth, at, depth_at in zip(*scene, strict=True):
        log.ros(depth_topic, ros_image(depth, "16UC1", int(depth_at), frame), int(depth_at))
        log.ros(COLOR, ros_image(color, "rgb8", int(at), COLOR_FRAME), int(at))


def write_log(path: Path, scene: Scene | None = None, **options: Any) -> Path:
    """Write an unaligned log like that of a RealSense."""
    with LogFile(path, **options) as log:
        write_calibration(log)
        write_images(log, scene or make_scene())
    return path


def convert_log(source: Path, target: Path, compress: str | None = None) -> Path:
    """Convert a log by rosbags; return the file. Bags have a chunk per image."""

    def small(writer: BagWriter, path: Path) -> None:
        init(writer, path)
        writer.chunk_threshold = 1 << 10

    given = "sqlite3", 9, compress, "file", get_typestore(Stores.EMPTY), None
    init = BagWriter.__init__
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(BagWriter, "__init__", small)
        convert([source], target, *given, (), (), (), ())
    return target if target.suffix == ".bag" else target / f"{target.name}.db3"


def assert_holds(log: Log, scene: Scene, batch_size: int = 2) -> None:
    """Assert that the log gives the frames of the scene, each with its colour."""
    count = len(scene.depth)
    assert log.num_frames == count
    np.testing.assert_array_equal(log.stamps_ns, scene.depth_ns)
    np.testing.assert_array_equal(log.color_stamps_ns, scene.color_ns)
    seen = 0
    for batch in log.batches(batch_size, color=True):
        n = len(batch.status)
        frames = batch.frames
        assert batch.status == (FrameStatus.OK,) * n and batch.errors == ("",) * n
        assert frames.color is not None and frames.color.shape[0] == batch_size
        np.testing.assert_array_equal(frames.stamp_ns[:n], scene.depth_ns[seen : seen + n])
        np.testing.assert_array_equal(frames.color_stamp_ns[:n], scene.color_ns[seen : seen + n])
        np.testing.assert_array_equal(frames.color[:n], scene.color[seen : seen + n])
        np.testing.assert_array_equal(frames.depth[:n], scene.depth[seen : seen + n])
        np.testing.assert_array_equal(frames.number[:n], np.arange(seen, seen + n))
        assert frames.valid.tolist() == [True] * n + [False] * (batch_size - n)
        assert not frames.color[n:].any() and not frames.depth[n:].any()
        seen += n
    assert seen == count
