"""Evaluation of detections against ground truth, frame by frame, summed over a log.

:mod:`jaxdet.eval.frame` describes the matching, :class:`Score` the metrics with their formulas.

>>> from jaxdet.eval import Tally, score
>>> score([Tally(visible=4, found=3, false=1), Tally(visible=1, found=1)]).accuracy
0.6666666666666666
"""

from jaxdet.eval.claimed import claimed_floor, floor_positions, measured_floor
from jaxdet.eval.frame import evaluate, evaluate_frames
from jaxdet.eval.indices import davies_bouldin, silhouette
from jaxdet.eval.match import match
from jaxdet.eval.partition import PairCounts, fowlkes_mallows, pair_counts
from jaxdet.eval.score import Score, score
from jaxdet.eval.tally import Case, Tally, keep_shares, total
from jaxdet.eval.truth import (
    EvalConfig,
    FrameTruth,
    LogTruth,
    in_depth_camera,
    nearest_on_floor,
    truth_of,
)

__all__ = [
    "Case",
    "EvalConfig",
    "FrameTruth",
    "LogTruth",
    "PairCounts",
    "Score",
    "Tally",
    "claimed_floor",
    "davies_bouldin",
    "evaluate",
    "evaluate_frames",
    "floor_positions",
    "fowlkes_mallows",
    "in_depth_camera",
    "keep_shares",
    "match",
    "measured_floor",
    "nearest_on_floor",
    "pair_counts",
    "score",
    "silhouette",
    "total",
    "truth_of",
]
