"""Picture of the map of a log: outline counts, free floor, camera path, scale bar."""

import math
from collections.abc import Sequence

import cv2
import numpy as np

import jaxdet.render.canvas as canvas
from jaxdet.results.occupancy import MapImage

LONG_SIDE = 1000
HEADER, FOOTER, MARGIN = 46, 46, 24
PATH: canvas.Color = (64, 180, 255)
START: canvas.Color = (80, 214, 120)
END: canvas.Color = (255, 92, 92)
STANDS: canvas.Color = (240, 240, 240)


def draw_map(
    image: MapImage, title: str, tracks: Sequence[tuple[np.ndarray, bool]] | None = None
) -> np.ndarray:
    """Draw a map, X to the right and Y up.

    Args:
        image: Map.
        title: Title of the picture.
        tracks: World paths ``(P, 2)`` of tracks [m], and whether they move; None: no tracks. Moving
            tracks are lines that end in a dot, stationary ones small squares, on a darker map.

    Returns:
        Picture ``(h, w, 3)`` uint8, RGB.
    """
    low, high = _bounds(image)
    scale = min(LONG_SIDE / max(float((high - low).max()), 1e-6), 400.0)
    width, height = (max(round(float(v)), 240) for v in (high - low) * scale)
    panel = canvas.canvas(height, width, canvas.PANEL)

    def pixels(points: np.ndarray) -> np.ndarray:
        return np.stack(
            [(points[..., 0] - low[0]) * scale, height - (points[..., 1] - low[1]) * scale], axis=-1
        )

    _paint_counts(panel, image, low, scale)
    if tracks is not None:
        panel = cv2.addWeighted(panel, 0.45, np.full_like(panel, canvas.PANEL), 0.55, 0)
    step = _round_length(90 / scale)
    _draw_grid(panel, low, scale, step)
    if len(image.path):
        path = pixels(image.path)
        canvas.line(panel, path, (8, 10, 14), 5)
        canvas.line(panel, path, PATH, 2)
        canvas.dots(panel, path[:1], START, 6.0)
        canvas.dots(panel, path[-1:], END, 6.0)
    for number, (way, moves) in enumerate(tracks or ()):
        _draw_track(panel, pixels(way), canvas.color_of(number), moves)
    return _framed(panel, image, title, scale, step, tracks)


def _draw_track(panel: np.ndarray, way: np.ndarray, color: canvas.Color, moves: bool) -> None:
    if moves:
        canvas.line(panel, way, (8, 10, 14), 5)
        canvas.line(panel, way, color, 2)
        canvas.dots(panel, way[-1:], color, 5.0)
    else:
        square = way[:1] + np.array([[-4, -4], [4, -4], [4, 4], [-4, 4]])
        canvas.polygon(panel, square, STANDS, width=1)


def _bounds(image: MapImage) -> tuple[np.ndarray, np.ndarray]:
    """Return the world corners of the picture, around all cells and the path with a margin."""
    low = np.array(image.origin)
    high = low + np.array(image.counts.shape[::-1]) * image.cell_m
    if len(image.path):
        low = np.minimum(low, image.path.min(axis=0))
        high = np.maximum(high, image.path.max(axis=0))
    margin = 0.04 * float((high - low).max()) + 0.2
    return low - margin, high + margin


def _paint_counts(panel: np.ndarray, image: MapImage, low: np.ndarray, scale: float) -> None:
    """Colour each pixel by the cell under its centre."""
    height, width = panel.shape[:2]
    x = low[0] + (np.arange(width) + 0.5) / scale
    y = low[1] + (height - np.arange(height) - 0.5) / scale
    column = np.floor((x - image.origin[0]) / image.cell_m).astype(np.int64)
    row = np.floor((y - image.origin[1]) / image.cell_m).astype(np.int64)
    rows, columns = image.counts.shape
    v = np.flatnonzero((row >= 0) & (row < rows))
    u = np.flatnonzero((column >= 0) & (column < columns))
    if not (v.size and u.size):
        return
    counts, free = (cells[row[v]][:, column[u]] for cells in (image.counts, image.free))
    most = max(int(image.counts.max()), 1)
    colors = np.concatenate([_heat(most), [canvas.FREE]]).astype(np.uint8)
    colors[0] = canvas.PANEL
    code = np.where((counts == 0) & (free > 0), most + 1, counts)
    panel[v[0] : v[-1] + 1, u[0] : u[-1] + 1] = colors[code]


