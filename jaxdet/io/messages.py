"""Message types used by jaxdet, independent of format and encoding."""

from enum import Enum
from itertools import product
from typing import NamedTuple

import numpy as np

from jaxdet.errors import FrameError, FrameStatus


class Kind(Enum):
    """Kind of message, by its schema."""

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
    "realsense2_camera/Extrinsics": Kind.EXTRINSICS,
    "geometry_msgs/Transform": Kind.EXTRINSICS,
    "std_msgs/Float32": Kind.NUMBER,
}


def plain_schema_name(name: str) -> str:
    """Return a schema name without ``/msg/``, with ``foxglove.`` for ``foxglove_msgs/``."""
    plain = name.replace("/msg/", "/")
    return plain.replace("foxglove_msgs/", "foxglove.", 1)


def kind_of(schema_name: str) -> Kind | None:
    """Return the kind of messages of a schema; None if they are not used."""
    return _KINDS.get(plain_schema_name(schema_name))


def bad_frame(problem: str) -> FrameError:
    """Return the error for a message or image that can't be decoded."""
    return FrameError(problem, status=FrameStatus.DECODE_ERROR)


class ImageMessage(NamedTuple):
    """A raw image."""

    stamp_ns: int
    frame_id: str
    width: int
    height: int
    encoding: str
    step: int
    """Number of bytes per row, including padding."""
    big_endian: bool
    data: bytes | memoryview
    """Pixels; if possible a view of the encoded message."""


class CompressedImageMessage(NamedTuple):
    """An image in a file format (JPEG, PNG, ROS's compressedDepth)."""

    stamp_ns: int
    frame_id: str
    format: str
    data: bytes | memoryview
    """File contents; if possible a view of the encoded message."""


class CameraInfoMessage(NamedTuple):
    """Calibration of a camera, as in the log."""

    stamp_ns: int
    frame_id: str
    width: int
    height: int
    model: str
    D: tuple[float, ...]
    K: tuple[float, ...]
    """Camera matrix: nine numbers, row-major."""
    P: tuple[float, ...]
    """Projection matrix of the rectified image: twelve numbers, row-major; may be empty."""
    binning: tuple[int, int] = (1, 1)
    """Number of sensor columns and rows per image pixel."""
    roi: tuple[int, int, int, int] = (0, 0, 0, 0)
    """Region of the sensor shown in the images: x, y, width, height; width 0 means the whole
    sensor."""

    def image_sizes(self) -> dict[tuple[int, int], tuple[int, int, int, int]]:
        """Return the image sizes that the message allows, each with x and y offset and binning.

        By definition width, height, K and P refer to the full sensor; the region of interest is cut
        out before binning (sensor_msgs/CameraInfo). Some drivers store the size of their images as
        width and height, with K for this size. So this size comes first and needs no correction.
        Images with the size of the region are not accepted if there is binning: the region may be
        in pixels before or after binning. Drivers round the size of binned images down or up.
        """
        (bx, by), (x, y, width, height) = self.binning, self.roi
        if not (width and height):
            x, y, width, height = 0, 0, self.width, self.height
        sizes = {(self.width, self.height): (0, 0, 1, 1)}
        for size in product((width // bx, -(-width // bx)), (height // by, -(-height // by))):
            sizes.setdefault(size, (x, y, bx, by))
        return sizes


class RgbdMessage(NamedTuple):
    """Colour, depth and both calibrations in one message."""

    stamp_ns: int
    color: ImageMessage
    depth: ImageMessage
    color_info: CameraInfoMessage
    depth_info: CameraInfoMessage


class TransformMessage(NamedTuple):
    """Transform ``T_parent_child`` at a time, or pose of a robot (child) in a frame (parent)."""

    stamp_ns: int
    parent: str
    child: str
    """Child frame; empty if the message does not name it."""
    translation: tuple[float, float, float]
    """Translation x y z [m]."""
    rotation: tuple[float, float, float, float]
    """Unit quaternion x y z w."""
    problem: str = ""
    """Reason why the values are not a rigid motion; empty if they are."""


Message = (
    ImageMessage
    | CompressedImageMessage
    | CameraInfoMessage
    | RgbdMessage
    | tuple[TransformMessage, ...]
    | np.ndarray
    | float
)
"""Result of :class:`jaxdet.io.decode_messages.MessageDecoder`.

Extrinsics are a motion ``(4, 4)`` float64. RealSense's ``depth_to_color`` maps points from the
depth to the colour camera; in recordings of librealsense it maps from a reference stream to that of
the topic.
"""
