"""Choosing a method's parameters on tuning frames, by a grid."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from benchmarks.baselines.frames import Frame
from benchmarks.baselines.registry import Baseline, detect_with
from jaxdet.config import Config
from jaxdet.eval import EvalConfig, FrameTruth, Score, Tally, evaluate_frames, score

Objective = str | Callable[[Score], float]
"""A figure of :class:`jaxdet.eval.Score` by name, or a function of it; larger is better."""


Truths = FrameTruth | Sequence[FrameTruth]
"""Of ``B`` frames of one scene, or a truth with ``B = 1`` for each frame, of any scene."""


class Tuned(NamedTuple):
    """The best parameters on the tuning frames."""

    params: dict[str, Any]
    value: float
    """The objective there."""
    trials: list[tuple[dict[str, Any], float]]
    """All that was tried, in the grid's order."""


def tune(
    baseline: Baseline,
    frames: Sequence[Frame],
    truth: Truths,
    objective: Objective = "f1",
    config: Config | None = None,
    eval_config: EvalConfig | None = None,
) -> Tuned:
    """Tries the whole grid of a method.

    Args:
        baseline: The method.
        frames: ``B`` tuning frames, never those of the test.
        truth: Of the same frames.
        objective: What to make large; NaN counts as the worst.
        config: The shared size rule and outlines.
        eval_config: What counts.

    Returns:
        The best trial; of equals, the first in the grid's order.
    """
    trials: list[tuple[dict[str, Any], float]] = []
    for params in baseline.trials():
        figures = score(run_frames(baseline, frames, truth, params, config, eval_config))
        value = getattr(figures, objective) if isinstance(objective, str) else objective(figures)
        trials.append((params, float(value)))
    values = np.nan_to_num([value for _, value in trials], nan=-np.inf)
    best = int(np.argmax(values))
    return Tuned(*trials[best], trials)


def run_frames(
    baseline: Baseline,
    frames: Sequence[Frame],
    truth: Truths,
    params: Mapping[str, Any] | None = None,
    config: Config | None = None,
    eval_config: EvalConfig | None = None,
) -> list[Tally]:
    """A method on some frames, compared with the truth: a tally for each frame.

    Args:
        baseline: The method.
        frames: ``B`` frames.
        truth: Of the same frames.
        params: Over the method's defaults.
        config: The shared size rule and outlines.
        eval_config: What counts.
    """
    tallies: list[Tally] = []
    for frame, own in zip(frames, split(truth), strict=True):
        found = detect_with(baseline, frame, config, params)
        tallies += evaluate_frames(found, own, frame.calibration.depth_unit, eval_config)
    return tallies


def split(truth: Truths) -> Sequence[FrameTruth]:
    """A truth for each frame."""
    if not isinstance(truth, FrameTruth):
        return truth
    return [one_frame(truth, b) for b in range(len(truth.obstacle_id))]


def one_frame(truth: FrameTruth, b: int) -> FrameTruth:
    """The truth of frame ``b`` alone, ``B = 1``."""
    parts = {
        name: value[b : b + 1]
        for name, value in truth._asdict().items()
        if value is not None and name != "is_wall"
    }
    return truth._replace(**parts)
