"""Stub of the parts of ``rclpy`` and other ROS 2 packages that the node uses.

It delivers messages to subscriptions, and keeps what is published and logged. Like rclpy, it
refuses messages of another class and parameters of another type. Published messages are decoded by
rosbags. Whether ROS 2 has these functions is not tested by it.
"""

import sys
from array import array
from collections.abc import Callable
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from jaxdet.io.writer_cdr import pose_of

VISION = {
    "ObjectHypothesis": "string class_id\nfloat64 score",
    "ObjectHypothesisWithPose": "vision_msgs/ObjectHypothesis hypothesis\n"
    "geometry_msgs/PoseWithCovariance pose",
    "BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size",
    "Detection3D": "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n"
    "vision_msgs/BoundingBox3D bbox\nstring id",
    "Detection3DArray": "std_msgs/Header header\nvision_msgs/Detection3D[] detections",
}
"""Definitions of ``vision_msgs`` 4, which rosbags lacks."""
STORE = get_typestore(Stores.ROS2_JAZZY)
for _name, _text in VISION.items():
    STORE.register(get_types_from_msg(_text, f"vision_msgs/msg/{_name}"))


def image_message(stamp_ns: int, frame_id: str, pixels: Any, encoding: str = "16UC1") -> Any:
    """Return a ``sensor_msgs/Image``, whose rows end with two bytes that are not pixels."""
    rows = [row.tobytes() + b"\xff\xff" for row in pixels]
    return SimpleNamespace(
        header=_header(stamp_ns, frame_id),
        height=len(rows),
        width=pixels.shape[1],
        encoding=encoding,
        is_bigendian=0,
        step=len(rows[0]),
        data=array("B", b"".join(rows)),
    )


def info_message(stamp_ns: int, camera: Any, D: tuple[float, ...] = (0.0,) * 5) -> Any:
    """Return a ``sensor_msgs/CameraInfo`` of intrinsics."""
    part = {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False}
    return SimpleNamespace(
        header=_header(stamp_ns, "camera"),
        height=camera.height,
        width=camera.width,
        distortion_model="plumb_bob",
        d=array("d", D),
        k=camera.K.ravel(),
        r=array("d", [1, 0, 0, 0, 1, 0, 0, 0, 1]),
        p=array("d", [0.0] * 12),
        binning_x=0,
        binning_y=0,
        roi=SimpleNamespace(**part),
    )


def _header(stamp_ns: int, frame_id: str) -> Any:
    sec, nanosec = divmod(stamp_ns, 10**9)
    return SimpleNamespace(stamp=SimpleNamespace(sec=sec, nanosec=nanosec), frame_id=frame_id)


class Node:
    """Stub of ``rclpy.node.Node``.

    Attributes:
        parameters: Values that are set from outside, by name.
        remaps: Topics by the names that the node uses for them.
        transforms: Poses ``(4, 4)`` by target and source frame, for ``tf2_ros``.
        published: Messages by topic, in order.
        qos: QoS profiles, or depths of queues, by topic.
        warnings: Logged warnings.
        infos: Other logged lines.
    """

    def __init__(self, parameters: dict[str, Any], remaps: dict[str, str]) -> None:
        self.parameters, self.remaps = parameters, remaps
        self.declared: dict[str, Any] = {}
        self.transforms: dict[tuple[str, str], Any] = {}
        self.published: dict[str, list[Any]] = {}
        self.qos: dict[str, Any] = {}
        self.warnings: list[str] = []
        self.infos: list[str] = []
        self._callbacks: dict[str, tuple[type, Callable[[Any], None]]] = {}

    def declare_parameter(self, name: str, value: Any, descriptor: Any) -> Any:
        given = self.parameters.get(name, value)
        if type(given) is not type(value) and not descriptor.dynamic_typing:
            raise TypeError(f"{name} has another type")
        self.declared[name] = descriptor
        return SimpleNamespace(value=given)

    def resolve_topic_name(self, topic: str) -> str:
        return self.remaps.get(topic) or topic.replace("~", "/jaxdet", 1)

    def create_publisher(self, kind: type, topic: str, qos_profile: Any) -> Any:
        name = self.resolve_topic_name(topic)
        self.qos[name], self.published[name] = qos_profile, []

        def publish(message: Any) -> None:
            if not isinstance(message, kind):
                raise TypeError(f"Expected {kind}, got {type(message)}")
            self.published[name].append(message)

        return SimpleNamespace(publish=publish)

    def create_subscription(
        self, kind: type, topic: str, callback: Callable[[Any], None], qos_profile: Any
    ) -> None:
        name = self.resolve_topic_name(topic)
        self.qos[name], self._callbacks[name] = qos_profile, (kind, callback)

    def get_logger(self) -> Any:
        def warning(text: str, throttle_duration_sec: float) -> None:
            self.warnings.append(text)

        return SimpleNamespace(info=self.infos.append, warning=warning)

    def deliver(self, topic: str, message: Any) -> None:
        """Call the subscription of a topic."""
        self._callbacks[topic][1](message)

    def counts(self) -> dict[str, int]:
        """Return the number of published messages by topic."""
        return {name: len(messages) for name, messages in self.published.items()}


