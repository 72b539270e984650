"""Conversion of raw ROS and Foxglove images to RGB and depth units, into rows of a batch."""

from typing import NamedTuple

import cv2
import numpy as np

from jaxdet.errors import FrameError, FrameStatus
from jaxdet.io.kernels import launch
from jaxdet.io.messages import ImageMessage, bad_frame

_ALIASES = {
    "8uc1": "mono8",
    "8uc3": "bgr8",
    "8uc4": "bgra8",
    "16uc3": "bgr16",
    "16uc4": "bgra16",
    "yuv422_yuy2": "yuyv",
    "yuyv422": "yuyv",
    "yuv422": "uyvy",
    "uyvy422": "uyvy",
    "mono16": "16uc1",
}


class _Conversion(NamedTuple):
    """Conversion of an encoding to RGB."""

    channels: int
    """Samples per pixel in the image."""
    code: int | None
    """OpenCV's conversion code; None if no conversion is needed."""
    bits: int = 8
    """Bits per sample; of 16-bit samples the upper 8 bits are used."""
    even: tuple[int, int] = (1, 1)
    """Numbers of which width and height must be multiples."""
    half_plane: bool = False
    """Whether the rows of brightness are followed by half as many rows of chroma."""


_LAYOUTS = {
    "rgb": (3, None),
    "bgr": (3, cv2.COLOR_BGR2RGB),
    "rgba": (4, cv2.COLOR_RGBA2RGB),
    "bgra": (4, cv2.COLOR_BGRA2RGB),
    "mono": (1, cv2.COLOR_GRAY2RGB),
    "bayer_rggb": (1, cv2.COLOR_BayerRGGB2RGB),
    "bayer_bggr": (1, cv2.COLOR_BayerBGGR2RGB),
    "bayer_gbrg": (1, cv2.COLOR_BayerGBRG2RGB),
    "bayer_grbg": (1, cv2.COLOR_BayerGRBG2RGB),
}
_TO_RGB = {
    f"{name}{bits}": _Conversion(channels, code, bits, (2, 2) if "bayer" in name else (1, 1))
    for name, (channels, code) in _LAYOUTS.items()
    for bits in (8, 16)
} | {
    "yuyv": _Conversion(2, cv2.COLOR_YUV2RGB_YUY2, even=(2, 1)),
    "uyvy": _Conversion(2, cv2.COLOR_YUV2RGB_UYVY, even=(2, 1)),
    "nv12": _Conversion(1, cv2.COLOR_YUV2RGB_NV12, even=(2, 2), half_plane=True),
    "nv21": _Conversion(1, cv2.COLOR_YUV2RGB_NV21, even=(2, 2), half_plane=True),
}
_DEPTH_TYPES = {"16uc1": "u2", "32fc1": "f4"}


def canonical_encoding(encoding: str) -> str:
    """Return one lower-case name per encoding; for example, ``mono16`` becomes ``16uc1``."""
    name = encoding.strip().lower()
    return _ALIASES.get(name, name)


def is_depth_encoding(encoding: str) -> bool:
    """Return whether raw images with this encoding can be depth."""
    return canonical_encoding(encoding) in _DEPTH_TYPES


def is_color_encoding(encoding: str) -> bool:
    """Return whether raw images with this encoding can become RGB; mono16 may also be depth."""
    name = encoding.strip().lower()
    return name == "mono16" or canonical_encoding(name) in _TO_RGB


def check_size(width: int, height: int, max_pixels: int) -> None:
    """Check the size of an image before memory is allocated.

    Raises:
        FrameError: The image has no pixels or too many.
    """
    if width <= 0 or height <= 0:
        raise bad_frame(f"the image has {width}x{height} pixels, expected at least 1x1")
    if width * height > max_pixels:
        size = f"{width}x{height} pixels, more than the maximum of {max_pixels}"
        raise bad_frame(f"the image has {size} (--log.max-pixels)")


def check_pixels(image: ImageMessage) -> None:
    """Check that an image has enough bytes for its declared size.

    Raises:
        FrameError: The image has too few bytes.
    """
    _check_data(image, 1, image.step or image.width)


def _check_data(image: ImageMessage, pixel_bytes: int, step: int) -> None:
    needed = (image.height - 1) * step + image.width * pixel_bytes
    if step < image.width * pixel_bytes or len(image.data) < needed:
        given = f"{image.width}x{image.height} {image.encoding!a}, step {image.step}"
        raise bad_frame(f"{len(image.data)} bytes are too few for {given}")


