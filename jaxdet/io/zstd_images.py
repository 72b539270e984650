"""Raw images compressed by ROS's ``zstd`` transport.

The header has 17 bytes, little-endian: height and width, whether samples are big-endian, bytes per
row, length of the encoding's name. The name follows, then a zstd stream (or gzip, as the
transport wrote until 2026). Some writers omit the header; such images have the calibrated size, and
their bytes per pixel determine the encoding. Source: ``zstd_image_transport`` of
image_transport_plugins.
"""

import struct
import zlib
from typing import NamedTuple

import zstandard

from jaxdet.io.messages import CompressedImageMessage, ImageMessage, bad_frame

_HEAD = struct.Struct("<IIBII")
_MAX_NAME = 64
_ZSTD, _GZIP = b"\x28\xb5\x2f\xfd", b"\x1f\x8b"
_BARE = {1: "mono8", 3: "rgb8", 4: "rgba8"}
"""Encodings by bytes per pixel, for images without a header."""
_MAX_BYTES = 8
"""Maximum number of bytes per pixel."""


class ZstdHead(NamedTuple):
    """Header before the stream."""

    height: int
    width: int
    big_endian: int
    step: int
    encoding: str
    start: int
    """Offset of the stream [byte]."""


def is_zstd(format_text: str) -> bool:
    """Return whether a CompressedImage is from this transport, by its ``format``."""
    return format_text.partition(";")[0].strip().lower() == "zstd"


def read_zstd_head(data: bytes | memoryview) -> ZstdHead | None:
    """Parse the header of an image, which may be truncated after it; None without a header."""
    if len(data) < _HEAD.size or data[: len(_ZSTD)] == _ZSTD:
        return None
    height, width, big_endian, step, length = _HEAD.unpack_from(data)
    start = _HEAD.size + length
    if length > _MAX_NAME or len(data) < start:
        return None
    name = str(data[_HEAD.size : start], "ascii", "replace")
    return ZstdHead(height, width, big_endian, step, name, start)


def unpack(image: CompressedImageMessage, width: int, height: int) -> ImageMessage:
    """Decompress an image.

    Args:
        image: Message from this transport.
        width: Width of the image, used if there is no header [pixel].
        height: Height of the image, used if there is no header [pixel].

    Raises:
        FrameError: The image is damaged, or has more data than an image of this size.
    """
    data = memoryview(image.data)
    head = read_zstd_head(data)
    most = width * height * _MAX_BYTES
    if head:
        most = max(most, min(head.step, width * _MAX_BYTES * 2) * height * 3 // 2)
    try:
        pixels = _decompress(data[head.start :] if head else data, most)
    except (zstandard.ZstdError, zlib.error, ValueError) as error:
        raise bad_frame(f"zstd image can't be decoded ({error})") from error
    about = image.stamp_ns, image.frame_id
    if head:
        size = head.width, head.height, head.encoding, head.step, bool(head.big_endian)
        return ImageMessage(*about, *size, pixels)
    channels, rest = divmod(len(pixels), width * height)
    if rest or channels not in _BARE:
        size = f"{width}x{height} pixels"
        raise bad_frame(f"zstd image of {len(pixels)} bytes does not fit the camera's {size}")
    return ImageMessage(*about, width, height, _BARE[channels], 0, False, pixels)


def _decompress(data: memoryview, most: int) -> bytes:
    if data[: len(_GZIP)] == _GZIP:
        return zlib.decompressobj(wbits=31).decompress(data, most)
    size = zstandard.frame_content_size(data)
    if size > most:
        raise ValueError(f"its {size} bytes are too many for its size")
    return zstandard.ZstdDecompressor().decompress(data, max_output_size=most)
