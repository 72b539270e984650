"""Comparison of the image boxes of detections with labels of real frames.

A box is ``u_min v_min u_max v_max``, its first and last column and row [pixel], as in the table
``obstacles``. A detection and an object are a pair when their boxes overlap by enough, intersection
over union (IoU; Everingham et al., IJCV 88 (2010), 303-338), one to one, the largest overlap first.
A detection counts only if at least half of its box's pixels are labelled. Other detections are
neither right nor wrong, and are never part of a pair.

>>> score_boxes([BoxTally(objects=4, detections=3, matched=2)]).recall
0.5
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxdet.camera import pixel_rays
from jaxdet.eval.boxes import box_sizes, match_boxes, near_surface
from jaxdet.types import Intrinsics

FLOOR = 1
"""Label of the floor; 0 means unknown, each larger label is an object."""
MIN_PLANE_PIXELS = 50
"""Minimum number of floor pixels with depth to which a plane is fitted."""


class FrameLabels(NamedTuple):
    """Labels of one real frame with ``T`` objects."""

    boxes: np.ndarray
    """Boxes of the objects, ``(T, 4)`` int64 [pixel]."""
    distance_m: np.ndarray
    """Forward depth of each object's near surface, ``(T,)`` float64 [m]; NaN = unknown."""
    floor: np.ndarray
    """Mask of the floor, ``(H, W)`` bool."""
    known: np.ndarray
    """Mask of the labelled pixels, ``(H, W)`` bool."""
    tags: tuple[frozenset[str], ...]
    """Tags of each object, such as ``low``."""


class BoxTally(NamedTuple):
    """Counts of one frame; the counts of several frames are added."""

    objects: int = 0
    detections: int = 0
    """Number of detections that count."""
    matched: int = 0
    swamped: int = 0
    """1 if a box covers more than half of the floor, whether or not the detection counts."""
    on_floor: int = 0
    """Number of false detections with a box of which at least half is floor."""
    floor_pixels: int = 0
    """Number of floor pixels with depth."""
    floor_kept: int = 0
    """Number of floor pixels with depth that are classified as above the floor."""
    errors_m: tuple[float, ...] = ()
    """Distance of each matched detection minus the object's, if known [m]."""
    tagged: tuple[tuple[str, bool], ...] = ()
    """Tags of each object, and whether the object is matched."""


COUNTS = tuple(name for name, default in BoxTally._field_defaults.items() if default == 0)
"""Fields of a tally that are summed."""


class BoxScore(NamedTuple):
    """Figures of several frames; NaN if there is nothing to divide by."""

    recall: float
    """Share of the objects that are found."""
    precision: float
    """Fraction of the counted detections that match an object."""
    swamped: int
    """Number of frames in which the floor is detected as an obstacle."""
    on_floor: int
    """Number of false detections with a box of which at least half is floor."""
    floor_kept: float
    """Share of the floor's measured pixels that are classified as above the floor."""
    error_median_m: float
    """Median of the absolute errors of distances [m]."""
    error_p90_m: float
    """90th percentile of the absolute errors of distances [m]."""


def tally_boxes(
    labels: FrameLabels,
    found: np.ndarray,
    nearest_m: np.ndarray,
    kept: np.ndarray,
    measured: np.ndarray,
    least_iou: float,
) -> BoxTally:
    """Compare the detections of one frame with its labels.

    Args:
        labels: Labels of the frame.
        found: Boxes of the detections, ``(n, 4)`` integer.
        nearest_m: Smallest forward depth of each detection, ``(n,)`` float [m].
        kept: Mask of the pixels classified as above the floor, ``(H, W)`` bool.
        measured: Mask of the pixels with depth, ``(H, W)`` bool.
        least_iou: Minimum IoU of a pair, more than 0.
    """
    floor = _pixels(labels.floor, found)
    counted = np.flatnonzero(on_known_ground(labels, found))
    pairs = match_boxes(labels.boxes, found[counted], least_iou)
    matched = pairs >= 0
    chosen = counted[pairs[matched]]
    errors = nearest_m[chosen] - labels.distance_m[matched]
    false = np.setdiff1d(counted, chosen)
    sizes = box_sizes(found)
    ground = labels.floor & measured
    return BoxTally(
        objects=len(labels.boxes),
        detections=len(counted),
        matched=len(chosen),
        swamped=int((2 * floor > labels.floor.sum()).any()),
        on_floor=int((2 * floor >= sizes)[false].sum()),
        floor_pixels=int(ground.sum()),
        floor_kept=int((ground & kept).sum()),
        errors_m=tuple(errors[~np.isnan(errors)].tolist()),
        tagged=tuple(
            (tag, hit)
            for tags, hit in zip(labels.tags, matched.tolist(), strict=True)
            for tag in sorted(tags)
        ),
    )


def on_known_ground(labels: FrameLabels, found: np.ndarray) -> np.ndarray:
    """Return whether each box ``(n, 4)`` counts: at least half of its pixels are labelled."""
    return 2 * _pixels(labels.known, found) >= box_sizes(found)


def _pixels(mask: np.ndarray, boxes: np.ndarray) -> np.ndarray:
    """Return how many pixels of a mask are in each box, ``(n,)`` int64."""
    return np.array([mask[v : b + 1, u : r + 1].sum() for u, v, r, b in boxes], np.int64)


