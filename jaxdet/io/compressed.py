"""Compressed images: JPEG and PNG colour, PNG depth, ROS's ``compressedDepth`` and ``zstd``.

``compressedDepth`` has a header of 12 bytes (format, then the parameters A and B of the
quantisation), followed by a PNG, or by two counts (columns, rows) and an RVL stream. For 32FC1 its
16-bit numbers q are inverse depths: z = A / (q - B) metres; q = 0 is unknown. Source:
image_transport_plugins, ``compressed_depth_image_transport``.

In folders of images, a depth image may be followed by a PNG with its confidences (ARKit's, 0 to 2),
as noted in its format string; pixels with a confidence below ``MIN_CONFIDENCE`` are unmeasured. The
format string also notes whether depth is rotated by three bits, as in SUN3D.
"""

import struct
from functools import lru_cache

import numpy as np

from jaxdet.io.images import (
    check_row,
    check_size,
    decode_color,
    decode_depth,
    depth_pixels,
    is_color_encoding,
    is_depth_encoding,
    metres_to_units,
)
from jaxdet.io.jpeg import MAGIC as JPEG
from jaxdet.io.jpeg import decode_jpeg, jpeg_size
from jaxdet.io.kernels import launch
from jaxdet.io.messages import CompressedImageMessage, ImageMessage, bad_frame
from jaxdet.io.png import MAGIC, decode_png_color, decode_png_depth, read_png_head
from jaxdet.io.zstd_images import is_zstd, read_zstd_head, unpack

_DEPTH_HEAD = struct.Struct("<iff")
_RVL_HEAD = struct.Struct("<II")
_RVL_ERRORS = (
    "",
    "RVL stream ends early",
    "RVL run leaves the image",
    "RVL number is longer than 32 bits",
    "RVL value is not 16 bits",
)
"""Error messages by status of the kernel."""
_MAX_TYPICAL_PIXELS = 1 << 23
"""Maximum number of pixels of an image whose typical depth is determined."""
MIN_CONFIDENCE = 1
_CONFIDENCE = "; confidence at "
ROTATED = "; rotated left by 3 bits"
"""Suffix of ``format`` for 16-bit depth whose bits are stored rotated left by three."""


def with_confidence(place: int) -> str:
    """Return the suffix of ``format`` for data whose confidences start at byte ``place``."""
    return f"{_CONFIDENCE}{place}"


def is_compressed_depth(format_text: str, topic: str) -> bool:
    """Return whether a CompressedImage contains depth, by its ``format`` and topic."""
    encoding = format_text.partition(";")[0].strip().lower()
    if "compresseddepth" in format_text.lower() or topic.lower().endswith("/compresseddepth"):
        return True
    return encoding in ("16uc1", "mono16", "32fc1")


def is_png16(data: bytes | memoryview) -> bool:
    """Return whether a file is a 16-bit grey PNG, by its header."""
    try:
        return read_png_head(data).is_grey16
    except ValueError:
        return False


def is_color_file(image: CompressedImageMessage) -> bool:
    """Return whether a CompressedImage can be decoded to RGB, by its ``format`` or file header."""
    if is_zstd(image.format):
        head = read_zstd_head(image.data)
        return head is None or is_color_encoding(head.encoding)
    named = any(name in image.format.lower() for name in ("jpeg", "jpg", "png"))
    return named or any(_begins(memoryview(image.data), magic) for magic in (JPEG, MAGIC))


def is_depth_file(image: CompressedImageMessage, topic: str) -> bool:
    """Return whether a CompressedImage contains depth, by its ``format``, file header or topic."""
    if is_zstd(image.format):
        head = read_zstd_head(image.data)
        return head is not None and is_depth_encoding(head.encoding)
    named = is_compressed_depth(image.format, topic) and not is_jpeg(image)
    return named or is_png16(image.data)


def is_jpeg(image: CompressedImageMessage) -> bool:
    """Return whether a CompressedImage is a JPEG, by its file header."""
    return _begins(memoryview(image.data), JPEG)


