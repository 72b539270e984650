"""Compressed images: JPEG and PNG colour, PNG depth, ROS's ``compressedDepth``.

``compressedDepth`` is a head of 12 bytes (format, then the quantisation's A and B), then a PNG,
or two counts (columns, rows) and an RVL stream. For 32FC1 the 16-bit numbers q in it are
inverse depths: z = A / (q - B) metres, q = 0 unknown. Source: image_transport_plugins,
``compressed_depth_image_transport``.
"""

import struct

import cv2
import numpy as np
import simplejpeg

from jaxdet.io.images import bad_frame, check_size, metres_to_units
from jaxdet.io.messages import CompressedImageMessage
from jaxdet.io.rvl import decode_rvl

_PNG = b"\x89PNG\r\n\x1a\n"
_JPEG = b"\xff\xd8"
_DEPTH_HEAD = struct.Struct("<iff")
_RVL_HEAD = struct.Struct("<II")


def is_compressed_depth(format_text: str, topic: str) -> bool:
    """Whether a CompressedImage holds depth, by its ``format`` and its topic."""
    encoding = format_text.partition(";")[0].strip().lower()
    if "compresseddepth" in format_text.lower() or topic.lower().endswith("/compresseddepth"):
        return True
    return encoding in ("16uc1", "mono16", "32fc1")


def is_png16(data: bytes) -> bool:
    """Whether a file is a 16-bit grey PNG, by its head."""
    return data.startswith(_PNG) and len(data) > 25 and data[24] == 16 and data[25] == 0


def compressed_size(image: CompressedImageMessage) -> tuple[int, int]:
    """Width and height [pixel] by the file's own head, without decoding.

    Raises:
        FrameError: It is neither JPEG, PNG nor ``compressedDepth``.
    """
    data = image.data
    if data.startswith(_JPEG):
        try:
            height, width = simplejpeg.decode_jpeg_header(data)[:2]
        except ValueError as error:
            raise bad_frame(f"JPEG head is damaged ({error})") from error
        return int(width), int(height)
    if not data.startswith(_PNG):
        data = data[_DEPTH_HEAD.size :]
        if _is_rvl(image.format) and len(data) >= _RVL_HEAD.size:
            width, height = _RVL_HEAD.unpack_from(data)
            return width, height
    if data.startswith(_PNG) and len(data) >= 33 and data[12:16] == b"IHDR":
        width, height = struct.unpack_from(">II", data, 16)
        return width, height
    raise bad_frame(f"compressed image of format {image.format!a} is not JPEG, PNG or RVL")


def decode_compressed_color(image: CompressedImageMessage, max_pixels: int) -> np.ndarray:
    """RGB ``(H, W, 3)`` uint8 of a JPEG or a PNG; grey is repeated in the three channels.

    Raises:
        FrameError: Another format, damaged, or larger than ``max_pixels``.
    """
    width, height = compressed_size(image)
    check_size(width, height, max_pixels)
    if image.data.startswith(_JPEG):
        try:
            return simplejpeg.decode_jpeg(image.data, colorspace="RGB")
        except ValueError as error:
            raise bad_frame(f"JPEG is damaged ({error})") from error
    pixels = _png(image.data, cv2.IMREAD_COLOR_RGB)
    if pixels.ndim != 3 or pixels.dtype != np.uint8:
        raise bad_frame("PNG is not an 8-bit colour image")
    return pixels


def decode_compressed_depth(
    image: CompressedImageMessage, unit_m: float, max_pixels: int
) -> np.ndarray:
    """Depth ``(H, W)`` uint16 in units of ``unit_m`` of ``compressedDepth`` or a 16-bit PNG.

    Raises:
        FrameError: Another format, damaged, or larger than ``max_pixels``.
    """
    width, height = compressed_size(image)
    check_size(width, height, max_pixels)
    if image.data.startswith(_PNG):
        return _png16(image.data)
    if len(image.data) < _DEPTH_HEAD.size:
        raise bad_frame("compressedDepth ends early")
    _, a, b = _DEPTH_HEAD.unpack_from(image.data)
    body = memoryview(image.data)[_DEPTH_HEAD.size :]
    if _is_rvl(image.format):
        try:
            codes = decode_rvl(body[_RVL_HEAD.size :], height, width)
        except ValueError as error:
            raise bad_frame(str(error)) from error
    else:
        codes = _png16(bytes(body))
    if image.format.partition(";")[0].strip().lower() == "32fc1":
        return _inverse_depth(codes, a, b, unit_m)
    return codes


def _inverse_depth(codes: np.ndarray, a: float, b: float, unit_m: float) -> np.ndarray:
    """Metres ``A / (q - B)`` in float32, as the encoder's other half does, to units."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        metres = np.float32(a) / (codes.astype(np.float32) - np.float32(b))
    return metres_to_units(np.where(codes == 0, np.float32(0), metres), unit_m)


def _is_rvl(format_text: str) -> bool:
    return "rvl" in format_text.lower()


def _png16(data: bytes) -> np.ndarray:
    pixels = _png(data, cv2.IMREAD_UNCHANGED)
    if pixels.ndim != 2 or pixels.dtype != np.uint16:
        raise bad_frame("PNG is not a 16-bit grey image")
    return pixels


def _png(data: bytes, mode: int) -> np.ndarray:
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), mode)
    except cv2.error as error:
        raise bad_frame(f"PNG is damaged ({' '.join(str(error).split())[:80]})") from error
    if pixels is None:
        raise bad_frame("PNG is damaged")
    return pixels
