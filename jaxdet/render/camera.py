"""Camera view: obstacles, boxes and distances on the colour or depth image."""

import math
from typing import NamedTuple

import cv2
import numpy as np

import jaxdet.render.canvas as canvas
from jaxdet.camera import cell_side
from jaxdet.config import Config
from jaxdet.reference._cells import cell_boxes
from jaxdet.results.masks import label_image
from jaxdet.results.metric import distance_text, distances
from jaxdet.types import Calibration, CellLabels, Detections, Features, Frames, Labels

Box = tuple[float, float, float, float]

LOOSE_LABEL = 1 << 20
"""Label of cells above the floor without an obstacle."""

_CHIP_TEXT = 16
_CHIP_HEIGHT = 24
_TINT, _LOOSE_TINT = 0.42, 0.30
"""Opacity of the colours of cells of obstacles, and of other cells."""
_BAR = 10, 180
"""Width and height of the depth scale [pixel]."""


class Shown(NamedTuple):
    """Background image of a frame's picture."""

    image: np.ndarray
    """Image ``(H, W, 3)`` uint8, RGB."""
    calibration: Calibration
    """Calibration whose :attr:`Calibration.image` is the camera of the image."""
    depth_range_m: tuple[float, float] | None
    """Range of the colour map of a depth image [m]; None for a colour image."""
    on_floor: bool
    """Whether distances are on the floor; False if they are depths, as the floor is unknown."""


class Chip(NamedTuple):
    """Text label of a bounding box and its position."""

    box: Box
    """Left, top, right, bottom [pixel]."""
    text: str
    label: int


def shown_image(frames: Frames, row: int, config: Config) -> Shown:
    """Return the background image of a frame.

    This is the colour image if a calibrated one exists, else the depth image in false colours, with
    near pixels warm and unmeasured ones black.

    Args:
        frames: Batch.
        row: Row of the frame.
        config: Configuration with the depth range of the colour map.
    """
    calibration, plane = frames.calibration, frames.plane
    on_floor = plane is None or bool(plane.valid[row])
    if has_color(frames, row):
        assert frames.color is not None
        return Shown(frames.color[row], calibration, None, on_floor)
    in_depth = calibration._replace(color=None, color_from_depth=None)
    reach = config.ground.min_depth_m, config.ground.max_depth_m
    image = depth_picture(frames.depth[row], calibration.depth_unit, *reach)
    return Shown(image, in_depth, reach, on_floor)


def has_color(frames: Frames, row: int) -> bool:
    """Return whether a frame has a colour image of the calibrated size."""
    color, camera = frames.color, frames.calibration.image
    if color is None or color.shape[1:3] != (camera.height, camera.width):
        return False
    return frames.color_stamp_ns is None or bool(frames.color_stamp_ns[row] >= 0)


def depth_picture(depth: np.ndarray, unit: float, near_m: float, far_m: float) -> np.ndarray:
    """Return a depth image ``(H, W)`` in false colours, ``(H, W, 3)`` uint8 RGB."""
    measured = depth > 0
    share = (depth * unit - near_m) / max(far_m - near_m, 1e-6)
    level = np.rint(255 * (0.94 - 0.86 * np.clip(share, 0, 1))).astype(np.uint8)
    picture = cv2.applyColorMap(level, cv2.COLORMAP_TURBO)[..., ::-1]
    return np.where(measured[..., None], picture, 0).astype(np.uint8)


