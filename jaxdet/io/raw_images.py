"""Where the pixels of a raw ROS 2 image lie in its message, so that they can be read in place.

Only for messages whose definition in the log is ROS 2's, and only where the pixels are already
what the arrays hold; all others are decoded.
"""

import struct
from typing import NamedTuple

from jaxdet.io.declarations import ChannelInfo
from jaxdet.io.definition import is_standard
from jaxdet.io.images import canonical_encoding
from jaxdet.io.message_fields import MAX_STAMP_S
from jaxdet.io.messages import Kind, kind_of

HEAD_BYTES = 512
"""How much of a message is looked at."""
_STAMP = struct.Struct("<iII")
_SIZE = struct.Struct("<III")
_DATA = struct.Struct("<II")


class Pixels(NamedTuple):
    """A raw image's pixels in its message."""

    offset: int
    """From the start of the payload."""
    width: int
    height: int
    encoding: str
    """One lower-case name for each encoding."""


def is_standard_image(channel: ChannelInfo) -> bool:
    """Whether a channel holds sensor_msgs/Image in CDR as ROS 2 defines it."""
    return kind_of(channel.schema_name) is Kind.IMAGE and is_standard(channel)


def find_pixels(head: bytes | memoryview, size: int) -> Pixels | None:
    """The pixels of a little-endian CDR sensor_msgs/Image; None where they need decoding.

    Args:
        head: The first bytes of the payload, at least ``HEAD_BYTES`` where it has as many.
        size: Of the payload.
    """
    try:
        if head[0] or head[1] != 1:
            return None
        sec, _, frame = _STAMP.unpack_from(head, 4)
        place = 16 + frame
        str(head[16:place], "utf-8")
        place += -place % 4
        height, width, name = _SIZE.unpack_from(head, place)
        place += _SIZE.size
        encoding = str(head[place : place + name - 1], "ascii")
        big_endian = head[place + name]
        place += name + 1
        place += -place % 4
        step, count = _DATA.unpack_from(head, place)
    except (IndexError, struct.error, UnicodeDecodeError, ValueError):
        return None
    place += _DATA.size
    encoding = canonical_encoding(encoding)
    row = width * (3 if encoding == "rgb8" else 2)
    good = encoding == "rgb8" or (encoding == "16uc1" and not big_endian)
    good &= 0 <= sec <= MAX_STAMP_S and step in (0, row) and name > 0
    good &= height * row <= count <= size - place
    return Pixels(place, width, height, encoding) if good else None
