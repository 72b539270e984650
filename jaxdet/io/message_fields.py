"""Conversion of decoded ROS 2 and Foxglove messages to those of :mod:`jaxdet.io.messages`.

Decoded CDR, protobuf and JSON messages are objects with attributes, whose names differ between ROS
2 and Foxglove.
"""

import base64
import math
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from jaxdet.elementary import matmul
from jaxdet.io.images import depth_pixels
from jaxdet.io.limits import MAX_TRANSLATION_M
from jaxdet.io.messages import (
    CameraInfoMessage,
    CompressedImageMessage,
    ImageMessage,
    Kind,
    Message,
    RgbdMessage,
    TransformMessage,
    bad_frame,
)
from jaxdet.io.motion import motion_matrix

MAX_STAMP_S = 9_000_000_000
MAX_ROS2_STAMP_S = (1 << 31) - 1
"""Largest number of seconds in a timestamp of ROS 2, an int32."""
UNIT_TOLERANCE = 0.01
"""Tolerance for the squared norm of a quaternion, as in tf2."""


def nanoseconds(sec: int, nanosec: int) -> int:
    """Return a timestamp in nanoseconds.

    Raises:
        FrameError: The timestamp is negative or too large for int64 nanoseconds.
    """
    # Field types differ between schemas, but the values are integers.
    sec, nanosec = int(sec), int(nanosec)
    if not (0 <= sec <= MAX_STAMP_S and 0 <= nanosec < 1 << 32):
        problem = f"header timestamp ({sec} s, {nanosec} ns) is not between the years 1970 and 2255"
        raise bad_frame(problem)
    return sec * 1_000_000_000 + nanosec


def parse(kind: Kind, message: Any, schema_name: str) -> Message:
    """Convert a decoded ROS 2 or Foxglove message to one of :mod:`jaxdet.io.messages`.

    Args:
        kind: Kind of message.
        message: Object with the fields of the schema as attributes.
        schema_name: Name of the schema from :func:`jaxdet.io.messages.plain_schema_name`.

    Raises:
        Exception: A field is missing or has an unexpected type.
    """
    return _PARSE[kind](message, schema_name)


def _head(message: Any) -> tuple[int, str]:
    """Return timestamp [ns] and TF frame of a message of ROS or Foxglove.

    The fields of the timestamp have other names in ROS, protobuf and JSON.
    """
    head = getattr(message, "header", message)
    stamp = message.timestamp if head is message else head.stamp
    if hasattr(stamp, "seconds"):
        ns = nanoseconds(stamp.seconds, stamp.nanos)
    else:
        ns = nanoseconds(stamp.sec, stamp.nanosec if hasattr(stamp, "nanosec") else stamp.nsec)
    return ns, getattr(head, "frame_id", "").lstrip("/")


def _bytes(data: Any) -> bytes | memoryview:
    if isinstance(data, np.ndarray):
        return data.data
    return base64.b64decode(data, validate=True) if isinstance(data, str) else bytes(data)


def _image(message: Any, name: str) -> ImageMessage:
    stamp, frame = _head(message)
    return ImageMessage(
        stamp,
        frame,
        int(message.width),
        int(message.height),
        str(message.encoding),
        int(message.step),
        bool(getattr(message, "is_bigendian", 0)),
        _bytes(message.data),
    )


def _disparity(message: Any, name: str) -> ImageMessage:
    """Return the depth in metres of a stereo_msgs/DisparityImage: f T / disparity.

    Depth is unknown for disparities that are not positive, below ``min_disparity`` or NaN.
    """
    stamp, frame = _head(message)
    image = _image(message.image, name)
    if image.encoding.upper() != "32FC1":
        raise ValueError(f"expected a disparity image with encoding 32FC1, got {image.encoding!a}")
    baseline = float(message.t if hasattr(message, "t") else message.T)
    focal, least = float(message.f), float(message.min_disparity)
    if not 0 < focal * abs(baseline) < math.inf:
        text = f"focal length {focal:g} and baseline {baseline:g} m"
        raise ValueError(f"the disparity image has {text}; depth can't be computed")
    found = depth_pixels(image, image.width * image.height).astype(np.float32)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        depth = np.float32(focal * abs(baseline)) / found
    depth = np.where(np.isfinite(found) & (found > 0) & ~(found < least), depth, np.float32(0))
    data = depth.astype("<f4").tobytes()
    return image._replace(
        stamp_ns=stamp,
        frame_id=frame or image.frame_id,
        step=4 * image.width,
        big_endian=False,
        data=data,
    )


def _compressed(message: Any, name: str) -> CompressedImageMessage:
    return CompressedImageMessage(*_head(message), str(message.format), _bytes(message.data))


