"""Drawing primitives with sub-pixel positions, and the colours of all pictures (RGB)."""

import math
import os
import struct
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import deflate
import numpy as np

from jaxdet.io.png import MAGIC

Color = tuple[int, int, int]

BACKGROUND: Color = (18, 22, 28)
PANEL: Color = (26, 31, 39)
GRID: Color = (52, 60, 72)
TEXT: Color = (226, 231, 238)
FAINT: Color = (138, 148, 162)
DROPPED: Color = (128, 132, 138)
LOOSE: Color = (240, 240, 240)
FREE: Color = (178, 196, 186)
DROP: Color = (255, 60, 220)

PALETTE: tuple[Color, ...] = (
    (255, 92, 92),
    (64, 180, 255),
    (255, 200, 40),
    (80, 214, 120),
    (196, 130, 255),
    (255, 142, 60),
    (40, 204, 184),
    (255, 118, 190),
    (172, 216, 40),
    (128, 150, 255),
)
"""Colours of the obstacles, by label."""

SHIFT = 4
"""Fractional bits of :func:`fixed`."""


def color_of(label: int) -> Color:
    """Return the colour of an obstacle in all pictures."""
    return PALETTE[label % len(PALETTE)]


def canvas(height: int, width: int, color: Color = BACKGROUND) -> np.ndarray:
    """Return an empty picture ``(height, width, 3)`` uint8 RGB."""
    image = np.empty((height, width, 3), np.uint8)
    image[:1] = color
    image[1:] = image[:1]  # copying rows is 25 times as fast as setting pixels
    return image


def fixed(points: np.ndarray) -> np.ndarray:
    """Convert pixel coordinates to the fixed-point integers of OpenCV's drawing functions."""
    clipped = np.clip(np.asarray(points, np.float64), -30000, 30000)
    return np.rint(clipped * (1 << SHIFT)).astype(np.int32)


def line(image: np.ndarray, points: np.ndarray, color: Color, width: int = 1) -> None:
    """Draw an open line through ``points`` ``(P, 2)`` [pixel]."""
    cv2.polylines(image, [fixed(points)], False, color, width, cv2.LINE_AA, SHIFT)


def polygon(
    image: np.ndarray, points: np.ndarray, color: Color, fill: float = 0.0, width: int = 2
) -> None:
    """Draw a convex outline through points ``(P, 2)`` [pixel], its area with opacity ``fill``."""
    if fill > 0:
        part, first = _part(image, points, 1)
        layer = part.copy()
        if layer.size:
            cv2.fillConvexPoly(layer, fixed(points - first), color, cv2.LINE_AA, SHIFT)
            cv2.addWeighted(layer, fill, part, 1 - fill, 0, dst=part)
    if width:
        cv2.polylines(image, [fixed(points)], True, color, width, cv2.LINE_AA, SHIFT)


def dots(
    image: np.ndarray, points: np.ndarray, color: Color, radius: float, rim: float = 1.0
) -> None:
    """Draw filled discs with a dark rim around the pixels nearest to ``points`` ``(P, 2)``.

    Discs are drawn over the rims of all others.
    """
    reach = math.ceil(radius + rim) + 1
    part, first = _part(image, points, reach)
    spots = np.rint(np.clip(points, -30000, 30000)).astype(int) - first + reach
    height, width = part.shape[0] + 2 * reach, part.shape[1] + 2 * reach
    x, y = spots[((spots >= 0) & (spots < (width, height))).all(axis=1)].T
    centers = np.zeros((height, width), np.float32)
    centers[y, x] = 1
    for size, shade in ((radius + rim, (0, 0, 0)), (radius, color)):
        cover = cv2.filter2D(centers, -1, _disc(size))[reach:-reach, reach:-reach]
        blend(part, shade, np.minimum(cover, 1))


def blend(image: np.ndarray, color: Color, opacity: np.ndarray) -> None:
    """Blend a colour over an image with an opacity per pixel, ``(H, W)`` float32."""
    if image.size:
        below = image.astype(np.float32)
        shade = np.array([*color, 0], np.float64)  # OpenCV's scalars have four channels
        step = cv2.multiply(cv2.subtract(shade, below), cv2.merge((opacity,) * 3))
        image[:] = cv2.convertScaleAbs(cv2.add(below, step))


