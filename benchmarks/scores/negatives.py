"""Negative samples of the paper: "ground shadows, noise, or other non-existent situations".

The paper labels them by hand, next to the obstacles, and its accuracy counts those that are not
detected, ``(TP + TN) / (TP + TN + FP + FN)``. Here a negative sample is a group of corners on the
floor, where no object is: texture, a shadow, or a reflection that Canny and Shi-Tomasi see.
"""

import cv2
import numpy as np

from jaxdet.config import FeaturesConfig
from jaxdet.eval import FrameTruth, Tally
from jaxdet.eval.frame import points_of
from jaxdet.reference.paper._canny import canny, grey
from jaxdet.types import Calibration, Detections

CLEAR_PX = 9
"""Minimum distance of a corner of a negative sample from objects [pixel]."""
MIN_CORNERS = 4
"""Minimum number of corners of a negative sample."""


def negative_samples(
    color: np.ndarray, truth: FrameTruth, config: FeaturesConfig, max_depth_m: float
) -> np.ndarray:
    """Return the negative samples of an image as a label image.

    Corners that are closer than twice the minimum distance of corners belong to one sample.

    Args:
        color: Image ``(H, W, 3)`` uint8, RGB.
        truth: Ground truth of the frame, ``B = 1``, with ``depth_m``.
        config: Parameters of the corners.
        max_depth_m: Maximum true depth of the floor [m].

    Returns:
        Number of the sample in each pixel, ``(H, W)`` int32, 0 = none.
    """
    assert truth.depth_m is not None
    objects = (truth.obstacle_id[0] > 0).astype(np.uint8)
    near = cv2.dilate(objects, np.ones((2 * CLEAR_PX + 1,) * 2, np.uint8)) > 0
    floor = ~near & (np.asarray(truth.depth_m[0], np.float32) <= max_depth_m)
    edges = canny(grey(color), config.canny_low, config.canny_high)
    selection = config.max_corners, config.quality_level, config.min_distance
    found = cv2.goodFeaturesToTrack(edges, *selection, mask=floor.astype(np.uint8))
    corners = np.zeros((0, 2), np.int32) if found is None else found[:, 0].astype(np.int32)
    discs = np.zeros(floor.shape, np.uint8)
    for corner in corners.tolist():
        cv2.circle(discs, corner, int(config.min_distance), (1,), cv2.FILLED)
    count, labels = cv2.connectedComponents(discs)
    groups = np.asarray(labels, np.int64)
    sizes = np.bincount(groups[corners[:, 1], corners[:, 0]], minlength=count)
    sizes[0] = 0
    large = sizes >= MIN_CORNERS
    return np.where(large, np.cumsum(large), 0)[groups].astype(np.int32)


def with_negatives(
    tally: Tally,
    samples: np.ndarray,
    found: Detections,
    calibration: Calibration,
    side: int | None = None,
) -> Tally:
    """Return the tally of a frame with its true negatives, so that ``accuracy`` is the paper's ACC.

    A negative sample is a true negative if no point of a detection is on it. True negatives are
    added to what was to be found and to what was found, which makes the accuracy
    ``(TP + TN) / (TP + TN + FP + FN)``; other figures of the tally lose their meaning.

    Args:
        tally: Tally of the frame.
        samples: Label image of :func:`negative_samples`.
        found: Detections of the frame, ``B = 1``.
        calibration: Calibration of the log.
        side: Side of a cell [depth pixel], for detections of cells.

    Example:
        >>> from jaxdet.eval import score
        >>> score([Tally(visible=3 + 5, found=2 + 5, false=1)]).accuracy  # TP 2, TN 5
        0.7777777777777778
    """
    points, labels = points_of(found, 0, calibration, side)
    called = labels >= 0
    hit = np.unique(samples[points.v[called], points.u[called]])
    true_negatives = int(samples.max(initial=0)) - int((hit > 0).sum())
    return tally._replace(
        visible=tally.visible + true_negatives, found=tally.found + true_negatives
    )
