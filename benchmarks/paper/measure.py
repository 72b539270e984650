"""Figures with intervals from tallies."""

from collections.abc import Sequence
from typing import NamedTuple

from benchmarks.scores.bootstrap import Interval, intervals
from jaxdet.eval import Score, Tally, score


class Measured(NamedTuple):
    """Score, and the intervals of its rates and indices."""

    score: Score
    intervals: dict[str, Interval]

    def value(self, name: str) -> float:
        """Return a figure by its name."""
        return float(getattr(self.score, name))


def bare(tallies: Sequence[Tally]) -> list[Tally]:
    """Return tallies without their cases, which rates don't need and which make intervals slow."""
    return [tally._replace(cases=()) for tally in tallies]


def measured(tallies: Sequence[Tally]) -> Measured:
    """Return the figures of some independent units, such as scenes."""
    units = bare(tallies)
    return Measured(score(units), intervals(units))