def check_row(what: str, width: int, height: int, row: np.ndarray) -> None:
    """Check that an image has the calibrated size, i.e. that of ``row``.

    Raises:
        FrameError: The sizes differ.
    """
    if (height, width) != row.shape[:2]:
        sizes = f"{width}x{height}, but the calibration is for {row.shape[1]}x{row.shape[0]}"
        raise FrameError(f"{what} image is {sizes}", status=FrameStatus.BAD_CALIBRATION)


def decode_color(image: ImageMessage, row: np.ndarray, max_pixels: int) -> None:
    """Decode a raw colour or grey image to RGB.

    Supported encodings are ``rgb bgr rgba bgra mono`` and the four Bayer patterns, with 8 or 16
    bits, of which the upper 8 are used; OpenCV converts ``yuyv uyvy nv12 nv21`` (BT.601). Grey is
    repeated in the three channels. Synonyms are the keys of ``_ALIASES``; as in Foxglove, 8UC1 is
    mono8 and 8UC3 is bgr8.

    Args:
        image: Message.
        row: Output ``(H, W, 3)`` uint8, contiguous.
        max_pixels: Maximum number of pixels.

    Raises:
        FrameError: The encoding or size is wrong, or the data don't fit the size.
    """
    name = canonical_encoding(image.encoding)
    name = "mono16" if name == "16uc1" else name
    if name not in _TO_RGB:
        raise bad_frame(f"colour encoding {image.encoding!a} is not supported")
    how = _TO_RGB[name]
    if image.width % how.even[0] or image.height % how.even[1]:
        size = f"{image.width}x{image.height}, expected multiples of {how.even[0]}x{how.even[1]}"
        raise bad_frame(f"the size of the {name} image is {size}")
    check_size(image.width, image.height, max_pixels)
    check_row("colour", image.width, image.height, row)
    if how.half_plane:
        max_pixels, image = 2 * max_pixels, image._replace(height=image.height * 3 // 2)
    kind = np.dtype((">" if image.big_endian else "<") + f"u{how.bits // 8}")
    pixels = _pixels(image, kind, how.channels, max_pixels)
    if how.bits == 16:
        pixels = (pixels >> 8).astype(np.uint8)
    if how.code is None:
        row[...] = pixels
    else:
        cv2.cvtColor(np.ascontiguousarray(pixels) if how.half_plane else pixels, how.code, dst=row)


def decode_depth(image: ImageMessage, row: np.ndarray, unit_m: float, max_pixels: int) -> None:
    """Decode 16UC1, mono16 or 32FC1 to depth units.

    16-bit images are copied unchanged; 32FC1 is in metres, see :func:`metres_to_units`.

    Args:
        image: Message.
        row: Output ``(H, W)`` uint16, contiguous.
        unit_m: Metres per depth unit.
        max_pixels: Maximum number of pixels.

    Raises:
        FrameError: The encoding or size is wrong, or the data don't fit the size.
    """
    pixels = depth_pixels(image, max_pixels)
    check_row("depth", image.width, image.height, row)
    if pixels.dtype.kind == "f":
        metres_to_units(pixels, unit_m, row)
    else:
        row[...] = pixels


def metres_to_units(depth_m: np.ndarray, unit_m: float, row: np.ndarray) -> None:
    """Convert depth in metres to depth units, rounded to nearest.

    NaN, infinity, values of 0 or less, and values above 65535 units become 0.

    Args:
        depth_m: Depth ``(H, W)`` float32 [m].
        unit_m: Metres per depth unit.
        row: Output ``(H, W)`` uint16, contiguous.
    """
    launch("depth_units", np.ascontiguousarray(depth_m, np.float32), unit_m, row)


def depth_pixels(image: ImageMessage, max_pixels: int) -> np.ndarray:
    """Return a view ``(H, W)`` of a 16UC1, mono16 or 32FC1 image, in its byte order.

    Raises:
        FrameError: The encoding is wrong, the image has no pixels or more than ``max_pixels``, or
            the data don't fit the size.
    """
    name = canonical_encoding(image.encoding)
    if name not in _DEPTH_TYPES:
        raise bad_frame(f"depth encoding {image.encoding!a} is not supported")
    dtype = np.dtype((">" if image.big_endian else "<") + _DEPTH_TYPES[name])
    return _pixels(image, dtype, 1, max_pixels)[..., 0]


def _pixels(image: ImageMessage, dtype: np.dtype, channels: int, max_pixels: int) -> np.ndarray:
    """Return a view of the pixels ``(H, W, channels)``, without the padding of rows."""
    check_size(image.width, image.height, max_pixels)
    size = dtype.itemsize * channels
    step = image.step or image.width * size
    _check_data(image, size, step)
    shape = image.height, image.width, channels
    return np.ndarray(shape, dtype, image.data, strides=(step, size, dtype.itemsize))