def _info(message: Any, name: str) -> CameraInfoMessage:
    stamp, frame = _head(message)
    lower = hasattr(message, "k")
    D, K, P = (
        tuple(float(value) for value in getattr(message, key.lower() if lower else key, ()))
        for key in "DKP"
    )
    size = int(message.width), int(message.height)
    bx, by = (max(1, int(getattr(message, f"binning_{axis}", 0))) for axis in "xy")
    roi, names = getattr(message, "roi", None), ("x_offset", "y_offset", "width", "height")
    x, y, width, height = (int(getattr(roi, key, 0)) for key in names)
    model = str(message.distortion_model)
    part = x, y, width, height
    return CameraInfoMessage(stamp, frame, *size, model, D, K, P, (bx, by), part)


def _rgbd(message: Any, name: str) -> RgbdMessage:
    return RgbdMessage(
        _head(message)[0],
        _image(message.rgb, name),
        _image(message.depth, name),
        _info(message.rgb_camera_info, name),
        _info(message.depth_camera_info, name),
    )


def motion(
    stamp: int, parent: str, child: str, translation: Iterable[Any], rotation: Iterable[Any]
) -> TransformMessage:
    """Build a transform or pose.

    Args:
        stamp: Timestamp [ns].
        parent: TF frame in which the pose is expressed.
        child: TF frame of the pose.
        translation: Translation x y z [m].
        rotation: Quaternion x y z w.

    Raises:
        ValueError: The translation is implausibly large, or the quaternion is not of unit length.
    """
    tx, ty, tz = map(float, translation)
    if not all(abs(value) <= MAX_TRANSLATION_M for value in (tx, ty, tz)):  # also rejects NaN
        raise ValueError(f"translation ({tx:g}, {ty:g}, {tz:g}) m is implausible")
    given = tuple(map(float, rotation))
    bounded = all(abs(value) <= 2 for value in given)
    x, y, z, w = given if bounded else (math.inf,) * 4
    square = x * x + y * y + z * z + w * w  # sum() rounds differently from Python 3.12 on
    if not abs(square - 1) <= UNIT_TOLERANCE:
        text = ", ".join(f"{value:g}" for value in given)
        raise ValueError(f"quaternion ({text}) is not of unit length")
    length = math.sqrt(square)
    qx, qy, qz, qw = (value / length for value in given)
    return TransformMessage(stamp, parent, child, (tx, ty, tz), (qx, qy, qz, qw))


def transform(
    stamp: int, parent: str, child: str, translation: Iterable[Any], rotation: Iterable[Any]
) -> TransformMessage:
    """Build a transform like :func:`motion`, but with a ``problem`` instead of an error."""
    try:
        return motion(stamp, parent, child, translation, rotation)
    except ValueError as error:
        return TransformMessage(stamp, parent, child, (0, 0, 0), (0, 0, 0, 1), str(error))


def _numbers(t: Any, q: Any) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
    return (t.x, t.y, t.z), (q.x, q.y, q.z, q.w)


def _transforms(message: Any, name: str) -> tuple[TransformMessage, ...]:
    if not name.startswith("foxglove."):
        return tuple(
            transform(
                *_head(item),
                item.child_frame_id.lstrip("/"),
                *_numbers(item.transform.translation, item.transform.rotation),
            )
            for item in message.transforms
        )
    items: Iterable[Any] = message.transforms if name.endswith("FrameTransforms") else [message]
    return tuple(
        transform(
            _head(item)[0],
            item.parent_frame_id.lstrip("/"),
            item.child_frame_id.lstrip("/"),
            *_numbers(item.translation, item.rotation),
        )
        for item in items
    )


def _odometry(message: Any, name: str) -> tuple[TransformMessage, ...]:
    pose = message.pose.pose
    child = message.child_frame_id.lstrip("/")
    return (motion(*_head(message), child, *_numbers(pose.position, pose.orientation)),)


def _pose(message: Any, name: str) -> tuple[TransformMessage, ...]:
    pose = message.pose
    return (motion(*_head(message), "", *_numbers(pose.position, pose.orientation)),)


def _extrinsics(message: Any, name: str) -> np.ndarray:
    if name == "geometry_msgs/Transform":
        found = motion(0, "", "", *_numbers(message.translation, message.rotation))
        return motion_matrix(np.array(found.translation), np.array(found.rotation))
    T = np.eye(4)
    T[:3, :3] = R = np.array(message.rotation, np.float64).reshape(3, 3).T  # column-major
    if not ((np.abs(R) <= 2).all() and np.allclose(matmul(R, R.T), np.eye(3), atol=1e-3)):
        raise ValueError("rotation is not orthonormal")
    x, y, z = (float(value) for value in message.translation)
    T[:3, 3] = x, y, z
    return T


def _number(message: Any, name: str) -> float:
    return float(message.data)


_PARSE: dict[Kind, Callable[[Any, str], Message]] = {
    Kind.IMAGE: _image,
    Kind.COMPRESSED: _compressed,
    Kind.RGBD: _rgbd,
    Kind.DISPARITY: _disparity,
    Kind.INFO: _info,
    Kind.TRANSFORM: _transforms,
    Kind.ODOMETRY: _odometry,
    Kind.POSE: _pose,
    Kind.EXTRINSICS: _extrinsics,
    Kind.NUMBER: _number,
}