def camera_view(
    shown: Shown, found: Detections, row: int, config: Config, scale: float
) -> np.ndarray:
    """Draw the detections of a frame on its image.

    Args:
        shown: Background image.
        found: Detections of the batch, as NumPy arrays.
        row: Row of the frame.
        config: Configuration with the size of cells.
        scale: Scale factor.

    Returns:
        Picture ``(H * scale, W * scale, 3)`` uint8, RGB.
    """
    height, width = shown.image.shape[:2]
    size = (round(width * scale), round(height * scale))
    method = cv2.INTER_CUBIC if scale > 1 else cv2.INTER_AREA
    image = cv2.resize(shown.image, size, interpolation=method)
    if shown.depth_range_m is None:
        image = cv2.addWeighted(image, 0.82, np.zeros_like(image), 0, 0)
    else:  # less saturated than obstacle colours
        grey = np.repeat(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)[..., None], 3, axis=2)
        image = cv2.addWeighted(image, 0.42, grey, 0.28, 0)
    if found.points is not None:
        _draw_points(image, *found.points, row, scale)
    side = cell_side(shown.calibration.depth, config.surface.cell_rad)
    if found.cells is not None:
        _draw_cells(image, found.cells, row, shown.calibration, side, scale)
    boxes = _boxes(found, row, shown, side, scale)
    for label, box in reversed(boxes.items()):
        left, top, right, bottom = box
        corners = np.array([[left, top], [right, top], [right, bottom], [left, bottom]])
        canvas.polygon(image, corners, (0, 0, 0), width=4)
        canvas.polygon(image, corners, canvas.color_of(label))
    if shown.depth_range_m is not None:
        _draw_scale(image, *shown.depth_range_m)
    unit = shown.calibration.depth_unit
    nearest, depths = distances(found)[row] * unit, found.obstacles.xyz_min[row, :, 2] * unit
    away = [float(distance) if shown.on_floor else None for distance in nearest]
    texts = {label: f"{label}   {distance_text(away[label], depths[label])}" for label in boxes}
    for chip in _chips(boxes, texts, image.shape[1], image.shape[0]):
        _draw_chip(image, chip)
    return image


def _draw_points(
    image: np.ndarray, features: Features, labels: Labels, row: int, scale: float
) -> None:
    uv = (np.stack([features.u[row], features.v[row]], axis=1) + 0.5) * scale - 0.5
    valid, kept = features.valid[row], features.kept[row]
    label = np.where(valid, labels.labels[row], -1)
    # small, so that the object remains visible
    canvas.dots(image, uv[valid & ~kept], canvas.DROPPED, 1.6)
    canvas.dots(image, uv[valid & kept & (label < 0)], canvas.LOOSE, 2.0)
    for number in reversed(range(int(labels.num_obstacles[row]))):
        canvas.dots(image, uv[label == number], canvas.color_of(number), 2.0, rim=0.5)


def _draw_cells(
    image: np.ndarray,
    found: CellLabels,
    row: int,
    calibration: Calibration,
    side: int,
    scale: float,
) -> None:
    """Tint the cells of each obstacle in its colour, and cells without an obstacle white."""
    label, z = found.label[row], found.cells.z[row]
    label = np.where(found.keep[row] & (label < 0), LOOSE_LABEL, label)
    marked = found.cells._replace(z=np.where(label < 0, 0, z)[None])
    labels = label_image(found._replace(cells=marked, label=label[None]), 0, calibration, side)
    size = image.shape[1], image.shape[0]
    # hides the steps between cells
    blur = max(0.5, 0.45 * side * scale * calibration.image.fx / calibration.depth.fx)
    labels = cv2.resize(labels, size, interpolation=cv2.INTER_NEAREST)
    for number in np.unique(label[label >= 0]).tolist()[::-1]:
        _tint(image, labels == number, number, blur)


