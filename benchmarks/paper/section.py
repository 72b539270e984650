"""What an experiment returns: text, tables, pictures, and the figures for the JSON file."""

import math
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np

from benchmarks.scores.bootstrap import Interval

Direction = Literal["higher", "lower", "info"]


class Figure(NamedTuple):
    """One number."""

    key: str
    value: float
    unit: str
    direction: Direction
    """Which way is better."""
    low: float = math.nan
    """Lower end of its 95 % interval."""
    high: float = math.nan
    paper: float | str | None = None
    """What the paper has."""

    def to_dict(self) -> dict[str, float | str | None]:
        """As JSON has it: no NaN."""
        return {k: plain(v) for k, v in self._asdict().items()}


class Text(NamedTuple):
    """A paragraph."""

    text: str


class Table(NamedTuple):
    """A table of texts."""

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    caption: str = ""


class Picture(NamedTuple):
    """A plot or a photograph."""

    name: str
    """For its file."""
    png: bytes
    caption: str


Block = Text | Table | Picture


@dataclass
class Section:
    """An experiment's part of the report."""

    name: str
    title: str
    blocks: list[Block] = field(default_factory=list)
    figures: list[Figure] = field(default_factory=list)

    def say(self, text: str) -> None:
        """Adds a paragraph."""
        self.blocks.append(Text(text))

    def table(self, header: list[str], rows: list[list[str]], caption: str = "") -> None:
        """Adds a table."""
        self.blocks.append(Table(tuple(header), tuple(map(tuple, rows)), caption))

    def picture(self, name: str, png: bytes, caption: str) -> None:
        """Adds a picture."""
        self.blocks.append(Picture(f"{self.name}_{name}", png, caption))

    def add(
        self,
        key: str,
        value: float,
        unit: str,
        direction: Direction,
        interval: Interval | None = None,
        paper: float | str | None = None,
    ) -> None:
        """Adds a figure under the section's name."""
        ends = interval or Interval(math.nan, math.nan)
        self.figures.append(
            Figure(f"{self.name}.{key}", value, unit, direction, *ends, paper=paper)
        )


def plain(value: float | str | None) -> float | str | None:
    """A value without NaN and infinities, rounded for reading."""
    if not isinstance(value, float | np.floating):
        return value
    return float(f"{value:.6g}") if math.isfinite(value) else None


def percent(value: float, interval: Interval | None = None, digits: int = 1) -> str:
    """``91.2 % [88.0, 94.1]``."""
    if math.isnan(value):
        return "-"
    text = f"{100 * value:.{digits}f} %"
    if interval is None or math.isnan(interval.low):
        return text
    return f"{text} [{100 * interval.low:.{digits}f}, {100 * interval.high:.{digits}f}]"


def number(value: float, interval: Interval | None = None, digits: int = 3) -> str:
    """``0.912 [0.880, 0.941]``."""
    if math.isnan(value):
        return "-"
    text = f"{value:.{digits}f}"
    if interval is None or math.isnan(interval.low):
        return text
    return f"{text} [{interval.low:.{digits}f}, {interval.high:.{digits}f}]"


def wilson(hits: int, trials: int, z: float = 1.959964) -> Interval:
    """Wilson's 95 % interval of a share; it does not shrink to a point at 0 and 100 %.

    Wilson, Journal of the American Statistical Association 22 (1927), 209-212.
    """
    if not trials:
        return Interval(math.nan, math.nan)
    p, n = hits / trials, trials
    middle = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    return Interval(max(middle - half, 0.0), min(middle + half, 1.0))


def bootstrap(values: np.ndarray, quantile: float, resamples: int = 1000) -> Interval:
    """The 95 % percentile interval of a quantile of independent values."""
    if not len(values):
        return Interval(math.nan, math.nan)
    drawn = np.random.default_rng(0).integers(0, len(values), (resamples, len(values)))
    sampled = np.sort(np.quantile(values[drawn], quantile, axis=1, method="higher"))
    low, high = np.quantile(sampled, [0.025, 0.975], method="nearest").tolist()
    return Interval(low, high)
