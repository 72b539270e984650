"""Findings of the paper, with the figures of the run and a verdict."""

import math
from collections.abc import Callable, Iterable
from itertools import pairwise
from typing import NamedTuple

from benchmarks.paper.lab import Lab
from benchmarks.paper.plan import CANNY_BOUNDS, DISTANCES_M, LIGHTS, SCENES
from benchmarks.paper.section import Figure, Section, number, percent
from benchmarks.paper.section6 import GAPS_M
from benchmarks.paper.systems import PAPER, RULE
from benchmarks.scores.bootstrap import Interval
from jaxdet.presets import preset

WARD, DEFAULTS, RSC = "hierarchical_ward", "hierarchical_default", "rsc"
INACCURACY_M = 0.02
"""Error that the paper states [m]."""


class Finding(NamedTuple):
    """Finding of the paper, and the result of the run."""

    key: str
    place: str
    text: str
    shown: str = ""
    """Figures of the run."""
    holds: bool | None = None
    """Whether the finding is confirmed; None if the run has no figures for it."""

    @property
    def verdict(self) -> str:
        """The verdict in words."""
        return {True: "yes", False: "NO", None: "not run"}[self.holds]


class Figures:
    """Figures of a run by their keys.

    Args:
        figures: Figures of all sections.
    """

    def __init__(self, figures: Iterable[Figure]) -> None:
        self._figures = {figure.key: figure for figure in figures}

    def __getitem__(self, key: str) -> Figure:
        """Return a figure.

        Raises:
            KeyError: The run does not have it.
        """
        figure = self._figures[key]
        if math.isnan(figure.value):
            raise KeyError(key)
        return figure

    def value(self, key: str) -> float:
        """Return the value of a figure."""
        return self[key].value

    def text(self, key: str) -> str:
        """Return a share with its interval: an FMI as a number, others in percent."""
        figure = self[key]
        show = number if key.endswith("fmi") else percent
        return show(figure.value, Interval(figure.low, figure.high))

    def reaches(self, key: str, bound: float) -> bool:
        """Return whether a share or the upper end of its interval is at least a bound."""
        return self[key].value >= bound or self[key].high >= bound


def run(lab: Lab) -> Section:
    """List the findings of the paper; without their experiment they are 'not run'."""
    section = Section("findings", "Findings of the paper: which hold in this run")
    section.say(
        "The preset is the complete method of the paper on its own corners; the rule is its "
        "Section 3.4 alone, on the same points as RSC and the traditional method. A level is "
        "confirmed if the 95 % interval reaches it, an order if the values have this order. For "
        "orders of ACC and FMI, obstacles are joined as the paper defines them. `jaxdet help "
        "paper` (jaxdet/help/paper.md) has a verdict on every statement of the paper, with reasons."
    )
    figures = Figures(figure for one in lab.sections.values() for figure in one.figures)
    found = findings_of(figures)
    rows = [[one.place, one.text, one.shown, one.verdict] for one in found]
    section.table(["Place", "Finding", "Here", "Holds"], rows)
    for one in found:
        value = math.nan if one.holds is None else float(one.holds)
        section.add(one.key, value, "holds", "info")
    return section


def findings_of(figures: Figures) -> list[Finding]:
    """Return all findings, judged by the figures of a run."""
    found = []
    for key, place, text, judge in FINDINGS:
        try:
            found.append(Finding(key, place, text, *judge(figures)))
        except KeyError:
            found.append(Finding(key, place, text))
    return found


Judged = tuple[str, bool]
Judge = Callable[[Figures], Judged]


def _level(key: str, bound: float) -> Judge:
    """Judge whether a share reaches a bound."""
    return lambda f: (f.text(key), f.reaches(key, bound))


def _above(rival: str, figure: str = "accuracy") -> Judge:
    """Judge whether the rule is above a rival if obstacles are joined as the paper defines them."""
    kinds = {"": "every object", "joined.": "joined", "negatives.": "with negatives"}
    if figure != "accuracy":
        del kinds["negatives."]

    def judge(f: Figures) -> Judged:
        keys = {kind: [f"table2.{name}.{kind}{figure}" for name in (RULE, rival)] for kind in kinds}
        shown = [
            f"{kinds[k]} {f.text(own)} and {f.text(other)}" for k, (own, other) in keys.items()
        ]
        own, other = (f.value(key) for key in keys["joined."])
        return "; ".join(shown), own > other

    return judge


def _light(f: Figures) -> Judged:
    keys = {light: f"fig12.{PAPER}.{light}.accuracy" for light in LIGHTS}
    values = {light: f.value(key) for light, key in keys.items()}
    order = sorted(values, key=lambda light: values[light])
    shown = ", ".join(f"{light} {f.text(key)}" for light, key in keys.items())
    return shown, order[0] == "dim" and order[-1] == "normal"


def _indices(rival: str) -> Judge:
    """Judge whether the rule's SC is at most 0.05 below a rival's in most scenes."""

    def judge(f: Figures) -> Judged:
        pairs = [
            tuple(f.value(f"table1.{name}.{scene}.silhouette") for name in (RULE, rival))
            for scene in SCENES
        ]
        shown = ", ".join(f"{number(a, digits=2)} and {number(b, digits=2)}" for a, b in pairs)
        return f"SC by scene: {shown}", sum(a >= b - 0.05 for a, b in pairs) > len(pairs) / 2

    return judge


def _ratio(rival: str, bound: float) -> Judge:
    def judge(f: Figures) -> Judged:
        one = f[f"fig11.{rival}.ratio"]
        return f"{one.value:.0f} times [{one.low:.0f}, {one.high:.0f}]", one.value >= bound

    return judge


