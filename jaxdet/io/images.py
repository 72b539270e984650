"""Raw images of ROS and Foxglove messages to RGB and to depth units."""

from collections.abc import Callable

import cv2
import numpy as np

from jaxdet.errors import FrameError, FrameStatus
from jaxdet.io.messages import ImageMessage

_ALIASES = {
    "8uc1": "mono8",
    "8uc3": "bgr8",
    "8uc4": "bgra8",
    "yuyv": "yuyv",
    "yuv422_yuy2": "yuyv",
    "yuyv422": "yuyv",
    "uyvy": "uyvy",
    "yuv422": "uyvy",
    "uyvy422": "uyvy",
    "mono16": "16uc1",
}
_TO_RGB: dict[str, tuple[int, Callable[[np.ndarray], np.ndarray]]] = {
    "rgb8": (3, lambda pixels: pixels),
    "bgr8": (3, lambda pixels: pixels[..., ::-1]),
    "rgba8": (4, lambda pixels: pixels[..., :3]),
    "bgra8": (4, lambda pixels: pixels[..., 2::-1]),
    "mono8": (1, lambda pixels: np.repeat(pixels, 3, axis=2)),
    "yuyv": (2, lambda pixels: cv2.cvtColor(pixels, cv2.COLOR_YUV2RGB_YUY2)),
    "uyvy": (2, lambda pixels: cv2.cvtColor(pixels, cv2.COLOR_YUV2RGB_UYVY)),
}
_DEPTH_TYPES = {"16uc1": "u2", "32fc1": "f4"}


def bad_frame(problem: str) -> FrameError:
    """The error of an image that can't be decoded."""
    return FrameError(problem, status=FrameStatus.DECODE_ERROR)


def canonical_encoding(encoding: str) -> str:
    """One lower-case name for each encoding, for instance ``mono16`` is ``16uc1``."""
    name = encoding.strip().lower()
    return _ALIASES.get(name, name)


def is_depth_encoding(encoding: str) -> bool:
    """Whether raw images of this encoding can be depth."""
    return canonical_encoding(encoding) in _DEPTH_TYPES


def is_color_encoding(encoding: str) -> bool:
    """Whether raw images of this encoding can be turned into RGB."""
    return canonical_encoding(encoding) in _TO_RGB


def check_size(width: int, height: int, max_pixels: int) -> None:
    """Refuses an image before memory is taken for it.

    Raises:
        FrameError: It has no pixels or too many.
    """
    if width <= 0 or height <= 0:
        raise bad_frame(f"image of {width}x{height} pixels")
    if width * height > max_pixels:
        raise bad_frame(f"image of {width}x{height} pixels is larger than --log.max-pixels")


def decode_color(image: ImageMessage, max_pixels: int) -> np.ndarray:
    """RGB ``(H, W, 3)`` uint8 of rgb8, bgr8, rgba8, bgra8, mono8, yuyv or uyvy.

    Grey is repeated in the three channels; 8UC1 is mono8 and 8UC3 is bgr8, as Foxglove has it;
    YUV 4:2:2 is converted by OpenCV (BT.601).

    Raises:
        FrameError: Another encoding, or data that don't fit the size.
    """
    name = canonical_encoding(image.encoding)
    if name not in _TO_RGB:
        raise bad_frame(f"colour encoding {image.encoding!a} is not supported")
    channels, convert = _TO_RGB[name]
    if channels == 2 and image.width % 2:
        raise bad_frame(f"{name} image of odd width {image.width}")
    rows = _rows(image, channels, max_pixels)
    pixels = rows.reshape(image.height, image.width, channels)
    return np.ascontiguousarray(convert(np.ascontiguousarray(pixels)))


def decode_depth(image: ImageMessage, unit_m: float, max_pixels: int) -> np.ndarray:
    """Depth ``(H, W)`` uint16 in units of ``unit_m`` of 16UC1, mono16 or 32FC1.

    16-bit images are taken as they are; 32FC1 is in metres, see :func:`metres_to_units`.

    Raises:
        FrameError: Another encoding, or data that don't fit the size.
    """
    name = canonical_encoding(image.encoding)
    if name not in _DEPTH_TYPES:
        raise bad_frame(f"depth encoding {image.encoding!a} is not supported")
    dtype = np.dtype((">" if image.big_endian else "<") + _DEPTH_TYPES[name])
    rows = np.ascontiguousarray(_rows(image, dtype.itemsize, max_pixels))
    pixels = rows.view(dtype)
    if name == "32fc1":
        return metres_to_units(pixels, unit_m)
    return pixels.astype(np.uint16)


def metres_to_units(depth_m: np.ndarray, unit_m: float) -> np.ndarray:
    """Depth in metres ``(H, W)`` float, rounded to the nearest unit, uint16.

    NaN, infinity, what is 0 or less, and what rounds to more than 65535 units become 0.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        units = np.rint(depth_m.astype(np.float64) / unit_m)
        return np.where((units > 0) & (units <= 0xFFFF), units, 0).astype(np.uint16)


def _rows(image: ImageMessage, pixel_bytes: int, max_pixels: int) -> np.ndarray:
    """The bytes of the pixels ``(H, W * pixel_bytes)`` uint8, without the rows' padding."""
    check_size(image.width, image.height, max_pixels)
    row = image.width * pixel_bytes
    step = image.step or row
    data = np.frombuffer(image.data, np.uint8)
    needed = (image.height - 1) * step + row
    if step < row or len(data) < needed:
        size = f"{image.width}x{image.height} {image.encoding!a}, step {image.step}"
        raise bad_frame(f"{len(data)} bytes are too few for {size}")
    if len(data) < image.height * step:
        data = np.concatenate([data, np.zeros(image.height * step - len(data), np.uint8)])
    return data[: image.height * step].reshape(image.height, step)[:, :row]