def _heat(most: int) -> np.ndarray:
    """Return colours by count, ``(most + 1, 3)``, logarithmic from dark purple to yellow."""
    counts = np.arange(most + 1)
    share = np.log1p(np.maximum(counts - 1, 0)) / max(np.log1p(most - 1), 1e-9)
    level = (70 + 170 * np.clip(share, 0, 1)).astype(np.uint8)
    return cv2.applyColorMap(level[:, None], cv2.COLORMAP_INFERNO)[:, 0, ::-1]


def _draw_grid(panel: np.ndarray, low: np.ndarray, scale: float, step: float) -> None:
    height, width = panel.shape[:2]
    layer = panel.copy()
    for i in range(int(np.ceil(low[0] / step)), int((low[0] + width / scale) / step) + 1):
        x = (i * step - low[0]) * scale
        canvas.line(layer, np.array([[x, 0], [x, height]]), canvas.FAINT)
    for i in range(int(np.ceil(low[1] / step)), int((low[1] + height / scale) / step) + 1):
        y = height - (i * step - low[1]) * scale
        canvas.line(layer, np.array([[0, y], [width, y]]), canvas.FAINT)
    cv2.addWeighted(layer, 0.25, panel, 0.75, 0, dst=panel)


def _round_length(metres: float) -> float:
    """Round up to 0.1, 0.2, 0.5, 1, 2, 5, ..."""
    tens = 10.0 ** max(math.floor(math.log10(metres)), -1)
    return next(base * tens for base in (1, 2, 5, 10, 20) if base * tens >= metres)


def _framed(
    panel: np.ndarray,
    image: MapImage,
    title: str,
    scale: float,
    step: float,
    tracks: Sequence[tuple[np.ndarray, bool]] | None,
) -> np.ndarray:
    height, width = panel.shape[:2]
    total = max(width, 640) + 2 * MARGIN
    framed = canvas.canvas(height + HEADER + FOOTER, total)
    left = (total - width) // 2
    framed[HEADER : HEADER + height, left : left + width] = panel
    what = "map" if tracks is None else "tracks"
    canvas.write(framed, f"{title}   {what}", (MARGIN, 30), size=19, bold=True)
    length = float(np.sum(np.linalg.norm(np.diff(image.path, axis=0), axis=1)))
    about = f"path {length:.1f} m, cells of {image.cell_m:g} m, X right, Y up"
    if tracks is not None:
        moving = sum(moves for _, moves in tracks)
        stationary = len(tracks) - moving
        about = f"{moving} moving (lines, dot at the end), {stationary} stationary (squares)"
    canvas.write(framed, about, (total - MARGIN, 30), canvas.FAINT, align="right")
    y = height + HEADER + 28
    bar = np.array([[0, -6], [0, 0], [step * scale, 0], [step * scale, -6]]) + (MARGIN, y)
    canvas.line(framed, bar, canvas.TEXT, 2)
    canvas.write(framed, f"{step:g} m", (MARGIN + step * scale + 8, y + 2))
    _draw_legend(framed, image, total - MARGIN, y)
    return framed


def _draw_legend(framed: np.ndarray, image: MapImage, right: int, y: int) -> None:
    most = max(int(image.counts.max()), 1)
    canvas.write(framed, f"{most} outlines per cell", (right, y + 2), canvas.FAINT, align="right")
    right -= canvas.text_size(f"{most} outlines per cell", 15)[0] + 8
    ramp = np.rint(np.expm1(np.linspace(0, np.log1p(most - 1), 110)) + 1).astype(np.int64)
    framed[y - 10 : y + 2, right - 110 : right] = _heat(most)[ramp]
    canvas.write(framed, "1", (right - 116, y + 2), canvas.FAINT, align="right")
    x = right - 150.0
    entries = [
        (END, "end"),
        (START, "start"),
        *([(canvas.FREE, "seen free")] * bool(image.free.any())),
    ]
    for color, text in entries:
        x -= canvas.text_size(text, 15)[0]
        canvas.write(framed, text, (x, y + 2), canvas.FAINT)
        canvas.dots(framed, np.array([[x - 10, y - 4]]), color, 4.0)
        x -= 34
