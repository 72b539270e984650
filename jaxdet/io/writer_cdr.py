"""Encoding ROS 2 messages as CDR.

Messages are plain dictionaries; the definitions that say how they are encoded also go into a log
as its schemas (:func:`jaxdet.io.definition.schema_text`), so the two cannot disagree.
"""

import struct
from collections.abc import Mapping
from functools import cache
from typing import Any, NamedTuple

from jaxdet.io.definition import DEFINITIONS

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
    for line in DEFINITIONS[type_name].splitlines():
        kind, name = line.split()
        base, bracket, rest = kind.partition("[")
        fields.append(_Field(base, name, int(rest[:-1] or 0) if bracket else None))
    return tuple(fields)


def _append(out: bytearray, kind: str, value: Any) -> None:
    """Append one value, aligned to its size after the 4-byte header as CDR asks."""
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