def compressed_size(image: CompressedImageMessage) -> tuple[int, int]:
    """Return width and height [pixel] from the file header, without decoding.

    Raises:
        FrameError: The image is empty, or neither JPEG, PNG nor ``compressedDepth``.
    """
    data = memoryview(image.data)
    if not len(data):
        raise bad_frame("the image has no data")
    if is_zstd(image.format):
        found = read_zstd_head(data)
        if found is None:
            raise bad_frame("the image has no header")
        return found.width, found.height
    if _begins(data, JPEG):
        try:
            return jpeg_size(data)
        except ValueError as error:
            raise bad_frame(f"JPEG header is damaged ({error})") from error
    if not _begins(data, MAGIC):
        data = data[_DEPTH_HEAD.size :]
        if _is_rvl(image.format) and len(data) >= _RVL_HEAD.size:
            width, height = _RVL_HEAD.unpack_from(data)
            return width, height
    try:
        return read_png_head(data)[:2]
    except ValueError as error:
        problem = f"compressed image of format {image.format!a} is not JPEG, PNG or RVL"
        raise bad_frame(problem) from error


def decode_compressed_color(
    image: CompressedImageMessage, row: np.ndarray, max_pixels: int
) -> None:
    """Decode a JPEG, PNG or zstd image to RGB; grey is repeated in the three channels.

    Args:
        image: Message.
        row: Output ``(H, W, 3)`` uint8, contiguous.
        max_pixels: Maximum number of pixels.

    Raises:
        FrameError: The format or size is wrong, the data are damaged, or there are more pixels
            than ``max_pixels``.
    """
    if is_zstd(image.format):
        decode_color(_unpacked("colour", image, row, max_pixels), row, max_pixels)
        return
    _check("colour", image, row, max_pixels)
    data = memoryview(image.data)
    try:
        if _begins(data, JPEG):
            decode_jpeg(data, row)
        else:
            decode_png_color(data, row)
    except ValueError as error:
        kind = "JPEG" if _begins(data, JPEG) else "PNG"
        raise bad_frame(f"{kind} can't be decoded ({error})") from error


def decode_compressed_depth(
    image: CompressedImageMessage, row: np.ndarray, unit_m: float, max_pixels: int
) -> None:
    """Decode ``compressedDepth``, a 16-bit PNG or a zstd image to depth units.

    Args:
        image: Message.
        row: Output ``(H, W)`` uint16, contiguous.
        unit_m: Metres per depth unit.
        max_pixels: Maximum number of pixels.

    Raises:
        FrameError: The format or size is wrong, the data are damaged, or there are more pixels
            than ``max_pixels``.
    """
    if is_zstd(image.format):
        decode_depth(_unpacked("depth", image, row, max_pixels), row, unit_m, max_pixels)
        return
    _check("depth", image, row, max_pixels)
    scale = _decode_codes(image, row)
    if scale is not None:
        np.take(_inverse_depths(*scale, unit_m), row, out=row)


def typical_depth(image: ImageMessage | CompressedImageMessage) -> float:
    """Return the median of the measured depths of an image, in the unit of the image.

    The result is NaN if no depth is measured.

    Raises:
        FrameError: The image can't be decoded, or has more than ``_MAX_TYPICAL_PIXELS``.
    """
    if isinstance(image, ImageMessage):
        pixels, scale = depth_pixels(image, _MAX_TYPICAL_PIXELS), None
    else:
        width, height = compressed_size(image)
        check_size(width, height, _MAX_TYPICAL_PIXELS)
        if is_zstd(image.format):
            return typical_depth(unpack(image, width, height))
        pixels = np.empty((height, width), np.uint16)
        scale = _decode_codes(image, pixels)
    some = pixels[::4, ::4].astype(np.float32)
    if scale is not None:
        some = _depths_of(some, *scale)
    good = some[np.isfinite(some) & (some > 0)]
    return float(np.median(good)) if len(good) else float("nan")