def _part(image: np.ndarray, points: np.ndarray, reach: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the view of an image around points ``(P, 2)``, and its first column and row."""
    size = np.array(image.shape[1::-1])
    if not len(points):
        return image[:0, :0], np.zeros(2, int)
    first = np.clip(np.floor(points.min(axis=0)) - reach, 0, size).astype(int)
    last = np.clip(np.ceil(points.max(axis=0)) + reach + 1, 0, size).astype(int)
    return image[first[1] : last[1], first[0] : last[0]], first


@cache
def _disc(radius: float) -> np.ndarray:
    """Return the fraction of each pixel covered by a disc around the central pixel, float32."""
    reach = math.ceil(radius)
    away = np.hypot(*np.mgrid[-reach : reach + 1, -reach : reach + 1])
    return np.clip(radius + 0.5 - away, 0, 1).astype(np.float32)


@cache
def _font() -> Any:
    return cv2.FontFace("sans")


_HAS_FONTS = hasattr(cv2, "FontFace")
"""Whether OpenCV has fonts (OpenCV 5). OpenCV 4 has ASCII stroke fonts only."""
_STROKES, _STROKE_HEIGHT = cv2.FONT_HERSHEY_SIMPLEX, 21
"""Stroke font of OpenCV 4, and the height of its capitals at scale 1 [pixel]."""


def text_size(text: str, size: int, bold: bool = False) -> tuple[int, int]:
    """Return the width of ``text`` and the height of its capitals [pixel]."""
    height = round(size * 0.72)
    if not _HAS_FONTS:
        scale, thick = height / _STROKE_HEIGHT, 1 + bold
        return cv2.getTextSize(_ascii(text), _STROKES, scale, thick)[0][0], height
    weight = 700 if bold else 400
    box = cv2.getTextSize((0, 0), text, (0, 0), _font(), size, weight)
    return int(box[2]), height


def _ascii(text: str) -> str:
    return text.replace("°", " deg").encode("ascii", "replace").decode()


def write(
    image: np.ndarray,
    text: str,
    at: tuple[float, float],
    color: Color = TEXT,
    size: int = 15,
    *,
    bold: bool = False,
    align: str = "left",
) -> None:
    """Write text; its baseline starts, ends (``right``) or is centred (``center``) at ``at``."""
    width, height = text_size(text, size, bold)
    x = at[0] - {"left": 0.0, "center": width / 2, "right": width}[align]
    place = round(x), round(at[1])
    if not _HAS_FONTS:
        scale = height / _STROKE_HEIGHT
        cv2.putText(image, _ascii(text), place, _STROKES, scale, color, 1 + bold, cv2.LINE_AA)
        return
    cv2.putText(image, text, place, color, _font(), size, 700 if bold else 400)


_DEFLATE_LEVEL = 1
"""Fastest level of libdeflate: half the time of OpenCV, and files that are a seventh larger."""
_UP = 2
"""PNG filter type: each byte is stored as the difference from the byte above it."""


def write_png(path: Path, image: np.ndarray) -> None:
    """Write a picture ``(h, w, 3)`` uint8, RGB, as a PNG file."""
    Path(os.fspath(path)).write_bytes(_png_bytes(np.ascontiguousarray(image)))


def _png_bytes(image: np.ndarray) -> bytes:
    """Return a PNG file of a contiguous RGB picture.

    OpenCV takes more than twice as long: its zlib is slower than libdeflate.
    """
    height, width, channels = image.shape
    rows = image.reshape(height, width * channels)
    filtered = np.empty((height, 1 + width * channels), np.uint8)
    filtered[:, 0] = _UP
    filtered[0, 1:] = rows[0]
    np.subtract(rows[1:], rows[:-1], out=filtered[1:, 1:])
    # Eight bits per channel, RGB; the only methods of compression and filtering; not interlaced.
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    parts = {
        b"IHDR": header,
        b"IDAT": deflate.zlib_compress(filtered, _DEFLATE_LEVEL),
        b"IEND": b"",
    }
    return MAGIC + b"".join(_png_chunk(kind, bytes(data)) for kind, data in parts.items())


def _png_chunk(kind: bytes, data: bytes) -> bytes:
    """Return a chunk of a PNG file: length, type, data and CRC."""
    return (
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", deflate.crc32(kind + data))
    )
