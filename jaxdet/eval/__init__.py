"""Scores of detections against the truth, frame by frame, added up over a log.

:mod:`jaxdet.eval.frame` states the rule, :class:`Score` the figures with their formulas.

>>> from jaxdet.eval import Tally, score
>>> score([Tally(visible=4, found=3, false=1), Tally(visible=1, found=1)]).accuracy
0.6666666666666666
"""

from jaxdet.eval.bootstrap import Interval, difference_intervals, intervals
from jaxdet.eval.boxes import (
    BoxScore,
    BoxTally,
    FrameLabels,
    box_iou,
    labels_of_boxes,
    labels_of_image,
    match_boxes,
    near_surface,
    on_known_ground,
    score_boxes,
    tally_boxes,
)
from jaxdet.eval.claimed import claimed_floor, floor_positions, measured_floor
from jaxdet.eval.frame import evaluate, evaluate_frames
from jaxdet.eval.group import group_objects
from jaxdet.eval.indices import davies_bouldin, silhouette
from jaxdet.eval.match import assign, match
from jaxdet.eval.partition import PairCounts, fowlkes_mallows, pair_counts
from jaxdet.eval.score import Score, score
from jaxdet.eval.tally import Case, Tally, keep_shares, total
from jaxdet.eval.truth import EvalConfig, FrameTruth, LogTruth, nearest_on_floor, truth_of

__all__ = [
    "BoxScore",
    "BoxTally",
    "Case",
    "EvalConfig",
    "FrameLabels",
    "FrameTruth",
    "Interval",
    "LogTruth",
    "PairCounts",
    "Score",
    "Tally",
    "assign",
    "box_iou",
    "claimed_floor",
    "davies_bouldin",
    "difference_intervals",
    "evaluate",
    "evaluate_frames",
    "floor_positions",
    "fowlkes_mallows",
    "group_objects",
    "intervals",
    "keep_shares",
    "labels_of_boxes",
    "labels_of_image",
    "match",
    "match_boxes",
    "measured_floor",
    "near_surface",
    "nearest_on_floor",
    "on_known_ground",
    "pair_counts",
    "score",
    "score_boxes",
    "silhouette",
    "tally_boxes",
    "total",
    "truth_of",
]
