"""Subscriptions, detection and publications of the ROS 2 node.

Packages of ROS 2 are imported when a node is made, so that this module loads without them.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from types import MappingProxyType
from typing import Any

import numpy as np

from jaxdet.arguments import number
from jaxdet.checks import check_depth_unit
from jaxdet.config_file import find_config
from jaxdet.detector import Detector
from jaxdet.errors import ConfigError, FrameStatus, InputError, JaxdetError
from jaxdet.export.ros2 import LOCAL, MESSAGES, frame_messages
from jaxdet.export.sidecar import floor_transform
from jaxdet.floor.mount import Mount
from jaxdet.io.images import check_pixels, decode_depth, is_depth_encoding
from jaxdet.io.intrinsics import CameraSource, find_intrinsics
from jaxdet.io.message_fields import parse
from jaxdet.io.messages import CameraInfoMessage, ImageMessage, Kind
from jaxdet.io.motion import motion_matrix
from jaxdet.io.options import LogOptions
from jaxdet.io.streams import ImageSize
from jaxdet.io.topics import is_rectified
from jaxdet.io.writer import transforms_message
from jaxdet.io.writer_cdr import encode_cdr
from jaxdet.results.tables import Tables
from jaxdet.types import Intrinsics

Publish = Callable[[Mapping[str, Any]], None]
"""Function that publishes a message, given as its fields by name."""

PARAMETERS: Mapping[str, tuple[Any, str]] = MappingProxyType(
    {
        "config": ("wheeled", "preset, or path of a TOML file"),
        "depth_unit_m": (0.001, "metres per unit of 16UC1 images"),
        "camera_frame": ("", "optical frame of the camera; empty: the frame of the images"),
        "camera_height_m": (0.0, "optical centre above the floor [m]; 0: not given"),
        "camera_pitch_rad": (0.0, "downward tilt of the camera [rad]"),
        "camera_roll_rad": (0.0, "roll of the camera [rad], clockwise seen from behind"),
        "base_frame": ("", "TF frame with z = 0 on the floor, in place of camera_height_m"),
        "publish_grid": (True, "whether to publish local_map"),
        "slop_s": (0.05, "maximum time between an image and its CameraInfo [s]"),
    }
)
"""Default and description of each parameter."""
DEPTH, INFO = "depth", "camera_info"
"""Topics of the subscriptions, to be remapped."""
TF = "/tf"
UNPAIRED = 30
"""Number of depth images in a row without a CameraInfo before a warning."""
WARN_S = 5.0
"""Minimum time between two warnings [s]."""
_QUEUE = 10
"""Maximum number of images, and of CameraInfo messages, that wait for their counterpart."""


def ros(module: str) -> Any:
    """Import a module of ROS 2.

    Raises:
        ConfigError: The module is not found, or was built for another version of Python.
    """
    try:
        return import_module(module)
    except ImportError as error:
        package, reason = module.partition(".")[0], str(error).partition("\n")[0]
        remedy = "run 'source /opt/ros/<distro>/setup.bash' first, with that distribution's Python"
        if package not in ("rclpy", "rcl_interfaces"):
            remedy += f", and install ros-<distro>-{package.replace('_', '-')}"
        raise ConfigError(f"{package} can't be imported ({reason})", remedy=remedy) from error


def message_class(name: str) -> Any:
    """Return the class of a message type, for instance of ``sensor_msgs/Image``."""
    package, _, kind = name.partition("/")
    return getattr(ros(f"{package}.msg"), kind)


def _publisher(node: Any, topic: str, type_name: str, qos: Any) -> Publish:
    """Return a function that publishes a message.

    The fields are encoded as in an export, and ROS 2 decodes these bytes.
    """
    kind, decode = message_class(type_name), ros("rclpy.serialization").deserialize_message
    publisher = node.create_publisher(kind, topic, qos)
    return lambda message: publisher.publish(decode(encode_cdr(type_name, message), kind))


class ObstacleNode:
    """Publishes the obstacles in the depth images of a camera, as ROS 2 messages.

    The node subscribes to ``depth`` and ``camera_info``, and publishes ``~/detections``,
    ``~/scan``, ``~/local_map`` and the floor frame of the camera on ``/tf``. The messages are those
    of ``jaxdet export --to ros2``, with the timestamp of the image. Images that arrive during a
    detection are dropped, except the newest. If an image can't be used, nothing is published, and a
    warning gives the reason.

    Args:
        node: The ``rclpy.node.Node`` that owns subscriptions, publishers and parameters.

    Attributes:
        received: Number of received depth images.
        published: Number of depth images whose messages were published.

    Raises:
        ConfigError: A parameter is invalid, or a package of ROS 2 is missing.
    """

    def __init__(self, node: Any) -> None:
        self._node = node
        settings = self._settings = _declared(node)
        self._config = find_config(settings["config"])
        if self._config.cluster.points:
            remedy = "use another preset than paper"
            problem = "the method needs colour images, which the node does not receive"
            raise ConfigError(problem, topic="config", remedy=remedy)
        self._unit = number("depth_unit_m", settings["depth_unit_m"])
        with _about("depth_unit_m", "pass metres, 0.001 for millimetres"):
            check_depth_unit(self._unit)
        self._mount = _mount(settings)
        self._base = _BaseFrame(node, settings["base_frame"]) if settings["base_frame"] else None
        self._camera: Intrinsics | None = None
        self._detector: Detector | None = None
        self.received = self.published = self._unpaired = 0
        self._depth_topic, self._info_topic = map(node.resolve_topic_name, (DEPTH, INFO))
        self._remap_info = f"remap {INFO} to the calibration of {self._depth_topic}"
        self._publishers = dict(self._new_publishers())
        self._pairs = self._subscribe()

    def __str__(self) -> str:
        """Return how many images were received and published."""
        return f"{self.received} depth images, {self.published} with published obstacles"

    def _new_publishers(self) -> Iterator[tuple[str, Publish]]:
        """Yield the publisher of each topic."""
        qos = ros("rclpy.qos")
        latched = qos.QoSProfile(depth=1, durability=qos.DurabilityPolicy.TRANSIENT_LOCAL)
        yield TF, _publisher(self._node, TF, "tf2_msgs/TFMessage", 100)
        for name, type_name in MESSAGES.items():
            if name != LOCAL or self._settings["publish_grid"]:
                profile = latched if name == LOCAL else 10
                yield name, _publisher(self._node, f"~/{name}", type_name, profile)

    def _subscribe(self) -> Any:
        """Subscribe to both topics, and return the synchronizer of their messages."""
        filters, qos = ros("message_filters"), ros("rclpy.qos")
        # The profile of sensor data, but with a queue of one, so that the newest image is next.
        newest = qos.QoSProfile(depth=1, reliability=qos.ReliabilityPolicy.BEST_EFFORT)
        kinds = message_class("sensor_msgs/Image"), message_class("sensor_msgs/CameraInfo")
        subscribers = [
            filters.Subscriber(self._node, kind, name, qos_profile=newest)
            for kind, name in zip(kinds, (DEPTH, INFO), strict=True)
        ]
        slop = number("slop_s", self._settings["slop_s"])
        pairs = filters.ApproximateTimeSynchronizer(subscribers, _QUEUE, slop)
        pairs.registerCallback(self._on_pair)
        subscribers[0].registerCallback(self._on_depth)
        return pairs

    def _on_depth(self, image: Any) -> None:
        """Count a depth image, and warn if no CameraInfo belongs to the last ones."""
        self.received += 1
        self._unpaired += 1
        if self._unpaired > UNPAIRED:
            problem = f"no CameraInfo within slop_s of the last {self._unpaired} depth images"
            self._warn(f"{self._info_topic}: {problem}; {self._remap_info}")

    def _on_pair(self, image: Any, info: Any) -> None:
        self._unpaired = 0
        try:
            self._detect(image, info)
        except JaxdetError as error:
            self._warn(f"nothing is published: {error}")
        else:
            self.published += 1

    def _warn(self, text: str) -> None:
        self._node.get_logger().warning(text, throttle_duration_sec=WARN_S)

    def _detect(self, image: Any, info: Any) -> None:
        """Detect the obstacles in an image, and publish them.

        Raises:
            JaxdetError: The image or its calibration can't be used.
        """
        depth, units = self._units(image)
        detector = self._detector_of(depth, info)
        frame_id = str(self._settings["camera_frame"]) or depth.frame_id
        mount = self._base.mount(frame_id) if self._base else self._mount
        found = detector.batch(units[None], mounts=[mount], stamps_ns=[depth.stamp_ns])
        if found[0].status is not FrameStatus.OK:
            problem = f"the image has no measurement in range ({found[0].status})"
            raise InputError(problem, topic=self._depth_topic)
        (frame,) = Tables.of(found.rows.frames, found.rows.obstacles).each()
        frame = frame._replace(row=frame.row | {"camera_frame": frame_id})
        if (floor := floor_transform(frame.row)) is not None:
            self._publishers[TF](transforms_message(depth.stamp_ns, [floor]))
        for name, message in frame_messages(frame, self._config.ground.max_depth_m):
            if name in self._publishers:
                self._publishers[name](message)

    def _units(self, image: Any) -> tuple[ImageMessage, np.ndarray]:
        """Return a depth image and its pixels, ``(H, W)`` uint16 in units of ``depth_unit_m``.

        Raises:
            InputError: The image is not a depth image, or its data do not fit its size.
        """
        with _about(self._depth_topic):
            depth = parse(Kind.IMAGE, image, "")
            assert isinstance(depth, ImageMessage)
            if not is_depth_encoding(depth.encoding):
                remedy = f"remap {DEPTH} to a topic of 16UC1 or 32FC1 images"
                raise InputError(f"encoding {depth.encoding!a} is not depth", remedy=remedy)
            check_pixels(depth)
            units = np.empty((depth.height, depth.width), np.uint16)
            decode_depth(depth, units, self._unit, LogOptions.max_pixels)
        return depth, units

    def _detector_of(self, depth: ImageMessage, info: Any) -> Detector:
        """Return the detector of an image's calibration, a new one if the calibration changed.

        Raises:
            InputError: The calibration is missing, implausible or of another image size.
        """
        with _about(self._info_topic, self._remap_info):
            calibration = parse(Kind.INFO, info, "")
            assert isinstance(calibration, CameraInfoMessage)
            source = CameraSource(
                name="depth",
                topic=self._info_topic,
                info=calibration,
                size=ImageSize(depth.width, depth.height),
                rectified=is_rectified(self._depth_topic),
                matrix=None,
                model=None,
                path="",
            )
            camera, _, warnings = find_intrinsics(source)
            if self._detector is not None and camera == self._camera:
                return self._detector
            detector = Detector(camera, depth_unit_m=self._unit, config=self._config)
        for text in warnings:
            self._warn(text)
        change = "calibration" if self._camera is None else "changed calibration"
        text = f"{self._info_topic}: {change}, {camera.width}x{camera.height}, {detector}"
        self._node.get_logger().info(text)
        self._camera, self._detector = camera, detector
        return detector


class _BaseFrame:
    """Frame of the robot with z = 0 on the floor, looked up in TF.

    Args:
        node: Node that receives TF.
        name: Name of the frame.
    """

    def __init__(self, node: Any, name: Any) -> None:
        self._name, self._tf2 = str(name), ros("tf2_ros")
        self._latest = ros("rclpy.time").Time()
        self._buffer = self._tf2.Buffer()
        self._listener = self._tf2.TransformListener(self._buffer, node)

    def mount(self, camera: str) -> Mount:
        """Return the mount of a camera, by the latest transform.

        Args:
            camera: Optical frame of the camera.

        Raises:
            InputError: There is no such transform, or it puts the camera outside 0 to 20 m above
                the floor.
        """
        try:
            stamped = self._buffer.lookup_transform(self._name, camera, self._latest)
        except self._tf2.TransformException as error:
            problem = f"no transform to {camera!a} ({error})"
            remedy = "publish it, or set camera_height_m in place of base_frame"
            raise InputError(problem, topic=f"base_frame {self._name}", remedy=remedy) from error
        t, q = stamped.transform.translation, stamped.transform.rotation
        translation, rotation = np.array([t.x, t.y, t.z]), np.array([q.x, q.y, q.z, q.w])
        try:
            return Mount.from_transform(motion_matrix(translation, rotation))
        except JaxdetError as error:
            remedy = "check this transform; base_frame must have z = 0 on the floor"
            topic = f"base_frame {self._name}"
            raise InputError(error.problem, topic=topic, remedy=remedy) from error


@contextmanager
def _about(topic: str, remedy: str = "") -> Iterator[None]:
    """Make errors in the block name a topic; ``remedy`` replaces remedies that name a flag.

    Raises:
        InputError: The block raised an error of jaxdet.
    """
    try:
        yield
    except JaxdetError as error:
        remedy = remedy if "--" in error.remedy else error.remedy
        raise InputError(error.problem, topic=topic, remedy=remedy) from error


def _declared(node: Any) -> dict[str, Any]:
    """Declare the parameters of the node, and return their values."""
    descriptor = message_class("rcl_interfaces/ParameterDescriptor")
    # An integer in place of 1.0 would be an error without dynamic typing.
    return {
        name: node.declare_parameter(
            name, default, descriptor(description=text, read_only=True, dynamic_typing=True)
        ).value
        for name, (default, text) in PARAMETERS.items()
    }


def _mount(settings: Mapping[str, Any]) -> Mount | None:
    """Return the mount in the parameters; None if it is not given.

    Raises:
        ConfigError: The mount is invalid, incomplete or contradicts ``base_frame``.
    """
    height, *angles = (settings[f"camera_{name}"] for name in ("height_m", "pitch_rad", "roll_rad"))
    if not height:
        if any(angles):
            problem = "is required with camera_pitch_rad and camera_roll_rad"
            raise ConfigError(problem, topic="camera_height_m")
        return None
    if settings["base_frame"]:
        remedy = "set only one of them"
        raise ConfigError("contradicts base_frame", topic="camera_height_m", remedy=remedy)
    try:
        return Mount(height, *angles)
    except ConfigError as error:
        topic = f"camera_{error.topic}"
        raise ConfigError(error.problem, topic=topic, remedy=error.remedy) from error
