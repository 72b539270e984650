"""Encoding ROS 2 messages as CDR, from the definitions that also go into a log as schemas.

Messages are plain dictionaries; since one table of definitions makes both the schema text and
the bytes, the two cannot disagree.
"""

import struct
from collections.abc import Mapping
from functools import cache
from typing import Any, NamedTuple

# Field lists of ROS 2 Jazzy's common_interfaces, geometry2,
# vision_msgs and realsense-ros; one line a field.
_DEFINITIONS = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "std_msgs/Float32": "float32 data",
    "sensor_msgs/Image": "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\n"
    "uint8 is_bigendian\nuint32 step\nuint8[] data",
    "sensor_msgs/CompressedImage": "std_msgs/Header header\nstring format\nuint8[] data",
    "sensor_msgs/RegionOfInterest": "uint32 x_offset\nuint32 y_offset\nuint32 height\n"
    "uint32 width\nbool do_rectify",
    "sensor_msgs/CameraInfo": "std_msgs/Header header\nuint32 height\nuint32 width\n"
    "string distortion_model\nfloat64[] d\nfloat64[9] k\nfloat64[9] r\nfloat64[12] p\n"
    "uint32 binning_x\nuint32 binning_y\nsensor_msgs/RegionOfInterest roi",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\n"
    "geometry_msgs/Quaternion rotation",
    "geometry_msgs/TransformStamped": "std_msgs/Header header\nstring child_frame_id\n"
    "geometry_msgs/Transform transform",
    "tf2_msgs/TFMessage": "geometry_msgs/TransformStamped[] transforms",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/PoseStamped": "std_msgs/Header header\ngeometry_msgs/Pose pose",
    "geometry_msgs/Twist": "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular",
    "geometry_msgs/PoseWithCovariance": "geometry_msgs/Pose pose\nfloat64[36] covariance",
    "geometry_msgs/TwistWithCovariance": "geometry_msgs/Twist twist\nfloat64[36] covariance",
    "nav_msgs/Odometry": "std_msgs/Header header\nstring child_frame_id\n"
    "geometry_msgs/PoseWithCovariance pose\ngeometry_msgs/TwistWithCovariance twist",
    "nav_msgs/MapMetaData": "builtin_interfaces/Time map_load_time\nfloat32 resolution\n"
    "uint32 width\nuint32 height\ngeometry_msgs/Pose origin",
    "nav_msgs/OccupancyGrid": "std_msgs/Header header\nnav_msgs/MapMetaData info\nint8[] data",
    "sensor_msgs/PointField": "string name\nuint32 offset\nuint8 datatype\nuint32 count",
    "sensor_msgs/PointCloud2": "std_msgs/Header header\nuint32 height\nuint32 width\n"
    "sensor_msgs/PointField[] fields\nbool is_bigendian\nuint32 point_step\nuint32 row_step\n"
    "uint8[] data\nbool is_dense",
    "vision_msgs/ObjectHypothesis": "string class_id\nfloat64 score",
    "vision_msgs/ObjectHypothesisWithPose": "vision_msgs/ObjectHypothesis hypothesis\n"
    "geometry_msgs/PoseWithCovariance pose",
    "vision_msgs/BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size",
    "vision_msgs/Detection3D": "std_msgs/Header header\n"
    "vision_msgs/ObjectHypothesisWithPose[] results\nvision_msgs/BoundingBox3D bbox\nstring id",
    "vision_msgs/Detection3DArray": "std_msgs/Header header\nvision_msgs/Detection3D[] detections",
    "realsense2_camera_msgs/Extrinsics": "float64[9] rotation\nfloat64[3] translation",
    "realsense2_camera_msgs/RGBD": "std_msgs/Header header\n"
    "sensor_msgs/CameraInfo rgb_camera_info\nsensor_msgs/CameraInfo depth_camera_info\n"
    "sensor_msgs/Image rgb\nsensor_msgs/Image depth",
}
_FORMATS = {
    "bool": "?",
    "int8": "b",
    "uint8": "B",
    "int32": "i",
    "uint32": "I",
    "float32": "f",
    "float64": "d",
}


class _Field(NamedTuple):
    type: str
    name: str
    length: int | None
    """None: a single value; 0: a sequence; else a fixed array of that many."""


@cache
def _fields(type_name: str) -> tuple[_Field, ...]:
    fields: list[_Field] = []
    for line in _DEFINITIONS[type_name].splitlines():
        kind, name = line.split()
        base, bracket, rest = kind.partition("[")
        fields.append(_Field(base, name, int(rest[:-1] or 0) if bracket else None))
    return tuple(fields)


def is_known(type_name: str) -> bool:
    """Whether there is a definition of a type."""
    return type_name in _DEFINITIONS


@cache
def schema_text(type_name: str) -> str:
    """The definition followed by those of the types inside it, as ROS 2 concatenates them."""
    order = [type_name]
    for name in order:
        order += [f.type for f in _fields(name) if f.type in _DEFINITIONS and f.type not in order]
    parts = [_DEFINITIONS[type_name] + "\n"]
    parts += [f"{'=' * 80}\nMSG: {name}\n{_DEFINITIONS[name]}\n" for name in order[1:]]
    return "".join(parts)


def _append(out: bytearray, kind: str, value: Any) -> None:
    """Append one value, aligned to its size after the 4-byte header as CDR asks."""
    if kind in _DEFINITIONS:
        for field in _fields(kind):
            _append_field(out, field, value[field.name])
    elif kind == "string":
        text = value.encode() + b"\0"
        _append(out, "uint32", len(text))
        out += text
    else:
        form = _FORMATS[kind]
        out += bytes(-(len(out) - 4) % struct.calcsize(form))
        out += struct.pack("<" + form, value)


def _append_field(out: bytearray, field: _Field, value: Any) -> None:
    if field.length is None:
        _append(out, field.type, value)
        return
    if field.length == 0:
        _append(out, "uint32", len(value))
    elif len(value) != field.length:
        raise ValueError(f"{field.name} has {len(value)} values, not {field.length}")
    if isinstance(value, bytes | memoryview):
        out += value
        return
    if field.type in _FORMATS and value:
        form = _FORMATS[field.type]
        out += bytes(-(len(out) - 4) % struct.calcsize(form))
        out += struct.pack(f"<{len(value)}{form}", *value)
        return
    for item in value:
        _append(out, field.type, item)


def encode_cdr(type_name: str, message: Mapping[str, Any]) -> bytes:
    """Encode a message as little-endian plain CDR (OMG DDSI-RTPS, XCDR1).

    Args:
        type_name: A type of this module, such as ``"sensor_msgs/Image"``.
        message: Its fields by name, nested types as dictionaries, ``uint8[]`` and ``int8[]`` as
            bytes.

    Raises:
        KeyError: The type is unknown or a field is missing.
        ValueError: A fixed array has the wrong length.
    """
    out = bytearray(b"\0\1\0\0")
    _append(out, type_name, message)
    return bytes(out)