def score_boxes(tallies: Sequence[BoxTally]) -> BoxScore:
    """Compute the figures of several frames together."""
    total = {k: sum(getattr(t, k) for t in tallies) for k in COUNTS}
    errors = np.abs([error for tally in tallies for error in tally.errors_m])
    middle, high = np.quantile(errors, [0.5, 0.9]).tolist() if errors.size else (np.nan, np.nan)
    return BoxScore(
        recall=_ratio(total["matched"], total["objects"]),
        precision=_ratio(total["matched"], total["detections"]),
        swamped=total["swamped"],
        on_floor=total["on_floor"],
        floor_kept=_ratio(total["floor_kept"], total["floor_pixels"]),
        error_median_m=middle,
        error_p90_m=high,
    )


def count_tagged(tallies: Sequence[BoxTally], tag: str) -> tuple[int, int]:
    """Return how many objects with a tag are matched, and how many there are.

    >>> count_tagged([BoxTally(tagged=(("low", True), ("cut", True), ("low", False)))], "low")
    (1, 2)
    """
    hits = [hit for tally in tallies for name, hit in tally.tagged if name == tag]
    return sum(hits), len(hits)


def _ratio(part: int, whole: int) -> float:
    return part / whole if whole else float("nan")


def labels_of_boxes(
    boxes: np.ndarray,
    distance_m: np.ndarray,
    ignored: np.ndarray,
    width: int,
    height: int,
    tags: tuple[frozenset[str], ...] = (),
) -> FrameLabels:
    """Return the labels of a frame whose obstacles have boxes; all other pixels are floor.

    Pixels in ignored regions are unknown unless they are in an object's box.

    Args:
        boxes: Boxes of the objects, ``(T, 4)`` integer.
        distance_m: Distance of each object, ``(T,)`` float [m].
        ignored: Boxes of regions in which detections are neither right nor wrong, ``(I, 4)``
            integer.
        width: Width of the image [pixel].
        height: Height of the image [pixel].
        tags: Tags of each object; none by default.
    """
    tags = tags or (frozenset(),) * len(boxes)
    objects, hidden = (_filled(each, width, height) for each in (boxes, ignored))
    return FrameLabels(boxes, distance_m, ~(objects | hidden), objects | ~hidden, tags)


def _filled(boxes: np.ndarray, width: int, height: int) -> np.ndarray:
    mask = np.zeros((height, width), bool)
    for u, v, right, bottom in boxes.tolist():
        mask[v : bottom + 1, u : right + 1] = True
    return mask


def labels_of_image(
    image: np.ndarray,
    z_m: np.ndarray,
    camera: Intrinsics,
    least_pixels: int = 1,
    least_height_m: float = 0.0,
) -> FrameLabels:
    """Return the labels of a frame from a label image: 0 unknown, 1 floor, 2 and more objects.

    Args:
        image: Labels, ``(H, W)`` integer.
        z_m: Forward depth ``(H, W)`` float [m], 0 = none.
        camera: Intrinsics of the image.
        least_pixels: Minimum number of pixels of an object; detections of smaller ones are false.
        least_height_m: Minimum height of an object above the labelled floor [m]; detections of
            lower ones are neither right nor wrong.

    Raises:
        ValueError: A minimum height is given, but too few floor pixels have depth.
    """
    height_m = heights(z_m, image == FLOOR, camera) if least_height_m else None
    known = image > 0
    boxes, distance = [], []
    for key in np.unique(image[image > FLOOR]).tolist():
        mask = image == key
        measured = mask & (z_m > 0)
        if height_m is not None and _top(height_m[measured]) < least_height_m:
            known &= ~mask
        elif mask.sum() >= least_pixels:
            v, u = np.nonzero(mask)
            boxes.append((u.min(), v.min(), u.max(), v.max()))
            distance.append(near_surface(z_m[measured]))
    shaped = np.array(boxes, np.int64).reshape(-1, 4)
    tags = (frozenset[str](),) * len(boxes)
    return FrameLabels(shaped, np.array(distance, np.float64), image == FLOOR, known, tags)


def _top(height_m: np.ndarray) -> float:
    """Return the 95th percentile of heights [m], to ignore a few wrong pixels; inf if empty."""
    return float(np.quantile(height_m, 0.95)) if height_m.size else np.inf


def heights(z_m: np.ndarray, floor: np.ndarray, camera: Intrinsics) -> np.ndarray:
    """Compute the height of each pixel's point above the plane fitted to the floor's points.

    A plane at distance ``d`` with the unit normal ``n`` has ``1 / z = (n / d) . ray``, which is
    linear in ``n / d`` and has the noise of a disparity. It is fitted by least squares, then twice
    again without the points whose distance is more than three times the median.

    Args:
        z_m: Forward depth ``(H, W)`` float [m], 0 = none.
        floor: Mask of the floor, ``(H, W)`` bool.
        camera: Intrinsics of the image.

    Returns:
        Heights ``(H, W)`` float64 [m]; where there is no depth, the height of the camera.

    Raises:
        ValueError: Too few floor pixels have depth.
    """
    used = floor & (z_m > 0)
    if used.sum() < MIN_PLANE_PIXELS:
        raise ValueError(f"only {used.sum()} floor pixels have depth")
    rays = np.stack([*pixel_rays(camera), np.ones_like(z_m, np.float64)], axis=-1)
    height_m = np.empty(z_m.shape)
    for _ in range(3):
        plane = np.linalg.lstsq(rays[used], 1 / z_m[used])[0]
        height_m = (1 - z_m * (rays @ plane)) / np.linalg.norm(plane)
        off = np.abs(height_m)
        used &= off <= 3 * np.median(off[used])
    return height_m
