"""Choice of a method's parameters on tuning frames, by a grid and then a compass search."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from benchmarks.baselines.frames import Frame
from benchmarks.baselines.registry import Baseline, detect_with
from jaxdet.config import Config
from jaxdet.eval import EvalConfig, FrameTruth, Score, Tally, evaluate_frames, score

STEP = 1.5
"""Factor between a value that the search tries and the best one so far."""


class Tuned(NamedTuple):
    """Best parameters on the tuning frames."""

    params: dict[str, Any]
    value: float
    """Objective with these parameters."""
    trials: list[tuple[dict[str, Any], float]]
    """All parameters tried and their objective, in order: the grid, then those of the search."""


def tune(
    baseline: Baseline,
    frames: Sequence[Frame],
    truths: Sequence[FrameTruth],
    objective: Callable[[Score], float],
    config: Config,
    eval_config: EvalConfig,
) -> Tuned:
    """Choose a method's parameters: try the grid, then search around its best point.

    Numbers with several values in the grid are increased and decreased one by one while that
    improves the objective (compass search), so that no method is limited by the bounds or steps of
    its grid.

    Args:
        baseline: The method.
        frames: Tuning frames, never those of the test.
        truths: Ground truth of each frame, ``B = 1``.
        objective: Function of the score that is maximised; NaN counts as the worst.
        config: Configuration of the minimum size and the outlines, common to all methods.
        eval_config: Configuration of the evaluation.

    Returns:
        The best trial; of equally good ones, the first.
    """

    def value(params: dict[str, Any]) -> float:
        tallies = run_frames(baseline, frames, truths, params, config, eval_config)
        return float(objective(score(tallies)))

    return search(baseline.trials(), baseline.numbers(), value)


def search(
    trials: Sequence[dict[str, Any]],
    numbers: Sequence[str],
    objective: Callable[[dict[str, Any]], float],
) -> Tuned:
    """Try all of ``trials``, then change ``numbers`` of the best one while that improves it.

    Args:
        trials: Settings, all with the same names.
        numbers: Names of settings that are increased and decreased.
        objective: Function of the settings that is maximised; NaN counts as the worst.

    Returns:
        The best trial; of equally good ones, the first.
    """
    known: dict[tuple[Any, ...], float] = {}

    def value(params: dict[str, Any]) -> float:
        key = tuple(params.values())
        if key not in known:
            known[key] = objective(params)
        return -math.inf if math.isnan(known[key]) else known[key]

    best = max(trials, key=value)
    found = True
    while found:
        found = False
        for name in numbers:
            for up in (True, False):
                while value(near := _moved(best, name, up=up)) > value(best):
                    best, found = near, True
    tried = [(dict(zip(best, key, strict=True)), one) for key, one in known.items()]
    return Tuned(best, known[tuple(best.values())], tried)


def _moved(params: dict[str, Any], name: str, *, up: bool) -> dict[str, Any]:
    """Increase or decrease one parameter; integers change by at least 1 and stay at least 1."""
    old = params[name]
    new = old * STEP if up else old / STEP
    if isinstance(old, int):
        new = max(old + 1, round(new)) if up else max(1, min(old - 1, round(new)))
    return {**params, name: new}


def run_frames(
    baseline: Baseline,
    frames: Sequence[Frame],
    truths: Sequence[FrameTruth],
    params: Mapping[str, Any],
    config: Config | None = None,
    eval_config: EvalConfig | None = None,
) -> list[Tally]:
    """Run a method on frames and compare it with the truth; return a tally of each frame.

    Args:
        baseline: The method.
        frames: The frames.
        truths: Ground truth of each frame, ``B = 1``.
        params: Parameters that replace the method's defaults.
        config: Configuration of the minimum size and the outlines, common to all methods.
        eval_config: Configuration of the evaluation.
    """
    tallies: list[Tally] = []
    for frame, truth in zip(frames, truths, strict=True):
        found = detect_with(baseline, frame, config, params)
        tallies += evaluate_frames(found, truth, frame.calibration, eval_config)
    return tallies
