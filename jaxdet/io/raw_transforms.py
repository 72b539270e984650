"""Transforms and poses of ROS 2 in their messages, read in place.

Only for messages whose definition in the log is ROS 2's; all others are decoded by it. A robot
sends some hundred a second, and a decoder that works by the definition takes 0.1 ms for each.
"""

import struct

from jaxdet.io.message_fields import motion, nanoseconds, transform
from jaxdet.io.messages import Kind, TransformMessage

_COUNT = struct.Struct("<I")
_STAMP = struct.Struct("<iI")
_MOTION = struct.Struct("<7d")
_MAX_AT_ONCE = 1000
"""Transforms of a message."""
_ODOMETRY_REST = 8 * (36 + 6 + 36)
"""Bytes after the pose."""


def read_motions(kind: Kind, payload: bytes) -> tuple[TransformMessage, ...] | None:
    """The motions in a little-endian CDR message; None where they need decoding.

    Args:
        kind: ``TRANSFORM`` or ``ODOMETRY``; its definition is ROS 2's.
        payload: The whole message.

    Raises:
        FrameError: A stamp is out of range.
        ValueError: A pose is none; of transforms each says so itself.
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


def _text(payload: bytes, place: int) -> tuple[str, int]:
    """A string, and where it ends.

    Raises:
        IndexError: It is longer than the message.
    """
    (size,) = _COUNT.unpack_from(payload, place)
    place += _COUNT.size
    if size > len(payload) - place:
        raise IndexError
    return payload[place : place + max(size - 1, 0)].decode(), place + size
