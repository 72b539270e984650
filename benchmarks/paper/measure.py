"""Figures with intervals from tallies."""

from collections.abc import Sequence
from typing import NamedTuple

from benchmarks.scores.bootstrap import Interval, intervals
from jaxdet.eval import Score, Tally, score


class Measured(NamedTuple):
    """A score and the intervals of its shares and indices."""

    score: Score
    intervals: dict[str, Interval]

    def value(self, name: str) -> float:
        """A figure by its name."""
        return float(getattr(self.score, name))


def bare(tallies: Sequence[Tally]) -> list[Tally]:
    """Without the single cases, which shares don't need and which make intervals slow."""
    return [tally._replace(cases=()) for tally in tallies]


def measured(tallies: Sequence[Tally]) -> Measured:
    """The figures of some units."""
    units = bare(tallies)
    return Measured(score(units), intervals(units))
