"""Image boxes of detections against labelled real frames, where no simulator knows the truth.

A box is ``u_min v_min u_max v_max``, its first and last column and row [pixel], as in the table
``obstacles``. A detection and an object are a pair when their boxes overlap by enough, intersection
over union (IoU; Everingham et al., IJCV 88 (2010), 303-338), one to one, the largest overlap first.
Only detections on known ground count: at least half of the box's pixels show something that is
labelled. The others are neither right nor wrong, and pair with nothing.

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
"""The label of the floor; 0 is unknown, larger ones an object each."""
MIN_PLANE_PIXELS = 50
"""Fewer pixels of floor with a depth are no plane."""


class FrameLabels(NamedTuple):
    """What is known of one real frame, with ``T`` objects."""

    boxes: np.ndarray
    """``(T, 4)`` int64 [pixel]."""
    distance_m: np.ndarray
    """``(T,)`` float64, forward depth of the near surface [m]; NaN where unknown."""
    floor: np.ndarray
    """``(H, W)`` bool."""
    known: np.ndarray
    """``(H, W)`` bool, where a detection is right or wrong."""
    tags: tuple[frozenset[str], ...]
    """Tags of each object, such as ``low``."""


class BoxTally(NamedTuple):
    """Counts of one frame; they add up."""

    objects: int = 0
    detections: int = 0
    """Those on known ground."""
    matched: int = 0
    swamped: int = 0
    """1 where one box, counted or not, covers more than half of the floor."""
    on_floor: int = 0
    """Detections without an object of whose box at least half is floor."""
    floor_pixels: int = 0
    """Pixels of the floor that have a depth."""
    floor_kept: int = 0
    """Of those, the ones taken as above the floor."""
    errors_m: tuple[float, ...] = ()
    """Distance of each matched detection less the object's [m], where known."""
    tagged: tuple[tuple[str, bool], ...] = ()
    """Each tag of each object, and whether the object is matched."""


COUNTS = tuple(name for name, default in BoxTally._field_defaults.items() if default == 0)
"""Fields of a tally that are added."""


class BoxScore(NamedTuple):
    """Figures of several frames; NaN where there is nothing to divide by."""

    recall: float
    """Objects found, of all."""
    precision: float
    """Detections that are objects, of those on known ground."""
    swamped: int
    """Frames where the floor is an obstacle."""
    on_floor: int
    """False detections mostly on the floor."""
    floor_kept: float
    """Share of the floor's measured pixels taken as above the floor."""
    error_median_m: float
    """Median of the distances' absolute errors [m]."""
    error_p90_m: float
    """90th percentile of the same."""


def tally_boxes(
    labels: FrameLabels,
    found: np.ndarray,
    nearest_m: np.ndarray,
    kept: np.ndarray,
    measured: np.ndarray,
    least_iou: float,
) -> BoxTally:
    """Counts of one frame.

    Args:
        labels: What is known of the frame.
        found: ``(n, 4)`` integer, boxes of the detections.
        nearest_m: ``(n,)`` float, nearest forward depth of each [m].
        kept: ``(H, W)`` bool, pixels taken as above the floor.
        measured: ``(H, W)`` bool, pixels with a depth.
        least_iou: Least IoU of a pair, more than 0.
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
    """Which boxes ``(n, 4)`` count, those of at least half known pixels: ``(n,)`` bool."""
    return 2 * _pixels(labels.known, found) >= box_sizes(found)


def _pixels(mask: np.ndarray, boxes: np.ndarray) -> np.ndarray:
    """How many pixels of a mask each box holds, ``(n,)`` int64."""
    return np.array([mask[v : b + 1, u : r + 1].sum() for u, v, r, b in boxes], np.int64)


def score_boxes(tallies: Sequence[BoxTally]) -> BoxScore:
    """The figures of several frames together."""
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
    """How many objects with a tag are matched, and how many there are.

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
    """Labels of a frame whose obstacles have boxes; what has no box is floor.

    Known is all but the ignored regions, and in these the objects.

    Args:
        boxes: ``(T, 4)`` integer, of the objects.
        distance_m: ``(T,)`` float [m].
        ignored: ``(I, 4)`` integer, regions whose detections are neither right nor wrong.
        width: Of the image [pixel].
        height: Of the image [pixel].
        tags: Of each object; by default none has any.
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
    """Labels of a frame with a label for each pixel: 0 unknown, 1 floor, from 2 an object each.

    Args:
        image: ``(H, W)`` integer, the labels.
        z_m: ``(H, W)`` float, forward depth [m], 0 = none.
        camera: Its camera.
        least_pixels: Objects of fewer pixels are not asked for; a detection of one is false.
        least_height_m: Objects less high over the labelled floor are unknown [m].

    Raises:
        ValueError: Heights are asked for and too little floor has a depth.
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
    """A height that a few wrong pixels don't reach [m]; without any, unlimited."""
    return float(np.quantile(height_m, 0.95)) if height_m.size else np.inf


def heights(z_m: np.ndarray, floor: np.ndarray, camera: Intrinsics) -> np.ndarray:
    """Height of each pixel's point over the plane through the floor's points.

    A plane at distance ``d`` with the unit normal ``n`` has ``1 / z = (n / d) . ray``, which is
    linear in ``n / d`` and has the noise of a disparity; it is fitted by least squares, twice
    again without the points that lie off by more than three times the median.

    Args:
        z_m: ``(H, W)`` float, forward depth [m], 0 = none.
        floor: ``(H, W)`` bool, what shows the floor.
        camera: Its camera.

    Returns:
        ``(H, W)`` float64 [m]; without a depth, the height of the camera.

    Raises:
        ValueError: Too little floor has a depth.
    """
    used = floor & (z_m > 0)
    if used.sum() < MIN_PLANE_PIXELS:
        raise ValueError(f"{used.sum()} pixels of floor with a depth")
    rays = np.stack([*pixel_rays(camera), np.ones_like(z_m, np.float64)], axis=-1)
    height_m = np.empty(z_m.shape)
    for _ in range(3):
        plane = np.linalg.lstsq(rays[used], 1 / z_m[used])[0]
        height_m = (1 - z_m * (rays @ plane)) / np.linalg.norm(plane)
        off = np.abs(height_m)
        used &= off <= 3 * np.median(off[used])
    return height_m