class Subscriber:
    """Stub of ``message_filters.Subscriber``."""

    def __init__(self, node: Node, kind: type, topic: str, qos_profile: Any) -> None:
        self._callbacks: list[tuple[Callable[..., None], tuple]] = []
        node.create_subscription(kind, topic, self._signal, qos_profile=qos_profile)

    def registerCallback(self, callback: Callable[..., None], *args: Any) -> None:  # noqa: N802
        self._callbacks.append((callback, args))

    def _signal(self, message: Any) -> None:
        for callback, args in self._callbacks:
            callback(message, *args)


class ApproximateTimeSynchronizer:
    """Stub of ``message_filters.ApproximateTimeSynchronizer``, for two subscribers."""

    def __init__(self, subscribers: list[Subscriber], queue_size: int, slop: float) -> None:
        self._slop_ns, self._size = slop * 1e9, queue_size
        self._queues: list[dict[int, Any]] = [{}, {}]
        for number, subscriber in enumerate(subscribers):
            subscriber.registerCallback(self._add, number)

    def registerCallback(self, callback: Callable[..., None]) -> None:  # noqa: N802
        self._callback = callback

    def _add(self, message: Any, number: int) -> None:
        stamp = message.header.stamp
        at = stamp.sec * 10**9 + stamp.nanosec
        own, other = self._queues[number], self._queues[1 - number]
        own[at] = message
        if len(own) > self._size:
            del own[min(own)]
        nearest = min(other, key=lambda time: abs(time - at), default=None)
        if nearest is not None and abs(nearest - at) < self._slop_ns:
            pair = own.pop(at), other.pop(nearest)
            self._callback(*(pair if number == 0 else pair[::-1]))


class TransformException(Exception):  # noqa: N818
    """Stub of ``tf2_ros.TransformException``."""


class Buffer:
    """Stub of ``tf2_ros.Buffer``, which its listener fills."""

    transforms: dict[tuple[str, str], Any]

    def lookup_transform(self, target: str, source: str, time: Any) -> Any:
        if (target, source) not in self.transforms:
            raise TransformException(f'"{target}" passed to lookupTransform does not exist')
        pose = pose_of(self.transforms[target, source])
        parts = (SimpleNamespace(**pose[name]) for name in ("position", "orientation"))
        transform = SimpleNamespace(**dict(zip(("translation", "rotation"), parts, strict=True)))
        return SimpleNamespace(transform=transform)


def _listen(buffer: Buffer, node: Node) -> None:
    buffer.transforms = node.transforms


def _message_classes(module: ModuleType) -> Callable[[str], Any]:
    package = module.__name__.partition(".")[0]
    return lambda name: STORE.types[f"{package}/msg/{name}"]


def install(
    patch: pytest.MonkeyPatch, spin: Callable[[Node], bool] | None = None, **parameters: Any
) -> Node:
    """Put the stub in place of ROS 2, and return the node that ``rclpy`` will create.

    Args:
        patch: Fixture that removes the stub after the test.
        spin: Function that is called when an executor spins; if it returns False, ROS 2 shuts down.
        parameters: Parameters of the node.
    """
    node = Node(parameters, {"depth": "/cam/depth/image", "camera_info": "/cam/depth/camera_info"})
    running = [True]

    class SingleThreadedExecutor:
        def add_node(self, added: Node) -> None:
            assert added is node

        def spin_once(self, timeout_sec: float) -> None:
            assert spin is not None
            running[0] = spin(node)

    def init(args: list[str], signal_handler_options: str) -> None:
        assert signal_handler_options == "no"  # a detector would replace the handlers

    contents: dict[str, dict[str, Any]] = {
        "rclpy": {
            "init": init,
            "create_node": lambda name: node,
            "ok": lambda: running[0],
            "try_shutdown": lambda: None,
        },
        "rclpy.executors": {"SingleThreadedExecutor": SingleThreadedExecutor},
        "rclpy.qos": {
            "QoSProfile": lambda **policies: policies,
            "ReliabilityPolicy": SimpleNamespace(BEST_EFFORT="best_effort"),
            "DurabilityPolicy": SimpleNamespace(TRANSIENT_LOCAL="transient_local"),
        },
        "rclpy.serialization": {
            "deserialize_message": lambda data, kind: STORE.deserialize_cdr(data, kind.__msgtype__)
        },
        "rclpy.signals": {"SignalHandlerOptions": SimpleNamespace(NO="no")},
        "rclpy.time": {"Time": SimpleNamespace},
        "message_filters": {
            "Subscriber": Subscriber,
            "ApproximateTimeSynchronizer": ApproximateTimeSynchronizer,
        },
        "tf2_ros": {
            "Buffer": Buffer,
            "TransformListener": _listen,
            "TransformException": TransformException,
        },
        "rcl_interfaces.msg": {"ParameterDescriptor": SimpleNamespace},
    }
    for package in ("sensor_msgs", "nav_msgs", "tf2_msgs", "vision_msgs"):
        contents[f"{package}.msg"] = {}
    for name, values in contents.items():
        module = ModuleType(name)
        vars(module).update(values or {"__getattr__": _message_classes(module)})
        patch.setitem(sys.modules, name, module)
        parent = name.partition(".")[0]
        if parent not in contents:
            patch.setitem(sys.modules, parent, ModuleType(parent))
    return node
