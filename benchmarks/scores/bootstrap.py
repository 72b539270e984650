"""Intervals by resampling frames or scenes with replacement.

Efron, The Annals of Statistics 7 (1979), 1-26; percentile intervals. Frames of one scene are
alike: give one tally a scene (:func:`jaxdet.eval.total` of its frames) where the claim is about
new scenes.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxdet.eval.score import case_table, errors, rates
from jaxdet.eval.tally import Tally

RESAMPLES = 1000


class Interval(NamedTuple):
    """Where a figure lies with the given confidence; NaN where it can't be said."""

    low: float
    high: float


def intervals(
    tallies: Sequence[Tally], level: float = 0.95, resamples: int = RESAMPLES, seed: int = 0
) -> dict[str, Interval]:
    """Percentile intervals of all figures of a score.

    Args:
        tallies: One for each unit that is drawn, a frame or a scene.
        level: Share of the resampled figures between the two ends.
        resamples: How many times as many units are drawn with replacement.
        seed: Of the drawing.

    Returns:
        By the name of the figure in :class:`jaxdet.eval.Score`. Resamples in which a figure is
        NaN are left out.
    """
    figures = resampled(tallies, resamples, seed)
    return {name: _interval(values, level) for name, values in figures.items()}


def resampled(tallies: Sequence[Tally], resamples: int, seed: int) -> dict[str, np.ndarray]:
    """All figures of ``resamples`` draws, by name, each ``(resamples,)`` float64."""
    if not tallies:
        return {}
    units = len(tallies)
    drawn = np.random.default_rng(seed).integers(0, units, (resamples, units))
    counts = np.array([tally.counts for tally in tallies], np.float64)
    figures = rates(counts[drawn].sum(axis=1))
    owner = np.repeat(np.arange(units), [len(tally.cases) for tally in tallies])
    table = case_table([case for tally in tallies for case in tally.cases])
    rows = [
        errors(np.repeat(table, np.bincount(draw, minlength=units)[owner], axis=0))
        for draw in drawn
    ]
    return figures | {name: np.array([row[name] for row in rows]) for name in rows[0]}


def _interval(values: np.ndarray, level: float) -> Interval:
    values = values[~np.isnan(values)]
    if not len(values):
        return Interval(float("nan"), float("nan"))
    low, high = np.quantile(values, [(1 - level) / 2, (1 + level) / 2]).tolist()
    return Interval(low, high)
