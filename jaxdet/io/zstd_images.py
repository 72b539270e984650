"""Raw images that ROS's transport ``zstd`` compresses.

A head of 17 bytes, little-endian: height and width, whether samples are big-endian, bytes of a row,
length of the encoding's name; then that name, then a stream of zstd, or of gzip as the transport
wrote until 2026. Some writers leave the head out: then the image has the calibrated size, and its
bytes per pixel stand for the encoding. Source: ``zstd_image_transport`` of image_transport_plugins.
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
"""Encodings by bytes per pixel, where no head tells."""
_MAX_BYTES = 8
"""Of a pixel."""


class ZstdHead(NamedTuple):
    """What stands before the stream."""

    height: int
    width: int
    big_endian: int
    step: int
    encoding: str
    start: int
    """Where the stream begins."""


def is_zstd(format_text: str) -> bool:
    """Return whether a CompressedImage is of this transport, by its ``format``."""
    return format_text.partition(";")[0].strip().lower() == "zstd"


def read_zstd_head(data: bytes | memoryview) -> ZstdHead | None:
    """Return the head of an image, which may be cut off behind it; None if there is none."""
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
        image: The message, of this transport.
        width: Of the image, and of one without a head [pixel].
        height: Likewise.

    Raises:
        FrameError: It is damaged, or holds more than an image of this size does.
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
        raise bad_frame(f"zstd image of {len(pixels)} bytes, but the camera's is {width}x{height}")
    return ImageMessage(*about, width, height, _BARE[channels], 0, False, pixels)


def _decompress(data: memoryview, most: int) -> bytes:
    if data[: len(_GZIP)] == _GZIP:
        return zlib.decompressobj(wbits=31).decompress(data, most)
    size = zstandard.frame_content_size(data)
    if size > most:
        raise ValueError(f"its {size} bytes are too many for its size")
    return zstandard.ZstdDecompressor().decompress(data, max_output_size=most)