def _decode_codes(image: CompressedImageMessage, row: np.ndarray) -> tuple[float, float] | None:
    """Decode a PNG or RVL stream of 16 bits; return A and B if they are inverse depths.

    Raises:
        FrameError: The data are damaged.
    """
    data = memoryview(image.data)
    _, masked, place = image.format.partition(_CONFIDENCE)
    if masked:
        _decode_masked(data, place, row)
        return None
    headed = not _begins(data, MAGIC)
    if headed and len(data) < _DEPTH_HEAD.size:
        raise bad_frame("compressedDepth ends early")
    rvl = headed and _is_rvl(image.format)
    try:
        if rvl:
            decode_rvl(data[_DEPTH_HEAD.size + _RVL_HEAD.size :], row)
        else:
            decode_png_depth(data[_DEPTH_HEAD.size :] if headed else data, row)
    except ValueError as error:
        raise bad_frame(str(error) if rvl else f"PNG can't be decoded ({error})") from error
    if headed and image.format.partition(";")[0].strip().lower() == "32fc1":
        return _DEPTH_HEAD.unpack_from(data)[1:]
    if image.format.endswith(ROTATED):
        np.bitwise_or(row >> 3, row << 13, out=row)
    return None


def decode_rvl(data: bytes | memoryview, row: np.ndarray) -> None:
    """Decode an RVL stream (A. Wilson, *Fast Lossless Depth Image Compression*, ISS 2017).

    The stream consists of little-endian 32-bit words of eight nibbles, the most significant first.
    Numbers have three bits per nibble, lowest first; the top bit of a nibble is set if the number
    continues. The stream repeats: a count of zero pixels, a count of non-zero pixels, and for each
    of the latter the difference from the previous non-zero pixel, its sign in the lowest bit. A
    number has at most 11 nibbles, and two counts fill at least one pixel, so a stream needs at most
    33 nibbles per pixel.

    Args:
        data: Stream without header; bytes after the last pixel are ignored.
        row: Output ``(H, W)`` uint16, contiguous.

    Raises:
        ValueError: The stream is too short, its counts exceed the image, or a value exceeds uint16.
    """
    status = np.zeros(1, np.int32)
    launch("rvl", np.frombuffer(data, np.uint8), row, status)
    if status[0]:
        raise ValueError(_RVL_ERRORS[status[0]])


def _decode_masked(data: memoryview, place_text: str, row: np.ndarray) -> None:
    """Decode a depth PNG, and set pixels to 0 where the following PNG has a low confidence."""
    confidence = np.empty((*row.shape, 3), np.uint8)
    try:
        place = int(place_text)
        decode_png_depth(data[:place], row)
    except ValueError as error:
        raise bad_frame(f"PNG can't be decoded ({error})") from error
    try:
        decode_png_color(data[place:], confidence)
    except ValueError as error:
        raise bad_frame(f"the confidences can't be decoded ({error})") from error
    row[confidence[..., 0] < MIN_CONFIDENCE] = 0


@lru_cache(maxsize=4)
def _inverse_depths(a: float, b: float, unit_m: float) -> np.ndarray:
    """Return the depth of each 16-bit code ``q``, ``(65536,)`` uint16 [depth units].

    The depth is ``A / (q - B)`` [m], computed in float32, and 0 for code 0.
    """
    codes, units = np.arange(1 << 16, dtype=np.float32), np.empty((1, 1 << 16), np.uint16)
    metres_to_units(_depths_of(codes, a, b)[None], unit_m, units)
    return units[0]


def _depths_of(codes: np.ndarray, a: float, b: float) -> np.ndarray:
    """Return ``A / (q - B)`` for float32 codes ``q``, 0 for code 0."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        depth = np.float32(a) / (codes - np.float32(b))
    return np.where(codes == 0, np.float32(0), depth)


def _unpacked(
    what: str, image: CompressedImageMessage, row: np.ndarray, max_pixels: int
) -> ImageMessage:
    if read_zstd_head(image.data) is not None:
        _check(what, image, row, max_pixels)
    return unpack(image, row.shape[1], row.shape[0])


def _check(what: str, image: CompressedImageMessage, row: np.ndarray, max_pixels: int) -> None:
    width, height = compressed_size(image)
    check_size(width, height, max_pixels)
    check_row(what, width, height, row)


def _begins(data: memoryview, magic: bytes) -> bool:
    return data[: len(magic)] == magic


def _is_rvl(format_text: str) -> bool:
    return "rvl" in format_text.lower()
