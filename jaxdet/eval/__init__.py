"""Scores of detections against the truth; the definitions are in :mod:`jaxdet.eval.score`."""

from jaxdet.eval.score import EvalConfig, FrameTruth, Score, Tally, evaluate, score, total

__all__ = ["EvalConfig", "FrameTruth", "Score", "Tally", "evaluate", "score", "total"]
