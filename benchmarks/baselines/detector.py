"""A deep detector as an ONNX model, run by onnxruntime; the weights are the user's.

For the paper's rows: YOLOv7 (Wang, Bochkovskiy and Liao, CVPR 2023) and YOLOv5 with a
Swin Transformer backbone, exported to ONNX by their own tools. Two output layouts are read:

- ``(1, N, 5 + C)``: centre x, centre y, width, height, objectness, C class scores, in pixels of
  the model's input, before suppression (YOLOv5's and YOLOv7's plain export);
- ``(N, 7)``: picture, left, top, right, bottom, class, score, after it (YOLOv7's ``--end2end``).
"""

from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

from benchmarks.baselines.frames import Frame
from benchmarks.baselines.registry import Baseline

PAD_GREY = 114
"""What YOLO's letterbox is filled with."""


class Boxes(NamedTuple):
    """Boxes in pixels of the picture, best first."""

    corners: np.ndarray
    """``(n, 4)`` float64: left, top, right, bottom."""
    scores: np.ndarray
    """``(n,)`` float64."""
    classes: np.ndarray
    """``(n,)`` int64."""


class OnnxDetector:
    """Boxes from an ONNX model of the YOLO family.

    Args:
        model_path: The model; one input ``(1, 3, S, S')`` float32, RGB from 0 to 1.
        size: Side of the input where the model leaves it open [pixel].
        confidence: Least score, objectness times the best class's.
        overlap: Boxes of one class that overlap a better one by more than this go.
        classes: The classes that are obstacles; None: all.

    Raises:
        ImportError: onnxruntime is not installed.
    """

    def __init__(
        self,
        model_path: str | Path,
        size: int = 640,
        confidence: float = 0.25,
        overlap: float = 0.45,
        classes: tuple[int, ...] | None = None,
    ) -> None:
        onnxruntime: Any = import_module("onnxruntime")
        self._session = onnxruntime.InferenceSession(
            str(model_path), providers=["CPUExecutionProvider"]
        )
        given = self._session.get_inputs()[0]
        self._input = given.name
        sides = [side if isinstance(side, int) else size for side in given.shape[2:]]
        self.height, self.width = sides
        self.confidence, self.overlap, self.classes = confidence, overlap, classes

    def __call__(self, color: np.ndarray) -> Boxes:
        """The boxes in a picture ``(H, W, 3)`` uint8, RGB.

        Raises:
            ValueError: The model's output has neither layout.
        """
        picture, scale, left, top = letterbox(color, self.height, self.width)
        tensor = picture.transpose(2, 0, 1)[None].astype(np.float32) / 255
        output = np.asarray(self._session.run(None, {self._input: tensor})[0], np.float64)
        boxes = read_output(output, self.confidence, self.overlap)
        if self.classes is not None:
            chosen = np.isin(boxes.classes, self.classes)
            boxes = Boxes(*(part[chosen] for part in boxes))
        corners = (boxes.corners - [left, top, left, top]) / scale
        height, width = color.shape[:2]
        return boxes._replace(corners=np.clip(corners, 0, [width, height, width, height]))


def letterbox(color: np.ndarray, height: int, width: int) -> tuple[np.ndarray, float, int, int]:
    """A picture made to fit, its shape kept, grey around.

    Returns:
        ``(height, width, 3)`` uint8, the scale, and where its left and top edges are [pixel].
    """
    scale = min(height / color.shape[0], width / color.shape[1])
    inner = round(color.shape[1] * scale), round(color.shape[0] * scale)
    left, top = (width - inner[0]) // 2, (height - inner[1]) // 2
    out = np.full((height, width, 3), PAD_GREY, np.uint8)
    resized = cv2.resize(color, inner, interpolation=cv2.INTER_LINEAR)
    out[top : top + inner[1], left : left + inner[0]] = resized
    return out, scale, left, top


def read_output(output: np.ndarray, confidence: float, overlap: float) -> Boxes:
    """Boxes from either layout, in pixels of the model's input.

    Raises:
        ValueError: It has neither.
    """
    if output.ndim == 2 and output.shape[1] == 7:
        order = np.argsort(-output[:, 6], kind="stable")
        rows = output[order][output[order, 6] >= confidence]
        return Boxes(rows[:, 1:5], rows[:, 6], rows[:, 5].astype(np.int64))
    if output.ndim != 3 or output.shape[0] != 1 or output.shape[2] < 6:
        raise ValueError(f"output {output.shape} is neither (1, N, 5 + C) nor (N, 7)")
    rows = output[0]
    classes = np.argmax(rows[:, 5:], axis=1)
    scores = rows[:, 4] * rows[np.arange(len(rows)), 5 + classes]
    centre, half = rows[:, :2], rows[:, 2:4] / 2
    corners = np.concatenate([centre - half, centre + half], axis=1)
    able = scores >= confidence
    boxes = Boxes(corners[able], scores[able], classes[able])
    return Boxes(*(part[suppress(boxes, overlap)] for part in boxes))


def suppress(boxes: Boxes, overlap: float) -> np.ndarray:
    """Non-maximum suppression, class by class.

    Args:
        boxes: In any order.
        overlap: Largest intersection over union with a better box of the same class.

    Returns:
        ``(k,)`` int64, the boxes that stay, best first (of equals, the earlier one).
    """
    left, top, right, bottom = boxes.corners.T
    area = (right - left) * (bottom - top)
    order = np.argsort(-boxes.scores, kind="stable")
    stay: list[int] = []
    while len(order):
        best, order = int(order[0]), order[1:]
        stay.append(best)
        wide = np.minimum(right[order], right[best]) - np.maximum(left[order], left[best])
        high = np.minimum(bottom[order], bottom[best]) - np.maximum(top[order], top[best])
        common = np.maximum(wide, 0) * np.maximum(high, 0)
        union = area[order] + area[best] - common
        same = boxes.classes[order] == boxes.classes[best]
        order = order[~(same & (common > overlap * union))]
    return np.array(stay, np.int64)


def label_boxes(boxes: Boxes, frame: Frame, band_m: float) -> np.ndarray:
    """Boxes as obstacles: of each, the kept pixels near the median depth inside it.

    Args:
        boxes: Best first; a pixel belongs to the best box that takes it.
        frame: Its kept pixels and their depth.
        band_m: Half the depth of an obstacle around the median [m].

    Returns:
        ``(H, W)`` int32, number of the box, -1 = none.
    """
    out = np.full(frame.z.shape, -1, np.int32)
    band = band_m / frame.calibration.depth_unit
    edges = np.rint(boxes.corners).astype(np.int64)
    for number, (left, top, right, bottom) in enumerate(edges.tolist()):
        part = np.s_[top:bottom, left:right]
        keep, z = frame.keep[part], frame.z[part].astype(np.int64)
        if keep.any():
            near = keep & (np.abs(z - np.median(z[keep])) <= band)
            out[part] = np.where(near & (out[part] < 0), number, out[part])
    return out


def detector_baseline(detector: OnnxDetector, title: str = "ONNX detector") -> Baseline:
    """A detector as a baseline of the space ``image``; best scored on the grid."""

    def run(frame: Frame, band_m: float) -> np.ndarray:
        return label_boxes(detector(frame.color), frame, band_m)

    return Baseline(
        name="onnx",
        title=title,
        run=run,
        space="image",
        citation="Wang, Bochkovskiy, Liao, YOLOv7, CVPR 2023; Jocher et al., YOLOv5",
        defaults={"band_m": 0.3},
        grid={"band_m": (0.15, 0.3, 0.5)},
        needs=("onnxruntime",),
    )
