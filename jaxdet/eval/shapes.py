"""Errors of distance, width and outline of the obstacles of a frame."""

import math

import numpy as np

from jaxdet.eval.polygon import inside, near_side, overlap
from jaxdet.eval.tally import Case, Tally
from jaxdet.eval.truth import EvalConfig, FrameTruth
from jaxdet.results.metric import rectangles
from jaxdet.types import Detections

NEAR_STEP_M = 0.01
"""Spacing of the footprint points for the coverage [m]."""


class Shapes:
    """Detected and true distances, widths and outlines of a frame [m].

    Fields that the ground truth lacks are None.
    """

    def __init__(
        self,
        detections: Detections,
        truth: FrameTruth,
        b: int,
        count: int,
        depth_unit: float,
        config: EvalConfig,
        distances_m: np.ndarray | None,
    ) -> None:
        slots = detections.obstacles
        self.distance = None if distances_m is None else distances_m[b]
        self.true_distance = None if truth.nearest_floor_m is None else truth.nearest_floor_m[b]
        self.forward = np.asarray(slots.c)[b, :count, 1] * depth_unit
        self.true_forward = truth.nearest_forward_m[b]
        self.width = self.true_low = self.true_width = self.outline = self.rectangle = None
        if truth.ground_min is not None and truth.ground_max is not None:
            self.width = (np.asarray(slots.b) - np.asarray(slots.a))[b, :count, 0] * depth_unit
            self.true_low = truth.ground_min[b, :, 0]
            self.true_width = truth.ground_max[b, :, 0] - self.true_low
        if truth.footprint is not None:
            one = type(slots)(*(a if a is None else np.asarray(a)[b, :count] for a in slots))
            self.outline = truth.footprint[b]
            self.rectangle = rectangles(one, depth_unit, config.footprint)

    def near(self, j: int, config: EvalConfig) -> np.ndarray:
        """Return the footprint points of object ``j`` for the coverage.

        The points are on the near side of the object and in range. Points to the left or right of
        the visible surface, or in front of it, are left out, as detections can't cover parts beyond
        the image border.
        """
        if self.outline is None or self.true_low is None or self.true_width is None:
            return np.zeros((0, 2))
        points = near_side(self.outline[j], NEAR_STEP_M)
        beyond = points[:, 0] - self.true_low[j]
        seen = (beyond >= 0) & (beyond <= self.true_width[j])
        seen &= points[:, 1] >= self.true_forward[j] - config.coverage_margin_m
        return points[seen & (np.hypot(*points.T) <= config.coverage_range_m)]


def count_shapes(
    required: np.ndarray, pair: np.ndarray, shapes: Shapes, config: EvalConfig
) -> Tally:
    """Return a case for each required obstacle, and the coverage of its footprint.

    Args:
        required: Whether each object is required, by number, ``(J + 1,)`` bool.
        pair: Number of the obstacle matched to each detection, ``(L,)``, 0 = none.
        shapes: Outlines of the frame.
        config: Margin and range.
    """
    cases: list[Case] = []
    points = covered = every = safe = 0
    margin, nan = config.coverage_margin_m, math.nan
    for number in np.flatnonzero(required).tolist():
        j, which = number - 1, np.flatnonzero(pair == number)
        near, position, width, iou, nearest = shapes.near(j, config), nan, nan, nan, nan
        every += len(near)
        if shapes.rectangle is not None and len(near):
            hits = [inside(rectangle, near, margin) for rectangle in shapes.rectangle]
            safe += int(np.any([np.zeros(len(near), bool), *hits], axis=0).sum())
            if len(which):
                points += len(near)
                covered += int(hits[which[0]].sum())
        if len(which):
            k = int(which[0])
            position = float(shapes.forward[k] - shapes.true_forward[j])
            if shapes.width is not None and shapes.true_width is not None:
                width = float(shapes.width[k] - shapes.true_width[j])
            if shapes.rectangle is not None and shapes.outline is not None:
                iou = overlap(shapes.rectangle[k], shapes.outline[j])
            if shapes.distance is not None and shapes.true_distance is not None:
                nearest = float(shapes.distance[k] - shapes.true_distance[j])
        distance = float(shapes.true_forward[j])
        cases.append(Case(number, distance, bool(len(which)), position, width, iou, nearest))
    return Tally(
        near_points=points,
        near_covered=covered,
        near_asked=every,
        near_safe=safe,
        cases=tuple(cases),
    )
