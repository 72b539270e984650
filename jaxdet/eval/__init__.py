"""Scores of detections against the truth, frame by frame, added up over a log.

:mod:`jaxdet.eval.frame` states the rule, :class:`Score` the figures with their formulas.

>>> from jaxdet.eval import Tally, score
>>> score([Tally(visible=4, found=3, false=1), Tally(visible=1, found=1)]).accuracy
0.6666666666666666
"""

from jaxdet.eval.bootstrap import Interval, difference_intervals, intervals
from jaxdet.eval.frame import evaluate, evaluate_frames
from jaxdet.eval.group import group_objects
from jaxdet.eval.indices import davies_bouldin, silhouette
from jaxdet.eval.match import assign, match
from jaxdet.eval.partition import PairCounts, fowlkes_mallows, pair_counts
from jaxdet.eval.score import Score, Success, score, success_by_distance
from jaxdet.eval.tally import Case, Tally, keep_shares, total
from jaxdet.eval.truth import EvalConfig, FrameTruth, LogTruth, truth_of

__all__ = [
    "Case",
    "EvalConfig",
    "FrameTruth",
    "Interval",
    "LogTruth",
    "PairCounts",
    "Score",
    "Success",
    "Tally",
    "assign",
    "davies_bouldin",
    "difference_intervals",
    "evaluate",
    "evaluate_frames",
    "fowlkes_mallows",
    "group_objects",
    "intervals",
    "keep_shares",
    "match",
    "pair_counts",
    "score",
    "silhouette",
    "success_by_distance",
    "total",
    "truth_of",
]