def _near(f: Figures) -> Judged:
    keys = [f"table4.{PAPER}.{light}.{DISTANCES_M[-1]:g}m" for light in LIGHTS]
    shown = ", ".join(f"{light} {f.text(key)}" for light, key in zip(LIGHTS, keys, strict=True))
    return shown, all(f.value(key) == 1 for key in keys)


def _approached(f: Figures) -> Judged:
    values = [[f.value(f"table4.{PAPER}.{light}.{d:g}m") for d in DISTANCES_M] for light in LIGHTS]
    falls = sum(far > near for row in values for far, near in pairwise(row))
    ends = [(row[0], row[-1]) for row in values]
    shown = ", ".join(
        f"{percent(far, digits=0)} to {percent(near, digits=0)}" for far, near in ends
    )
    return f"3 m to 1 m by light: {shown}", not falls and any(far < near for far, near in ends)


def _cylinder(f: Figures) -> Judged:
    errors = [f.value(f"fig14.{PAPER}.normal.{d:g}m.position.median") for d in DISTANCES_M]
    shown = ", ".join(f"{100 * e:.1f}" for e in errors)
    return f"3 m to 1 m: {shown} cm", max(errors) <= INACCURACY_M


def _bounds(f: Figures) -> Judged:
    times = [f.value(f"table5.{low}-{high}.reference") for low, high in CANNY_BOUNDS]
    return ", ".join(f"{ms:.0f} ms" for ms in times), all(a > b for a, b in pairwise(times))


def _success(f: Figures) -> Judged:
    found = [f.value(f"table5.{low}-{high}.accuracy") for low, high in CANNY_BOUNDS]
    return ", ".join(percent(value) for value in found), min(found) >= found[0] - 0.02


def _edges(f: Figures) -> Judged:
    shown, better = [], []
    for part in ("inside", "contour"):
        without, on_edges = (f.value(f"fig2.{name}.{part}") for name in ("without", "with"))
        shown.append(f"{part} {percent(without)} to {percent(on_edges)}")
        better.append((on_edges > without) == (part == "contour"))
    return ", ".join(shown), all(better)


def _gaps(f: Figures) -> Judged:
    splits, merges = (
        [f.value(f"section6.gap.{gap:g}m.{name}") for gap in GAPS_M]
        for name in ("splits", "merges")
    )
    shown = ", ".join(f"{a:.0f} and {b:.0f}" for a, b in zip(splits, merges, strict=True))
    holds = splits[0] > splits[-1] and merges[0] < merges[-1]
    return f"splits and merges, {GAPS_M[0]:g} to {GAPS_M[-1]:g} m: {shown}", holds


def _dim_corners(f: Figures) -> Judged:
    low, high = CANNY_BOUNDS[0]
    normal, dim = (f.value(f"section6.canny.{low}-{high}.{i}.corners") for i in ("normal", "dim"))
    return f"{normal:.0f} and {dim:.0f} with thresholds {low} and {high}", dim < normal


def _small_gap(f: Figures) -> Judged:
    small, chosen = (
        f.value(f"section6.gap.{gap:g}m.dim.accuracy")
        for gap in (GAPS_M[0], preset("paper").cluster.gaps_m[0])
    )
    return f"ACC in dim light {percent(small)} and {percent(chosen)}", small < chosen


FINDINGS: tuple[tuple[str, str, str, Judge], ...] = (
    ("acc", "Abstract", "ACC of 82.41 %", _level(f"table2.{PAPER}.accuracy", 0.8241)),
    (
        "acc.normal",
        "Abstract",
        "ACC of 91.72 % in normal light",
        _level(f"fig12.{PAPER}.normal.accuracy", 0.9172),
    ),
    ("sc.rsc", "Table 1", "SC like RSC's", _indices(RSC)),
    ("sc.ward", "Table 1", "SC better than the traditional method's (ward)", _indices(WARD)),
    ("time.rsc", "Fig. 11", "at least twice as fast as RSC", _ratio(RSC, 2)),
    ("time.ward", "Fig. 11", "4 to 5 times as fast as the traditional method", _ratio(WARD, 4)),
    ("acc.rsc", "Table 2", "ACC 4.13 points above RSC's", _above(RSC)),
    ("acc.ward", "Table 2", "ACC 19.34 points above the traditional method's: ward", _above(WARD)),
    ("acc.defaults", "Table 2", "the same: scikit-learn's defaults", _above(DEFAULTS)),
    ("fmi.rsc", "Table 2", "FMI above RSC's", _above(RSC, "fmi")),
    ("light", "Fig. 12", "best in normal light, worst in dim light", _light),
    ("near", "Table 4", "everything is found at 1 m, in all lights", _near),
    ("approach", "Table 4", "the nearer, the more is found", _approached),
    ("cylinder", "Fig. 14", "error of at most 2 cm within 3 m in normal light", _cylinder),
    ("person", "Fig. 15", "a pedestrian is found", _level(f"fig15.{PAPER}.person.found", 0.9)),
    ("canny.time", "Table 5", "higher Canny thresholds are faster", _bounds),
    ("canny.success", "Table 5", "without affecting the success rate", _success),
    ("gaps", "Section 6", "a small d_z divides objects, a large one joins them", _gaps),
    ("corners.dim", "Section 6", "fewer feature points in dim light", _dim_corners),
    ("gap.dim", "Section 6", "a too small d_z reduces the success rate in dim light", _small_gap),
    ("edges", "Fig. 2", "Canny first: fewer corners inside objects, more on contours", _edges),
)
"""Key, place in the paper, finding, and its judge."""
