"""Evaluation of image boxes against labelled boxes of real images, frame by frame.

A box is ``u_min v_min u_max v_max``, its first and last column and row [pixel], as in the obstacle
table. A detection and an object match if their boxes overlap sufficiently, by intersection over
union (IoU; Everingham et al., IJCV 88 (2010), 303-338), one to one, the largest overlap first.
"""

from typing import NamedTuple

import numpy as np

from jaxdet.eval.tally import Case, Tally

MIN_IOU = 0.5
"""Minimum IoU of the boxes of an object and its detection."""
NEAR_M = 0.08
"""Extent in depth of an object's near surface, from the object's nearest points on [m]."""


class BoxLabels(NamedTuple):
    """Labelled boxes of an image with ``T`` objects."""

    boxes: np.ndarray
    """Boxes of the objects, ``(T, 4)`` float64 [pixel]."""
    distance_m: np.ndarray
    """Distances of the objects on the floor, ``(T,)`` float64 [m]; NaN if unknown."""
    ignored: np.ndarray
    """Regions in which detections are not evaluated, ``(I, 4)`` float64 [pixel]."""
    size: tuple[int, int] | None = None
    """Width and height of the image [pixel], if known."""


def evaluate_boxes(
    labels: BoxLabels, required: np.ndarray, found: np.ndarray, distance_m: np.ndarray
) -> Tally:
    """Count the correct, missed and false detections of a frame.

    Unmatched detections are ignored if they are outside of the image, or if at least half of their
    box is in an ignored region.

    Args:
        labels: Labelled boxes.
        required: Whether each object must be found, ``(T,)`` bool.
        found: Boxes of the detections, ``(n, 4)`` integer; ``u_max < u_min`` if outside of the
            image.
        distance_m: Distances of the detections on the floor, ``(n,)`` [m].

    Example:
        >>> boxes = np.array([[0, 0, 9, 9], [20, 0, 29, 9]])
        >>> labels = BoxLabels(boxes, np.array([1.0, np.nan]), np.zeros((0, 4)))
        >>> found = np.array([[0, 0, 9, 8], [50, 0, 59, 9]])
        >>> tally = evaluate_boxes(labels, np.array([True, True]), found, np.array([1.1, 3.0]))
        >>> tally.visible, tally.found, tally.false
        (2, 1, 1)
    """
    pairs = match_boxes(labels.boxes, found, MIN_IOU)
    right = (pairs >= 0) & required
    unmatched = np.setdiff1d(np.arange(len(found)), pairs)
    outside = found[unmatched, 2] < found[unmatched, 0]
    counted = unmatched[~outside & ~_is_inside(found[unmatched], labels.ignored)]
    nan = np.nan
    cases = [
        Case(j + 1, nan, bool(right[j]), nan, nan, nan, _error(labels, distance_m, j, pairs[j]))
        for j in np.flatnonzero(required).tolist()
    ]
    return Tally(
        frames=1,
        visible=int(required.sum()),
        found=int(right.sum()),
        detections=len(found),
        matched=int((pairs >= 0).sum()),
        false=len(counted),
        ignored=len(found) - int(right.sum()) - len(counted),
        cases=tuple(cases),
    )


def _error(labels: BoxLabels, distance_m: np.ndarray, j: int, detection: int) -> float:
    """Return the error of a detection's distance [m], NaN without a detection."""
    return float(distance_m[detection] - labels.distance_m[j]) if detection >= 0 else np.nan


def _is_inside(boxes: np.ndarray, regions: np.ndarray) -> np.ndarray:
    """Return which boxes ``(n, 4)`` have at least half of their pixels in a region."""
    low = np.maximum(boxes[:, None, :2], regions[None, :, :2])
    high = np.minimum(boxes[:, None, 2:], regions[None, :, 2:]) + 1
    shared = np.maximum(high - low, 0).prod(axis=2)
    return (2 * shared >= box_sizes(boxes)[:, None]).any(axis=1)


def box_iou(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the intersection over union of boxes ``(n, 4)`` and ``(m, 4)``: ``(n, m)`` float64.

    Example:
        >>> box_iou(np.array([[0, 0, 9, 9]]), np.array([[5, 0, 14, 9], [10, 0, 19, 9]])).tolist()
        [[0.3333333333333333, 0.0]]
    """
    low = np.maximum(a[:, None, :2], b[None, :, :2])
    high = np.minimum(a[:, None, 2:], b[None, :, 2:]) + 1
    both = np.maximum(high - low, 0).prod(axis=2)
    return both / (box_sizes(a)[:, None] + box_sizes(b) - both)


def box_sizes(boxes: np.ndarray) -> np.ndarray:
    """Return the number of pixels of boxes ``(n, 4)``: ``(n,)``."""
    return (boxes[:, 2:] - boxes[:, :2] + 1).prod(axis=1)


def match_boxes(boxes: np.ndarray, found: np.ndarray, least_iou: float) -> np.ndarray:
    """Match objects and detections one to one, the pair with the largest IoU first.

    Args:
        boxes: Boxes of the objects, ``(T, 4)``.
        found: Boxes of the detections, ``(n, 4)``.
        least_iou: Minimum IoU of a pair.

    Returns:
        Detection of each object, ``(T,)`` int64, -1 = none. In a tie, the pair with the larger
        object number, then detection number, is taken first.

    Example:
        >>> objects = np.array([[0, 0, 9, 9], [0, 0, 9, 7]])
        >>> match_boxes(objects, np.array([[0, 0, 9, 8], [0, 0, 9, 9]]), 0.5).tolist()
        [1, 0]
    """
    iou = box_iou(boxes, found)
    rows, columns = np.nonzero(iou >= least_iou)
    order = np.lexsort((columns, rows, iou[rows, columns]))[::-1]
    pairs = np.full(len(boxes), -1, np.int64)
    for row, column in zip(rows[order].tolist(), columns[order].tolist(), strict=True):
        if pairs[row] < 0 and column not in pairs:
            pairs[row] = column
    return pairs


def near_surface(z_m: np.ndarray) -> float:
    """Return the depth of an object's near surface from the depths of its pixels ``(n,)`` [m].

    The result is the median of the depths up to ``NEAR_M`` beyond the 5th percentile, NaN for an
    object without pixels.

    Example:
        >>> near_surface(np.array([1.0, 1.0, 1.02, 1.5, 1.5]))
        1.0
    """
    if not z_m.size:
        return float("nan")
    return float(np.median(z_m[z_m <= np.quantile(z_m, 0.05) + NEAR_M]))