def _tint(image: np.ndarray, mask: np.ndarray, number: int, blur: float) -> None:
    """Tint the pixels of a mask ``(H, W)`` bool with a blurred edge, and outline obstacles."""
    x, y, width, height = cv2.boundingRect(mask.astype(np.uint8))
    reach = math.ceil(4 * blur)
    left, top = max(0, x - reach), max(0, y - reach)
    part = np.s_[top : y + height + reach, left : x + width + reach]
    soft = mask[part].astype(np.float32)
    soft = cv2.GaussianBlur(soft, (0, 0), blur, borderType=cv2.BORDER_REPLICATE)
    shape = np.clip(2.5 * (soft - 0.5) + 0.5, 0, 1)
    if number == LOOSE_LABEL:
        canvas.blend(image[part], canvas.LOOSE, _LOOSE_TINT * shape)
        return
    canvas.blend(image[part], color := canvas.color_of(number), _TINT * shape)
    outline = (soft >= 0.5).astype(np.uint8)
    lines, _ = cv2.findContours(outline, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(image, lines, -1, color, 1, cv2.LINE_AA, offset=(left, top))


def _boxes(found: Detections, row: int, shown: Shown, side: int, scale: float) -> dict[int, Box]:
    """Return the boxes of the obstacles inside the picture, by label."""
    count = int(found.num_obstacles[row])
    low, high = found.obstacles.uv_min[row, :count], found.obstacles.uv_max[row, :count]
    if shown.depth_range_m is not None and found.cells is not None:
        low, high = _depth_boxes(found.cells, row, shown.calibration, side, count)
    inside = np.flatnonzero((high >= low).all(axis=1))
    corners = np.concatenate([low * scale - 4, (high + 1) * scale + 3], axis=1)
    return {label: tuple(corners[label].tolist()) for label in inside.tolist()}


def _depth_boxes(
    found: CellLabels, row: int, calibration: Calibration, side: int, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return first and last column and row ``(M, 2)`` of each obstacle in the depth image."""
    first, last, _ = (
        part[0] for part in cell_boxes(found.cells.z[row : row + 1], calibration, side)
    )
    low, high = np.zeros((count, 2), np.int32), np.full((count, 2), -1, np.int32)
    for number in range(count):
        own = found.label[row] == number
        if own.any():
            low[number], high[number] = first[own].min(axis=0), last[own].max(axis=0)
    return low, high


def _draw_scale(image: np.ndarray, near_m: float, far_m: float) -> None:
    """Draw the scale of depth colours, near at the bottom and far at the top."""
    width, height = _BAR
    height = min(height, image.shape[0] // 2)
    left, bottom = image.shape[1] - width - 14, image.shape[0] - 24
    metres = np.linspace(far_m, near_m, height)
    bar = depth_picture(np.maximum(metres, 1e-3)[:, None], 1.0, near_m, far_m)
    frame = slice(bottom - height - 1, bottom + 1), slice(left - 1, left + width + 1)
    image[frame] = 0
    image[bottom - height : bottom, left : left + width] = bar
    for text, y in ((f"{far_m:g} m", bottom - height - 7), (f"{near_m:g} m", bottom + 15)):
        at = (image.shape[1] - 13, y)
        canvas.write(image, text, (at[0] + 1, at[1] + 1), (0, 0, 0), 13, align="right")
        canvas.write(image, text, at, canvas.TEXT, 13, align="right")


def _chips(boxes: dict[int, Box], texts: dict[int, str], width: int, height: int) -> list[Chip]:
    """Place labels above their boxes, or lower if they would overlap."""
    placed: list[Chip] = []
    for label, box in boxes.items():
        text = texts[label]
        wide = canvas.text_size(text, _CHIP_TEXT, bold=True)[0] + 16
        left = min(max(box[0] - 1, 0), width - wide)
        top = max(box[1] - _CHIP_HEIGHT, 0)
        spot = (left, top, left + wide, top + _CHIP_HEIGHT)
        while hit := next((c for c in placed if _overlap(c.box, spot)), None):
            top = hit.box[3] + 2
            if top + _CHIP_HEIGHT > height:
                break
            spot = (left, top, left + wide, top + _CHIP_HEIGHT)
        placed.append(Chip(spot, text, label))
    return placed


def _overlap(a: Box, b: Box) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def _draw_chip(image: np.ndarray, chip: Chip) -> None:
    left, top, right, bottom = (round(value) for value in chip.box)
    cv2.rectangle(image, (left, top), (right, bottom), canvas.color_of(chip.label), -1)
    at = (left + 8, bottom - 7)
    canvas.write(image, chip.text, at, (12, 14, 18), _CHIP_TEXT, bold=True)
