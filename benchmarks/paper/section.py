"""Section of the report: text, tables, pictures, and the figures for the JSON file."""

import math
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np

from benchmarks.scores.bootstrap import Interval

Direction = Literal["higher", "lower", "info"]


class Figure(NamedTuple):
    """Figure of the report."""

    key: str
    value: float
    unit: str
    direction: Direction
    """Whether higher or lower values are better; ``info`` for neither."""
    low: float = math.nan
    """Lower end of the 95 % interval."""
    high: float = math.nan
    """Upper end of the 95 % interval."""
    paper: float | str | None = None
    """Value in the paper."""

    def to_dict(self) -> dict[str, float | str | None]:
        """Return the values for JSON, None for NaN."""
        return {k: plain(v) for k, v in self._asdict().items()}


class Text(NamedTuple):
    """Paragraph."""

    text: str


class Table(NamedTuple):
    """Table of texts."""

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    caption: str = ""


class Picture(NamedTuple):
    """Plot or image."""

    name: str
    """Name of its file, without the extension."""
    png: bytes
    caption: str


Block = Text | Table | Picture


@dataclass
class Section:
    """Section of an experiment."""

    name: str
    title: str
    blocks: list[Block] = field(default_factory=list)
    figures: list[Figure] = field(default_factory=list)

    def say(self, text: str) -> None:
        """Add a paragraph."""
        self.blocks.append(Text(text))

    def table(self, header: list[str], rows: list[list[str]], caption: str = "") -> None:
        """Add a table."""
        self.blocks.append(Table(tuple(header), tuple(map(tuple, rows)), caption))

    def picture(self, name: str, png: bytes, caption: str) -> None:
        """Add a picture."""
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
        """Add a figure; its key is prefixed by the name of the section."""
        ends = interval or Interval(math.nan, math.nan)
        self.figures.append(
            Figure(f"{self.name}.{key}", value, unit, direction, *ends, paper=paper)
        )


def plain(value: float | str | None) -> float | str | None:
    """Return a value rounded to six digits, None for NaN and infinity."""
    if not isinstance(value, float | np.floating):
        return value
    return float(f"{value:.6g}") if math.isfinite(value) else None


def percent(value: float, interval: Interval | None = None, digits: int = 1) -> str:
    """Return a share as ``91.2 % [88.0, 94.1]``."""
    if math.isnan(value):
        return "-"
    text = f"{100 * value:.{digits}f} %"
    if interval is None or math.isnan(interval.low):
        return text
    return f"{text} [{100 * interval.low:.{digits}f}, {100 * interval.high:.{digits}f}]"


def number(value: float, interval: Interval | None = None, digits: int = 3) -> str:
    """Return a number as ``0.912 [0.880, 0.941]``."""
    if math.isnan(value):
        return "-"
    text = f"{value:.{digits}f}"
    if interval is None or math.isnan(interval.low):
        return text
    return f"{text} [{interval.low:.{digits}f}, {interval.high:.{digits}f}]"


def wilson(hits: int, trials: int, z: float = 1.959964) -> Interval:
    """Return the Wilson score interval (95 %) of a success rate.

    It has a width at 0 and 100 %, too.

    Wilson, Journal of the American Statistical Association 22 (1927), 209-212.
    """
    if not trials:
        return Interval(math.nan, math.nan)
    p, n = hits / trials, trials
    middle = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    return Interval(max(middle - half, 0.0), min(middle + half, 1.0))


def bootstrap(values: np.ndarray, quantile: float, resamples: int = 1000) -> Interval:
    """Return the 95 % bootstrap percentile interval of a quantile of independent values."""
    if not len(values):
        return Interval(math.nan, math.nan)
    drawn = np.random.default_rng(0).integers(0, len(values), (resamples, len(values)))
    sampled = np.sort(np.quantile(values[drawn], quantile, axis=1, method="higher"))
    low, high = np.quantile(sampled, [0.025, 0.975], method="nearest").tolist()
    return Interval(low, high)
