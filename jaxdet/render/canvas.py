"""Drawing primitives with sub-pixel positions, and the colours of all pictures (RGB)."""

import os
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np

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

_SHIFT = 4


def color_of(label: int) -> Color:
    """Return the colour of an obstacle in all pictures."""
    return PALETTE[label % len(PALETTE)]


def canvas(height: int, width: int, color: Color = BACKGROUND) -> np.ndarray:
    """Return an empty picture ``(height, width, 3)`` uint8 RGB."""
    return np.full((height, width, 3), color, np.uint8)


def fixed(points: np.ndarray) -> np.ndarray:
    """Convert pixels to the fixed-point integers of OpenCV's drawing functions."""
    clipped = np.clip(np.asarray(points, np.float64), -30000, 30000)
    return np.rint(clipped * (1 << _SHIFT)).astype(np.int32)


def line(image: np.ndarray, points: np.ndarray, color: Color, width: int = 1) -> None:
    """Draw an open line through ``points`` ``(P, 2)`` [pixel]."""
    cv2.polylines(image, [fixed(points)], False, color, width, cv2.LINE_AA, _SHIFT)


def polygon(
    image: np.ndarray, points: np.ndarray, color: Color, fill: float = 0.0, width: int = 2
) -> None:
    """Draw a convex outline through ``points`` ``(P, 2)`` [pixel], filled with this opacity."""
    if fill > 0:
        layer = image.copy() if fill < 1 else image
        cv2.fillConvexPoly(layer, fixed(points), color, cv2.LINE_AA, _SHIFT)
        if fill < 1:
            cv2.addWeighted(layer, fill, image, 1 - fill, 0, dst=image)
    if width:
        cv2.polylines(image, [fixed(points)], True, color, width, cv2.LINE_AA, _SHIFT)


def dots(
    image: np.ndarray, points: np.ndarray, color: Color, radius: float, rim: float = 1.0
) -> None:
    """Draw filled discs with a dark rim at ``points`` ``(P, 2)`` [pixel]."""
    r, edge = (round(size * (1 << _SHIFT)) for size in (radius, rim))
    for center in fixed(points).tolist():
        cv2.circle(image, center, r + edge, (0, 0, 0), -1, cv2.LINE_AA, _SHIFT)
    for center in fixed(points).tolist():
        cv2.circle(image, center, r, color, -1, cv2.LINE_AA, _SHIFT)


@cache
def _font() -> Any:
    return cv2.FontFace("sans")


_HAS_FONTS = hasattr(cv2, "FontFace")
"""Whether OpenCV has fonts: OpenCV 5. OpenCV 4, of another package, has ASCII stroke fonts."""
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
    """Write text whose baseline starts, ends (``right``) or is centred (``center``) at ``at``."""
    width, height = text_size(text, size, bold)
    x = at[0] - {"left": 0.0, "center": width / 2, "right": width}[align]
    place = round(x), round(at[1])
    if not _HAS_FONTS:
        scale = height / _STROKE_HEIGHT
        cv2.putText(image, _ascii(text), place, _STROKES, scale, color, 1 + bold, cv2.LINE_AA)
        return
    cv2.putText(image, text, place, color, _font(), size, 700 if bold else 400)


_PNG = (
    *(cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE),
    *(cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_PAETH),
)
"""PNG settings for camera images: smaller files than zlib level 6, six times as fast."""


def write_png(path: Path, image: np.ndarray) -> None:
    """Write an RGB picture."""
    encoded = cv2.imencode(".png", image[..., ::-1], _PNG)[1]
    Path(os.fspath(path)).write_bytes(encoded.tobytes())
