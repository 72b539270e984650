"""Decoding of PNG files to RGB (by OpenCV) and to 16-bit depth, with limits on the work.

Source: Portable Network Graphics Specification, Second Edition. The CRC of each chunk and the
Adler-32 of the pixels are checked. Palettes, fewer than 8 bits per sample and interlaced files are
rejected, as no camera driver writes them. Chunks that do not change the samples (gamma,
transparency, text) are ignored, as in OpenCV.
"""

import struct
from typing import NamedTuple

import cv2
import deflate
import numpy as np

from jaxdet.io.kernels import launch

MAGIC = b"\x89PNG\r\n\x1a\n"
_GREY = 0
_SAMPLES = {_GREY: 1, 2: 3, 4: 2, 6: 4}
"""Samples per pixel by colour type: grey, RGB, grey with alpha, RGB with alpha."""
_CHUNK = struct.Struct(">I4s")
_CRC_BYTES = 4
_HEAD = struct.Struct(">IIBBBBB")
_RGB = cv2.IMREAD_COLOR_RGB | cv2.IMREAD_IGNORE_ORIENTATION
_ANCILLARY = 0x20
"""Bit of a chunk's name that marks it as optional."""
_LAST_FILTER = 4
_FREE_BYTES, _FREE_CHUNKS, _CHUNK_BYTES = 1 << 10, 64, 256
"""Maximum number of chunks: a constant, plus one per this many bytes; libpng's chunks have 8 KiB.
"""


class PngHead(NamedTuple):
    """Header chunk of a PNG; only its position is checked."""

    width: int
    height: int
    bits: int
    """Bits per sample."""
    color_type: int
    compression: int
    filters: int
    interlace: int

    @property
    def is_grey16(self) -> bool:
        """Whether the image can be depth."""
        return self.bits == 16 and self.color_type == _GREY


def read_png_head(data: bytes | memoryview) -> PngHead:
    """Parse the header of a file, which may be truncated after it.

    Raises:
        ValueError: The file is not a PNG, or its header is truncated.
    """
    start = len(MAGIC) + _CHUNK.size
    if len(data) < start + _HEAD.size or bytes(data[: len(MAGIC)]) != MAGIC:
        raise ValueError("not a PNG: its signature or IHDR chunk is missing")
    if _CHUNK.unpack_from(data, len(MAGIC)) != (_HEAD.size, b"IHDR"):
        raise ValueError("not a PNG: its signature or IHDR chunk is missing")
    return PngHead(*_HEAD.unpack_from(data, start))


def decode_png_depth(data: bytes | memoryview, row: np.ndarray) -> None:
    """Decode a 16-bit grey PNG.

    Args:
        data: Contents of the file.
        row: Output ``(H, W)`` uint16, contiguous.

    Raises:
        ValueError: The file is damaged, or the kind or size of the image is wrong.
    """
    head = read_png_head(data)
    if not head.is_grey16:
        raise ValueError("it is not a 16-bit grey image")
    launch("png_depth", _lines(data, head, row), row)


def decode_png_color(data: bytes | memoryview, row: np.ndarray) -> None:
    """Decode a PNG to RGB: alpha is dropped, grey repeated, 16 bits reduced to the upper 8.

    Args:
        data: Contents of the file.
        row: Output ``(H, W, 3)`` uint8, contiguous.

    Raises:
        ValueError: The file is damaged, or the kind or size of the image is wrong.
    """
    # check first, as OpenCV returns the intact part of damaged files
    _lines(data, read_png_head(data), row)
    pixels = cv2.imdecode(np.frombuffer(data, np.uint8), _RGB)
    if pixels is None or pixels.shape != row.shape:
        raise ValueError("OpenCV can't decode it")
    row[:] = pixels


def _lines(data: bytes | memoryview, head: PngHead, row: np.ndarray) -> np.ndarray:
    """Return the rows ``(H, 1 + bytes)`` uint8, each preceded by its filter type."""
    if head.color_type not in _SAMPLES or head.bits not in (8, 16):
        raise ValueError("palettes and fewer than 8 bits per sample are not supported")
    if head.interlace or head.compression or head.filters:
        raise ValueError("interlaced files are not supported")
    if row.shape[:2] != (head.height, head.width):
        expected = f"{row.shape[1]}x{row.shape[0]}"
        raise ValueError(f"its size is {head.width}x{head.height}, expected {expected}")
    line = 1 + head.width * _SAMPLES[head.color_type] * head.bits // 8
    compressed = _compressed(memoryview(data))
    # Incompressible data are stored with little overhead. More bytes could be blocks that inflate
    # to nothing, each of which takes as long as a thousand pixels.
    if len(compressed) > head.height * line * 5 // 4 + _FREE_BYTES:
        raise ValueError(f"{len(compressed)} bytes are too many for its size")
    try:
        inflated = deflate.zlib_decompress(compressed, head.height * line)
    except deflate.DeflateError as error:
        raise ValueError("its pixels can't be inflated, or are too many") from error
    if len(inflated) != head.height * line:
        raise ValueError("it has fewer pixels than its header says")
    lines = np.frombuffer(inflated, np.uint8).reshape(head.height, line)
    if lines[:, 0].max() > _LAST_FILTER:
        raise ValueError("a filter is unknown")
    return lines


def _compressed(data: memoryview) -> bytes | memoryview:
    """Return the concatenated contents of the IDAT chunks."""
    parts: list[memoryview] = []
    left = _FREE_CHUNKS + len(data) // _CHUNK_BYTES
    position, name, known = len(MAGIC), b"", {b"IHDR"}
    while name != b"IEND":
        if position + _CHUNK.size > len(data):
            raise ValueError("it ends early")
        left -= 1
        if left < 0:
            raise ValueError("it has too many chunks")
        size, name = _CHUNK.unpack_from(data, position)
        start = position + _CHUNK.size
        position = start + size + _CRC_BYTES
        if position > len(data):
            raise ValueError("it ends early")
        crc = int.from_bytes(data[start + size : position])
        if deflate.crc32(data[start - len(name) : start + size]) != crc:
            raise ValueError("a chunk has a wrong CRC")
        if name == b"IDAT":
            parts.append(data[start : start + size])
        elif not name[0] & _ANCILLARY and name not in known:
            raise ValueError(f"chunk {name!a} is unknown or in the wrong place")
        known = {b"PLTE", b"IEND"}
    return parts[0] if len(parts) == 1 else b"".join(parts)
