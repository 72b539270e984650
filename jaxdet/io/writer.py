"""Writer of ROS 2 logs: MCAP files with CDR messages, as recorded by ``realsense2_camera`` 4.x.

Frame names, topics and the direction of each transform are up to the caller;
:mod:`jaxdet.sim.record` writes a log like that of a RealSense.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple, Self

import numpy as np
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter

from jaxdet.io.definition import schema_text
from jaxdet.io.writer_cdr import camera_info, encode_cdr, header, pose_of, quaternion, xyz
from jaxdet.types import Extrinsics, Intrinsics

Compression = Literal["zstd", "lz4", "none"]


_FOREVER = "{sec: 9223372036, nsec: 854775807}"
_LATCHED = f"""\
- history: 1
  depth: 1
  reliability: 1
  durability: 1
  deadline: {_FOREVER}
  lifespan: {_FOREVER}
  liveliness: 1
  liveliness_lease_duration: {_FOREVER}
  avoid_ros_namespace_conventions: false
"""
"""Reliable and transient-local QoS, as recorded by rosbag2."""


class Transform(NamedTuple):
    """A transform of the TF tree, ``T_parent_child``."""

    parent: str
    child: str
    T: np.ndarray
    """Matrix ``(4, 4)`` float64 [m]."""


def transforms_message(stamp_ns: int, transforms: Sequence[Transform]) -> dict[str, Any]:
    """Build a ``tf2_msgs/TFMessage``."""
    stamped = [
        {
            "header": header(stamp_ns, parent), "child_frame_id": child,
            "transform": {"translation": xyz(T[:3, 3]), "rotation": quaternion(T[:3, :3])},
        }
        for parent, child, T in transforms
    ]  # fmt: skip
    return {"transforms": stamped}


class Ros2LogWriter:
    """Context manager that writes one MCAP file with the ``ros2`` profile.

    Args:
        path: File to write; an existing file is replaced.
        compression: Compression of the chunks.
    """

    def __init__(self, path: str | Path, compression: Compression = "zstd") -> None:
        self._stream = Path(path).open("wb")  # noqa: SIM115 closed by close()
        kind = CompressionType[compression.upper()]
        self._writer = McapWriter(self._stream, compression=kind)
        self._writer.start(profile="ros2", library="jaxdet")
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._counts: dict[str, int] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Write the summary and close the file; safe to call twice."""
        if not self._stream.closed:
            with self._stream:  # closes the file also if the disk is full
                self._writer.finish()

    def write(
        self,
        topic: str,
        stamp_ns: int,
        type_name: str,
        message: Mapping[str, Any],
        *,
        latched: bool = False,
    ) -> None:
        """Write a message.

        Args:
            topic: Topic.
            stamp_ns: Log and publish time [ns].
            type_name: Message type such as ``sensor_msgs/Image``.
            message: Fields by name, see :func:`jaxdet.io.writer_cdr.encode_cdr`.
            latched: Whether players resend the topic's last message to later subscribers.
        """
        if topic not in self._channels:
            if type_name not in self._schemas:
                name = type_name.replace("/", "/msg/")
                text = schema_text(type_name).encode()
                self._schemas[type_name] = self._writer.register_schema(name, "ros2msg", text)
            metadata = {"offered_qos_profiles": _LATCHED} if latched else {}
            self._channels[topic] = self._writer.register_channel(
                topic, "cdr", self._schemas[type_name], metadata
            )
        count = self._counts[topic] = self._counts.get(topic, -1) + 1
        data = encode_cdr(type_name, message)
        self._writer.add_message(self._channels[topic], stamp_ns, data, stamp_ns, count)

    def write_image(
        self, topic: str, stamp_ns: int, frame_id: str, array: np.ndarray, encoding: str
    ) -> None:
        """Write a ``sensor_msgs/Image``.

        Args:
            topic: Topic.
            stamp_ns: Header timestamp [ns].
            frame_id: TF frame, optical.
            array: Image ``(H, W)`` or ``(H, W, C)``; uint8, uint16 or float32.
            encoding: ROS name of the encoding, such as ``rgb8``, ``16UC1``, ``32FC1``.
        """
        pixels = np.ascontiguousarray(array, array.dtype.newbyteorder("<"))
        message = {
            "header": header(stamp_ns, frame_id), "height": array.shape[0],
            "width": array.shape[1], "encoding": encoding, "is_bigendian": 0,
            "step": pixels.nbytes // array.shape[0], "data": pixels.tobytes(),
        }  # fmt: skip
        self.write(topic, stamp_ns, "sensor_msgs/Image", message)

    def write_camera_info(
        self, topic: str, stamp_ns: int, frame_id: str, camera: Intrinsics
    ) -> None:
        """Write a ``sensor_msgs/CameraInfo``, see :func:`jaxdet.io.writer_cdr.camera_info`."""
        message = camera_info(stamp_ns, frame_id, camera)
        self.write(topic, stamp_ns, "sensor_msgs/CameraInfo", message)

    def write_transforms(
        self,
        stamp_ns: int,
        transforms: Sequence[Transform],
        *,
        static: bool = False,
        log_ns: int | None = None,
    ) -> None:
        """Write a ``tf2_msgs/TFMessage`` on ``/tf_static`` or ``/tf``.

        Args:
            stamp_ns: Header timestamp [ns].
            transforms: Transforms.
            static: Whether the transforms are static.
            log_ns: Log and publish time [ns]; by default the header timestamp.
        """
        topic = "/tf_static" if static else "/tf"
        at = stamp_ns if log_ns is None else log_ns
        self.write(topic, at, "tf2_msgs/TFMessage", transforms_message(stamp_ns, transforms))

    def write_odometry(
        self, topic: str, stamp_ns: int, pose: Transform, velocity: tuple[float, float]
    ) -> None:
        """Write a ``nav_msgs/Odometry``.

        Args:
            topic: Topic.
            stamp_ns: Header timestamp [ns].
            pose: Pose of the base in the odometry frame.
            velocity: Forward speed [m/s] and turn rate to the left [rad/s], in the base's frame.
        """
        place = pose_of(pose.T)
        twist = {"linear": xyz((velocity[0], 0, 0)), "angular": xyz((0, 0, velocity[1]))}
        message = {
            "header": header(stamp_ns, pose.parent), "child_frame_id": pose.child,
            "pose": {"pose": place, "covariance": (0.0,) * 36},
            "twist": {"twist": twist, "covariance": (0.0,) * 36},
        }  # fmt: skip
        self.write(topic, stamp_ns, "nav_msgs/Odometry", message)

    def write_extrinsics(self, topic: str, stamp_ns: int, extrinsics: Extrinsics) -> None:
        """Write a ``realsense2_camera_msgs/Extrinsics``, whose rotation is column-major."""
        rotation = np.reshape(extrinsics.rotation, (3, 3)).T.ravel().tolist()
        message = {"rotation": rotation, "translation": extrinsics.translation}
        self.write(topic, stamp_ns, "realsense2_camera_msgs/Extrinsics", message)
