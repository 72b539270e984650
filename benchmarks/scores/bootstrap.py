"""Percentile intervals by resampling frames or scenes with replacement.

Efron, The Annals of Statistics 7 (1979), 1-26. The frames of a scene are not independent: for
statements about new scenes, pass one tally per scene (:func:`jaxdet.eval.total` of its frames).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxdet.eval.score import case_table, errors, rates
from jaxdet.eval.tally import Tally

RESAMPLES = 1000


class Interval(NamedTuple):
    """Ends of the confidence interval of a figure; NaN if it can't be computed."""

    low: float
    high: float


def intervals(
    tallies: Sequence[Tally], level: float = 0.95, resamples: int = RESAMPLES, seed: int = 0
) -> dict[str, Interval]:
    """Compute the percentile intervals of all figures of a score.

    Args:
        tallies: Tally of each unit that is drawn, a frame or a scene.
        level: Fraction of the resampled figures between the two ends.
        resamples: Number of resamples, each with as many units as there are tallies.
        seed: Seed of the resampling.

    Returns:
        Intervals by the name of the figure in :class:`jaxdet.eval.Score`. Resamples in which a
        figure is NaN are left out.
    """
    figures = resampled(tallies, resamples, seed)
    return {name: _interval(values, level) for name, values in figures.items()}


def resampled(tallies: Sequence[Tally], resamples: int, seed: int) -> dict[str, np.ndarray]:
    """Return all figures of the resamples, by name, each ``(resamples,)`` float64."""
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
