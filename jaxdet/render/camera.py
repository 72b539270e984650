"""The camera's view: features, clustered points, boxes and distances over the colour image."""

from typing import NamedTuple

import cv2
import numpy as np

import jaxdet.render.canvas as canvas
from jaxdet.results.metric import distances
from jaxdet.types import Detections

Box = tuple[float, float, float, float]

_CHIP_TEXT = 16
_CHIP_HEIGHT = 24


class Chip(NamedTuple):
    """The label of a box."""

    box: Box
    """Left, top, right, bottom [pixel]."""
    text: str
    label: int


def camera_view(
    color: np.ndarray, found: Detections, row: int, depth_unit: float, scale: float
) -> np.ndarray:
    """The colour image of one frame with what was found in it.

    Args:
        color: ``(H, W, 3)`` uint8, RGB.
        found: The batch's detections, as NumPy arrays.
        row: The frame's row in them.
        depth_unit: Metres in one depth unit.
        scale: Enlargement.

    Returns:
        ``(H * scale, W * scale, 3)`` uint8, RGB.
    """
    size = (round(color.shape[1] * scale), round(color.shape[0] * scale))
    method = cv2.INTER_CUBIC if scale > 1 else cv2.INTER_AREA
    image = cv2.resize(color, size, interpolation=method)
    image = cv2.addWeighted(image, 0.82, np.zeros_like(image), 0, 0)
    _draw_points(image, found, row, scale)
    boxes = _boxes(found, row, scale)
    for label in reversed(range(len(boxes))):
        left, top, right, bottom = boxes[label]
        corners = np.array([[left, top], [right, top], [right, bottom], [left, bottom]])
        canvas.polygon(image, corners, (0, 0, 0), width=4)
        canvas.polygon(image, corners, canvas.color_of(label))
    nearest = distances(found)[row] * depth_unit
    texts = [f"{label}   {nearest[label]:.2f} m" for label in range(len(boxes))]
    for chip in _chips(boxes, texts, image.shape[1], image.shape[0]):
        _draw_chip(image, chip)
    return image


def _draw_points(image: np.ndarray, found: Detections, row: int, scale: float) -> None:
    features = found.features
    uv = (np.stack([features.u[row], features.v[row]], axis=1) + 0.5) * scale - 0.5
    valid, kept = features.valid[row], features.kept[row]
    labels = np.where(valid, found.labels.labels[row], -1)
    # Small enough that one sees the thing that they lie on.
    canvas.dots(image, uv[valid & ~kept], canvas.DROPPED, 1.6)
    canvas.dots(image, uv[valid & kept & (labels < 0)], canvas.LOOSE, 2.0)
    for label in reversed(range(int(found.labels.num_obstacles[row]))):
        canvas.dots(image, uv[labels == label], canvas.color_of(label), 2.0, rim=0.5)


def _boxes(found: Detections, row: int, scale: float) -> list[Box]:
    count = int(found.labels.num_obstacles[row])
    low = found.obstacles.uv_min[row, :count] * scale - 4
    high = (found.obstacles.uv_max[row, :count] + 1) * scale + 3
    return [tuple(box) for box in np.concatenate([low, high], axis=1).tolist()]


def _chips(boxes: list[Box], texts: list[str], width: int, height: int) -> list[Chip]:
    """Labels above their boxes, moved down where they would hide one another."""
    placed: list[Chip] = []
    for label, (box, text) in enumerate(zip(boxes, texts, strict=True)):
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
