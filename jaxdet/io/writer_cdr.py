"""ROS 2 messages as dictionaries, and their encoding as CDR.

The definitions used for the encoding are also written into logs as schemas
(:func:`jaxdet.io.definition.schema_text`), so both always agree. The writer of ``mcap_ros2`` is not
used, as it replaces missing fields by defaults, and takes a second for a map of a million cells.
"""

import struct
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from jaxdet.io.definition import DEFINITIONS
from jaxdet.io.motion import quaternions
from jaxdet.types import Distortion, Intrinsics

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
    """Array length; None: a single value; 0: a sequence of any length."""


@cache
def _fields(type_name: str) -> tuple[_Field, ...]:
    fields: list[_Field] = []
    for line in DEFINITIONS[type_name].splitlines():
        kind, name = line.split()
        base, bracket, rest = kind.partition("[")
        fields.append(_Field(base, name, int(rest[:-1] or 0) if bracket else None))
    return tuple(fields)


def _append(out: bytearray, kind: str, value: Any) -> None:
    """Append a value, aligned to its size as CDR requires (after the 4-byte header)."""
    if kind in DEFINITIONS:
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
        raise ValueError(f"{field.name}: expected {field.length} values, got {len(value)}")
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
        type_name: Type defined in :mod:`jaxdet.io.definition`, such as ``"sensor_msgs/Image"``.
        message: Fields by name, with nested types as dictionaries, and ``uint8[]`` and ``int8[]``
            as bytes.

    Raises:
        KeyError: The type is unknown, or a field is missing.
        ValueError: A fixed array has the wrong length.
    """
    out = bytearray(b"\0\1\0\0")
    _append(out, type_name, message)
    return bytes(out)


def header(stamp_ns: int, frame_id: str) -> dict[str, Any]:
    """Build a ``std_msgs/Header``."""
    sec, nanosec = divmod(int(stamp_ns), 10**9)
    return {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": frame_id}


def camera_info(stamp_ns: int, frame_id: str, camera: Intrinsics) -> dict[str, Any]:
    """Build a ``sensor_msgs/CameraInfo``; no distortion is ``plumb_bob`` with zeros."""
    plain = camera.distortion is Distortion.NONE
    fx, fy, cx, cy = camera.fx, camera.fy, camera.cx, camera.cy
    return {
        "header": header(stamp_ns, frame_id), "height": camera.height, "width": camera.width,
        "distortion_model": "plumb_bob" if plain else str(camera.distortion),
        "d": (0.0,) * 5 if plain else camera.coefficients,
        "k": (fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0),
        "r": (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
        "p": (fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0),
        "binning_x": 0, "binning_y": 0,
        "roi": {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False},
    }  # fmt: skip


def quaternion(R: np.ndarray) -> dict[str, float]:
    """Convert a rotation ``(3, 3)`` to a ``geometry_msgs/Quaternion``."""
    return dict(zip("xyzw", quaternions(np.asarray(R, np.float64)).tolist(), strict=True))


def xyz(vector: np.ndarray | Sequence[float]) -> dict[str, float]:
    """Convert a vector of three numbers to a ``geometry_msgs/Point`` or ``Vector3``."""
    return dict(zip("xyz", np.asarray(vector, np.float64).tolist(), strict=True))


def pose_of(T: np.ndarray) -> dict[str, Any]:
    """Convert a rigid motion ``(4, 4)`` to a ``geometry_msgs/Pose``."""
    return {"position": xyz(T[:3, 3]), "orientation": quaternion(T[:3, :3])}
