"""What the report must show: each goal with its figure, reached or missed."""

import math
from collections.abc import Mapping, Sequence
from itertools import product
from typing import NamedTuple

from benchmarks.paper.floor import PIXELS
from benchmarks.paper.hard import ERRORS, FAMILIES
from benchmarks.paper.lab import Lab
from benchmarks.paper.plan import DISTANCES_M, LIGHTS
from benchmarks.paper.rivals import against, beating
from benchmarks.paper.section import Figure, Section, percent
from benchmarks.paper.systems import OURS
from benchmarks.scores.bootstrap import Interval

ROLLED = ("roll-2", "roll+2")
DEEP = tuple(product((10, 15, 20, 40), (1.0, 1.5, 2.0)))
"""Steps down: depth [cm] and distance [m], of :mod:`benchmarks.paper.case_list`."""
LEVEL = ("any", "polished")
"""Floors without a step down, likewise."""
BRIGHT = ("strong", "normal", "weaker")
FLOORS = {"tf": "the mount known", "estimate": "no mount known"}
"""What is known of the floor, as :data:`benchmarks.paper.floor.SOURCES`."""
KEPT = {"floor": ("<=", 0.003), "obstacle": (">=", 0.98)}
"""Largest share of the floor kept and least of obstacles, in the worst pose."""
MOST = 20
"""Rows of the table of differences."""
Figures = Mapping[str, Figure]


class Goal(NamedTuple):
    """A goal and what came of it."""

    key: str
    text: str
    shown: str = ""
    """The figure as text."""
    reached: bool | None = None
    """None: not measured in this run."""

    @property
    def verdict(self) -> str:
        """In words."""
        return {True: "reached", False: "MISSED", None: "not run"}[self.reached]


def run(lab: Lab) -> Section:
    """The list of goals; those whose experiment was not asked for are 'not run'."""
    section = Section("goals", "Goals: reached and missed")
    figures = {figure.key: figure for one in lab.sections.values() for figure in one.figures}
    seeds = "rehearsal" if lab.rehearsal else "test"
    section.say(
        f"All on the {seeds} seeds and on simulated scenes. A goal on several cells is judged by "
        "its worst cell, an accuracy by the 90th percentile of the errors."
    )
    found = against(lab) if "table2" in lab.sections else []
    goals = [Goal(*one) for one in beating(found)] + goals_of(figures)
    rows = [[goal.text, goal.shown, goal.verdict] for goal in goals]
    section.table(["Goal", "Figure [95 % interval]", ""], rows)
    for goal in goals:
        value = math.nan if goal.reached is None else float(goal.reached)
        section.add(goal.key, value, "reached", "higher")
    for one in found:
        key = f"difference.{one.condition}.{one.rival}.{one.figure}"
        section.add(key, one.value, "", "higher", one.interval)
    not_above = [one for one in found if one.interval.low <= 0]
    if not_above:
        shown = sorted(not_above, key=lambda one: one.value)
        rows = [[d.condition, d.rival, d.figure, _signed(d.value, d.interval)] for d in shown]
        header = ["Condition", "Baseline", "Figure", "Ours less the baseline"]
        caption = f"{len(rows)} of {len(found)} differences have an interval that is not above zero"
        caption += f"; the least {min(len(rows), MOST)} (all are in the JSON file)"
        section.table(header, rows[:MOST], caption)
    return section


def goals_of(figures: Figures) -> list[Goal]:
    """All goals but those on the baselines, from the figures of the experiments."""
    near, hard, cases = f"table4.{OURS}", f"hard.{OURS}", f"cases.{OURS}"
    lights = [f"fig12.{OURS}.{light}.accuracy" for light in LIGHTS]
    families = [f"{hard}.{name}.{error:g}.accuracy" for name in FAMILIES for error in ERRORS]
    off = [f"mounts.{OURS}.{name}.accuracy" for name in ("pitch-2", "pitch+2", *ROLLED)]
    steps = [f"{cases}.drop.{deep}cm.{far:g}m.reported" for deep, far in DEEP]
    level = [f"{cases}.no_drop.{name}.none_reported" for name in LEVEL]
    persons = [f"{cases}.wall.person.10cm.{far:g}m.found" for far in (2.5, 3.5)]
    covered = [f"coverage.{OURS}.all.coverage"]
    least = [
        ("acc.all", "ACC >= 90 % over all", [f"table2.{OURS}.accuracy"], 0.90),
        ("acc.lights", "ACC >= 95 % in every light", lights, 0.95),
        ("acc.hard", "ACC >= 90 % in every harder family, both cameras", families, 0.90),
        ("acc.mount", "ACC >= 93 % with a pitch or roll told 2° wrong", off, 0.93),
        ("coverage", "footprint coverage of what is found >= 98.5 % to 3 m", covered, 0.985),
        ("success.3m", "success >= 95 % at 3 m, normal light", [f"{near}.normal.3m"], 0.95),
        ("drops", "steps of 10 cm and more down within 2 m reported there", steps, 1.0),
        ("no_drops", "no step down reported on level floors, as a D435", level, 1.0),
        ("low", "box of 15x15x10 cm at 3 m found", [f"{cases}.low.15x15x10.3m.found"], 1.0),
        ("gap", "boxes 10 cm apart at 2 m told apart", [f"{cases}.gap.10cm.2m.found"], 1.0),
        ("wall", "person 10 cm before a wall apart from it", persons, 1.0),
    ]
    for light in (*BRIGHT, "dim"):
        reach = 1.25 if light == "dim" else 2.0
        keys = [f"{near}.{light}.{d:g}m" for d in DISTANCES_M if d <= reach]
        text = f"success 100 % within {reach:g} m, {light} light"
        least.append((f"success.{light}", text, keys, 1.0))
    goals = [_least(key, text, figures, keys, bound) for key, text, keys, bound in least]
    for name in ("width", "position"):
        goals += [_cylinder(figures, name, *pair) for pair in ((3.0, 0.02), (1.5, 0.01))]
    for key, text, bound in (
        ("claimed", "free floor claimed <= 1 % over all harder scenes", 0.01),
        ("claimed_worst", "free floor claimed <= 5 % in the worst frame", 0.05),
    ):
        goals.append(_most(key, text, figures, f"{hard}.all.{key}", bound))
    for slope, ramp in (("level", "level floor"), ("all", "ramps to 4° too")):
        for source, known in FLOORS.items():
            tail = f"pitch to 25°, roll to 12°, {ramp}; {known}"
            for part, (sign, bound) in KEPT.items():
                text = f"{part} kept {sign} {100 * bound:g} % (smeared pixels left out), {tail}"
                goals.append(_floor(figures, source, slope, part, text))
    return goals


