"""Choosing a method's parameters on tuning frames, by a grid."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from benchmarks.baselines.frames import Frame
from benchmarks.baselines.registry import Baseline, detect_with
from jaxdet.config import Config
from jaxdet.eval import EvalConfig, FrameTruth, Score, Tally, evaluate_frames, score


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
    truths: Sequence[FrameTruth],
    objective: Callable[[Score], float],
    config: Config,
    eval_config: EvalConfig,
) -> Tuned:
    """Tries the whole grid of a method.

    Args:
        baseline: The method.
        frames: Tuning frames, never those of the test.
        truths: Of each, with ``B = 1``.
        objective: What to make large; NaN counts as the worst.
        config: The shared size rule and outlines.
        eval_config: What counts.

    Returns:
        The best trial; of equals, the first in the grid's order.
    """
    trials: list[tuple[dict[str, Any], float]] = []
    for params in baseline.trials():
        tallies = run_frames(baseline, frames, truths, params, config, eval_config)
        trials.append((params, float(objective(score(tallies)))))
    values = np.nan_to_num([value for _, value in trials], nan=-np.inf)
    return Tuned(*trials[int(np.argmax(values))], trials)


def run_frames(
    baseline: Baseline,
    frames: Sequence[Frame],
    truths: Sequence[FrameTruth],
    params: Mapping[str, Any],
    config: Config | None = None,
    eval_config: EvalConfig | None = None,
) -> list[Tally]:
    """A method on some frames, compared with the truth: a tally for each frame.

    Args:
        baseline: The method.
        frames: The frames.
        truths: Of each, with ``B = 1``.
        params: Over the method's defaults.
        config: The shared size rule and outlines.
        eval_config: What counts.
    """
    tallies: list[Tally] = []
    for frame, truth in zip(frames, truths, strict=True):
        found = detect_with(baseline, frame, config, params)
        tallies += evaluate_frames(found, truth, frame.calibration.depth_unit, eval_config)
    return tallies
