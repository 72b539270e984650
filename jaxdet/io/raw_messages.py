"""ROS 2 messages parsed in place: pixels of raw images, and transforms and poses.

This is only possible if the definition in the log is the standard one; other messages are decoded
by their definition. Pixels are copied from the file directly into their arrays. Robots send several
hundred transforms per second, and a generic decoder takes 0.1 ms for each.
"""

import struct
from typing import NamedTuple

from jaxdet.io.declarations import ChannelInfo
from jaxdet.io.definition import is_standard
from jaxdet.io.images import canonical_encoding
from jaxdet.io.message_fields import MAX_STAMP_S, motion, nanoseconds, transform
from jaxdet.io.messages import Kind, TransformMessage, kind_of

HEAD_BYTES = 512
"""Number of bytes of an image message in which its pixels start, unless names are very long."""
_COUNT = struct.Struct("<I")
_STAMP = struct.Struct("<iI")
_SIZE = struct.Struct("<II")
_DATA = struct.Struct("<II")
_MOTION = struct.Struct("<7d")
_MAX_AT_ONCE = 1000
"""Maximum number of transforms in a message that is parsed in place."""
_ODOMETRY_REST = 8 * (36 + 6 + 36)
"""Number of bytes of an odometry message after its pose."""


class Pixels(NamedTuple):
    """Position and format of the pixels of a raw image in its message."""

    offset: int
    """Offset in the payload [byte]."""
    width: int
    height: int
    encoding: str
    """Encoding, named as by :func:`jaxdet.io.images.canonical_encoding`."""


def is_standard_image(channel: ChannelInfo) -> bool:
    """Return whether a channel has sensor_msgs/Image in CDR with the standard definition."""
    return kind_of(channel.schema_name) is Kind.IMAGE and is_standard(channel)


def find_pixels(head: bytes | memoryview, size: int) -> Pixels | None:
    """Locate the pixels of a little-endian CDR sensor_msgs/Image; None: decode the message.

    Args:
        head: First bytes of the payload, at least ``HEAD_BYTES`` or the complete payload.
        size: Size of the payload [byte].
    """
    try:
        if head[0] or head[1] != 1:
            return None
        sec, _ = _STAMP.unpack_from(head, 4)
        _, place = _text(head, 4 + _STAMP.size)
        height, width = _SIZE.unpack_from(head, place + -place % 4)
        encoding, place = _text(head, place + -place % 4 + _SIZE.size)
        big_endian, place = head[place], place + 1
        step, count = _DATA.unpack_from(head, place + -place % 4)
    except (IndexError, struct.error, UnicodeDecodeError):
        return None
    place += -place % 4 + _DATA.size
    encoding = canonical_encoding(encoding)
    row = width * (3 if encoding == "rgb8" else 2)
    good = encoding == "rgb8" or (encoding == "16uc1" and not big_endian)
    good &= 0 <= sec <= MAX_STAMP_S and step in (0, row)
    good &= height * row <= count <= size - place
    return Pixels(place, width, height, encoding) if good else None


def read_motions(kind: Kind, payload: bytes) -> tuple[TransformMessage, ...] | None:
    """Parse the motions in a little-endian CDR message in place; None: decode the message.

    Args:
        kind: ``TRANSFORM`` or ``ODOMETRY``, with the standard definition of ROS 2.
        payload: Complete message.

    Raises:
        FrameError: A timestamp is out of range.
        ValueError: A pose is not a rigid motion. For a transform, ``problem`` is set instead.
    """
    if payload[:2] != b"\0\1":
        return None
    found, place, count, rest = [], 4, 1, _ODOMETRY_REST
    try:
        if kind is Kind.TRANSFORM:
            (count,), place, rest = _COUNT.unpack_from(payload, place), 8, 0
        if count > _MAX_AT_ONCE:
            return None
        for _ in range(count):
            place += -place % 4
            stamp = _STAMP.unpack_from(payload, place)
            parent, place = _text(payload, place + _STAMP.size)
            child, place = _text(payload, place + -place % 4)
            place += -(place - 4) % 8
            values = _MOTION.unpack_from(payload, place)
            place += _MOTION.size
            names = parent.lstrip("/"), child.lstrip("/")
            found.append((nanoseconds(*stamp), *names, values[:3], values[3:]))
    except (struct.error, UnicodeDecodeError, IndexError):
        return None
    if place + rest > len(payload):
        return None
    make = transform if kind is Kind.TRANSFORM else motion
    return tuple(make(*parts) for parts in found)


def _text(payload: bytes | memoryview, place: int) -> tuple[str, int]:
    """Return a string and the offset of its end.

    Raises:
        IndexError: The string exceeds the message.
    """
    (size,) = _COUNT.unpack_from(payload, place)
    place += _COUNT.size
    if size > len(payload) - place:
        raise IndexError
    return str(payload[place : place + max(size - 1, 0)], "utf-8"), place + size
