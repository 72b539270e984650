"""The few messages the program understands, whatever they were written with."""

from enum import Enum
from typing import NamedTuple

import numpy as np

from jaxdet.errors import FrameError, FrameStatus


class Kind(Enum):
    """What a schema holds."""

    IMAGE = "image"
    COMPRESSED = "compressed image"
    RGBD = "colour and depth image"
    DISPARITY = "disparity image"
    INFO = "camera calibration"
    TRANSFORM = "transforms"
    ODOMETRY = "odometry"
    POSE = "pose"
    EXTRINSICS = "extrinsics"
    NUMBER = "number"


IMAGE_KINDS = (Kind.IMAGE, Kind.COMPRESSED, Kind.RGBD, Kind.DISPARITY)

_KINDS = {
    "sensor_msgs/Image": Kind.IMAGE,
    "foxglove.RawImage": Kind.IMAGE,
    "sensor_msgs/CompressedImage": Kind.COMPRESSED,
    "foxglove.CompressedImage": Kind.COMPRESSED,
    "realsense2_camera_msgs/RGBD": Kind.RGBD,
    "stereo_msgs/DisparityImage": Kind.DISPARITY,
    "sensor_msgs/CameraInfo": Kind.INFO,
    "foxglove.CameraCalibration": Kind.INFO,
    "tf2_msgs/TFMessage": Kind.TRANSFORM,
    "tf/tfMessage": Kind.TRANSFORM,
    "foxglove.FrameTransform": Kind.TRANSFORM,
    "foxglove.FrameTransforms": Kind.TRANSFORM,
    "nav_msgs/Odometry": Kind.ODOMETRY,
    "geometry_msgs/PoseStamped": Kind.POSE,
    "foxglove.PoseInFrame": Kind.POSE,
    "realsense2_camera_msgs/Extrinsics": Kind.EXTRINSICS,
    "geometry_msgs/Transform": Kind.EXTRINSICS,
    "std_msgs/Float32": Kind.NUMBER,
}


def plain_schema_name(name: str) -> str:
    """Return a schema's name without ``/msg/``; Foxglove's ROS package counts as Foxglove."""
    plain = name.replace("/msg/", "/")
    return plain.replace("foxglove_msgs/", "foxglove.", 1)


def kind_of(schema_name: str) -> Kind | None:
    """Return the kind of messages of this schema; None if they are of no use."""
    return _KINDS.get(plain_schema_name(schema_name))


def bad_frame(problem: str) -> FrameError:
    """Return the error of a message or image that can't be decoded."""
    return FrameError(problem, status=FrameStatus.DECODE_ERROR)


class ImageMessage(NamedTuple):
    """An image as rows of bytes."""

    stamp_ns: int
    frame_id: str
    width: int
    height: int
    encoding: str
    step: int
    """Bytes in a row, padding included."""
    big_endian: bool
    data: bytes | memoryview
    """A view of the message that it was decoded from, where it can be one."""


class CompressedImageMessage(NamedTuple):
    """An image in a file format (JPEG, PNG, ROS's compressedDepth)."""

    stamp_ns: int
    frame_id: str
    format: str
    data: bytes | memoryview
    """Likewise."""


class CameraInfoMessage(NamedTuple):
    """A camera's calibration as it stands in the log."""

    stamp_ns: int
    frame_id: str
    width: int
    height: int
    model: str
    D: tuple[float, ...]
    K: tuple[float, ...]
    """Nine numbers, row-major."""
    P: tuple[float, ...]
    """Twelve numbers, row-major: the projection of the rectified image; may be empty."""
    binning: tuple[int, int] = (1, 1)
    """Columns and rows of the sensor that one pixel of the images covers."""
    roi: tuple[int, int, int, int] = (0, 0, 0, 0)
    """Part of the sensor that the images show: x, y, width, height; width 0 is all of it."""

    def image_sizes(self) -> dict[tuple[int, int], tuple[int, int, int, int]]:
        """Return the image sizes that the message describes, each with x, y and binning.

        Width, height, K and P are those of the full sensor, from which the region of interest is
        cut before pixels are binned (sensor_msgs/CameraInfo). Drivers that state the size of their
        images instead have K for these; so the size itself comes first, with nothing to apply.
        """
        (bx, by), (x, y, width, height) = self.binning, self.roi
        full, part = (self.width, self.height), (width, height) if width and height else None
        sizes = {full: (0, 0, 1, 1)}
        binned = part or full
        sizes.setdefault(
            (binned[0] // bx, binned[1] // by), (x, y, bx, by) if part else (0, 0, bx, by)
        )
        if part:
            sizes.setdefault(part, (x, y, 1, 1))
        return sizes


class RgbdMessage(NamedTuple):
    """Colour, depth and both calibrations in one message."""

    stamp_ns: int
    color: ImageMessage
    depth: ImageMessage
    color_info: CameraInfoMessage
    depth_info: CameraInfoMessage


class TransformMessage(NamedTuple):
    """``T_parent_child`` at a time; also a robot's pose (child in parent)."""

    stamp_ns: int
    parent: str
    child: str
    """Empty if the message doesn't say what the pose is of."""
    translation: tuple[float, float, float]
    """Metres."""
    rotation: tuple[float, float, float, float]
    """Unit quaternion x y z w."""
    problem: str = ""
    """Why it is no motion, whatever its numbers here; empty when it is one."""


Message = (
    ImageMessage
    | CompressedImageMessage
    | CameraInfoMessage
    | RgbdMessage
    | tuple[TransformMessage, ...]
    | np.ndarray
    | float
)
"""What :class:`jaxdet.io.decode_messages.MessageDecoder` returns.

Extrinsics are a motion ``(4, 4)`` float64: RealSense's ``depth_to_color`` takes points of the depth
camera to the colour camera; in recordings of librealsense, a reference stream's to the topic's.
"""
