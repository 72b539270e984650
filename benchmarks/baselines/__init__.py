"""Methods that this project's method is compared with, all on the same preprocessed frames.

>>> from benchmarks.baselines import BASELINES
>>> BASELINES["rsc"].title
'RSC (our reading)'

A feature-based method is a function from a frame's features above the floor, ``(n, 2)`` x z or
``(n, 3)`` x y z in metres depending on its ``space``, to labels; a dense method takes the whole
frame. :func:`prepare` makes the frames, :func:`detect_with` runs a method on one, :func:`tune`
chooses its parameters, :func:`run_frames` scores it. The minimum size of clusters is the same for
all methods.
"""

from benchmarks.baselines.catalogue import BASELINES
from benchmarks.baselines.frames import Frame, points_of, prepare
from benchmarks.baselines.registry import Baseline, detect_with, labels_of
from benchmarks.baselines.tune import Tuned, run_frames, tune

__all__ = [
    "BASELINES",
    "Baseline",
    "Frame",
    "Tuned",
    "detect_with",
    "labels_of",
    "points_of",
    "prepare",
    "run_frames",
    "tune",
]