def _known(figures: Figures, keys: Sequence[str]) -> list[Figure] | None:
    """The figures of these keys; None where one was not measured."""
    found = [figures[key] for key in keys if key in figures]
    whole = bool(found) and len(found) == len(keys) and not any(math.isnan(f.value) for f in found)
    return found if whole else None


def _least(key: str, text: str, figures: Figures, keys: Sequence[str], bound: float) -> Goal:
    """Every one of the figures is at least the bound."""
    found = _known(figures, keys)
    if found is None:
        return Goal(key, text)
    worst = min(found, key=lambda figure: figure.value)
    shown = percent(worst.value, Interval(worst.low, worst.high))
    where = worst.key.split(".", 2)[-1].removesuffix(".accuracy")
    shown += f" at {where}" if len(keys) > 1 else ""
    return Goal(key, text, shown, worst.value >= bound)


def _most(key: str, text: str, figures: Figures, name: str, bound: float) -> Goal:
    """The figure is at most the bound."""
    found = _known(figures, [name])
    if found is None:
        return Goal(key, text)
    value = found[0].value
    return Goal(key, text, percent(value, digits=2), value <= bound)


def _cylinder(figures: Figures, name: str, reach: float, bound: float) -> Goal:
    """The 90th percentile is within the bound at every distance, normal light."""
    key = f"cylinder.{name}.{reach:g}m"
    text = f"cylinder's {name} within {100 * bound:g} cm up to {reach:g} m, normal light"
    distances = [d for d in DISTANCES_M if d <= reach]
    stems = [f"fig14.normal.{d:g}m.{name}" for d in distances]
    high = _known(figures, [f"{stem}.p90" for stem in stems])
    middle = _known(figures, [f"{stem}.median" for stem in stems])
    if high is None or middle is None:
        return Goal(key, text)
    worst, half = max(f.value for f in high), max(f.value for f in middle)
    at = distances[[f.value for f in high].index(worst)]
    shown = f"90th percentile {_cm(worst)} at {at:g} m, largest median {_cm(half)}"
    return Goal(key, text, shown, worst <= bound)


def _floor(figures: Figures, source: str, slope: str, part: str, text: str) -> Goal:
    """The worst pose is within the bound."""
    key = f"{part}.{slope}.{source}"
    stem, name = f"floor.{source}.{slope}", f"{part}_kept"
    found = _known(figures, [f"{stem}.{name}", f"{stem}.worst.{name}"])
    if found is None:
        return Goal(key, text)
    mean, worst = (figure.value for figure in found)
    shown = f"{percent(mean, Interval(found[0].low, found[0].high), 2)}, worst pose "
    shown += percent(worst, digits=2)
    stem = f"floor.{source}{PIXELS}.{slope}"
    if pixels := _known(figures, [f"{stem}.{name}", f"{stem}.worst.{name}"]):
        shares = (percent(figure.value, digits=2) for figure in pixels)
        shown += " (all pixels: {}, worst pose {})".format(*shares)
    _, bound = KEPT[part]
    return Goal(key, text, shown, worst <= bound if part == "floor" else worst >= bound)


def _cm(metres: float) -> str:
    return f"{100 * metres:.2f} cm" if math.isfinite(metres) else "infinite (not found)"


def _signed(value: float, interval: Interval) -> str:
    return f"{value:+.3f} [{interval.low:+.3f}, {interval.high:+.3f}]"
