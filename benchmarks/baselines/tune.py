"""Choosing a method's parameters on tuning frames: by a grid, then by compass search."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from benchmarks.baselines.frames import Frame
from benchmarks.baselines.registry import Baseline, detect_with
from jaxdet.config import Config
from jaxdet.eval import EvalConfig, FrameTruth, Score, Tally, evaluate_frames, score

STEP = 1.5
"""Factor between what the search tries and the best so far."""


class Tuned(NamedTuple):
    """The best parameters on the tuning frames."""

    params: dict[str, Any]
    value: float
    """The objective there."""
    trials: list[tuple[dict[str, Any], float]]
    """All that was tried, in order: the grid, then what the search tried."""


def tune(
    baseline: Baseline,
    frames: Sequence[Frame],
    truths: Sequence[FrameTruth],
    objective: Callable[[Score], float],
    config: Config,
    eval_config: EvalConfig,
) -> Tuned:
    """Tries the whole grid of a method, then looks around its best for better.

    Numbers that the grid has several of are made larger and smaller, one by one, as long as that
    helps (compass search), so that no method is held to the ends of a grid, or to its steps.

    Args:
        baseline: The method.
        frames: Tuning frames, never those of the test.
        truths: Of each, with ``B = 1``.
        objective: What to make large; NaN counts as the worst.
        config: The shared size rule and outlines.
        eval_config: What counts.

    Returns:
        The best trial; of equals, the first.
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
    """Try all of ``trials``, then move the best one's ``numbers`` as long as that helps.

    Args:
        trials: Settings of the same names.
        numbers: Names of settings that are made larger and smaller.
        objective: What to make large; NaN counts as the worst.

    Returns:
        The best trial; of equals, the first.
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
    """The parameters with one larger or smaller; whole numbers by at least 1, and none below 1."""
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
        tallies += evaluate_frames(found, truth, frame.calibration, eval_config)
    return tallies
