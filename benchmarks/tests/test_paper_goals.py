"""The report's goals by hand-made figures: which are reached and which are missed."""

import math

import pytest

pytest.importorskip("matplotlib")

from benchmarks.paper import case_list, floor, goals, hard, mounts, plan, rivals
from benchmarks.paper.measure import Difference, differences
from benchmarks.paper.section import Figure
from benchmarks.paper.systems import OURS
from benchmarks.scores.bootstrap import Interval
from jaxdet.eval import Tally


def figure(key, value, low=math.nan, high=math.nan):
    return Figure(key, value, "", "higher", low, high)


def all_figures(value=1.0):
    """Figures that reach every goal."""
    keys = [f"coverage.{OURS}.all.coverage", f"table2.{OURS}.accuracy"]
    keys += [f"fig12.{OURS}.{light}.accuracy" for light in plan.LIGHTS]
    distances = (3.0, 2.5, 2.0, 1.5, 1.25, 1.0)
    lights = ("strong", "normal", "weaker", "dim")
    keys += [f"table4.{OURS}.{i}.{d:g}m" for i in lights for d in distances]
    keys += [
        f"hard.{OURS}.{family}.{error:g}.accuracy"
        for family in hard.FAMILIES
        for error in hard.ERRORS
    ]
    keys += [f"mounts.{OURS}.{mount.name}.accuracy" for mount in mounts.MOUNTS]
    for case in case_list.CASES.values():
        end = {"drop": "reported", "level": "none_reported", "claimed": "claimed"}
        keys.append(f"cases.{OURS}.{case.key}.{end.get(case.asked, 'found')}")
    figures = {key: figure(key, value, value - 0.01, value) for key in keys}
    for name in ("claimed", "claimed_worst"):
        key = f"hard.{OURS}.all.{name}"
        figures[key] = figure(key, 0.005)
    for d in distances:
        for name in ("width", "position"):
            for part in ("median", "p90"):
                key = f"fig14.normal.{d:g}m.{name}.{part}"
                figures[key] = figure(key, 0.009 if d <= 1.5 else 0.019)
    for slope in ("level", "all"):
        for part, good in (("floor_kept", 0.003), ("obstacle_kept", 0.98)):
            for source in floor.SOURCES:
                for stem in (f"floor.{source}.{slope}", f"floor.{source}.{slope}.worst"):
                    figures[f"{stem}.{part}"] = figure(f"{stem}.{part}", good)
    return figures


def test_goals_reached():
    found = goals.goals_of(all_figures())
    assert {goal.verdict for goal in found} == {"reached"}
    assert len({goal.key for goal in found}) == len(found)


@pytest.mark.parametrize(
    ("key", "value", "missed"),
    [
        (f"table2.{OURS}.accuracy", 0.8999, "acc.all"),
        (f"fig12.{OURS}.strong.accuracy", 0.9499, "acc.lights"),
        (f"fig12.{OURS}.dim.accuracy", 0.9499, "acc.lights"),
        (f"hard.{OURS}.ramps.1.accuracy", 0.89, "acc.hard"),
        (f"mounts.{OURS}.roll+2.accuracy", 0.92, "acc.mount"),
        (f"table4.{OURS}.weaker.1.25m", 0.99, "success.weaker"),
        (f"table4.{OURS}.dim.1.25m", 0.95, "success.dim"),
        (f"table4.{OURS}.normal.3m", 0.94, "success.3m"),
        ("fig14.normal.2.5m.width.p90", 0.0201, "cylinder.width.3m"),
        ("fig14.normal.1m.position.p90", 0.0101, "cylinder.position.1.5m"),
        (f"coverage.{OURS}.all.coverage", 0.984, "coverage"),
        (f"cases.{OURS}.drop.10cm.1.5m.reported", 0.75, "drops"),
        (f"cases.{OURS}.no_drop.polished.none_reported", 0.75, "no_drops"),
        (f"cases.{OURS}.low.15x15x10.3m.found", 0.75, "low"),
        (f"cases.{OURS}.gap.10cm.2m.found", 0.9, "gap"),
        (f"cases.{OURS}.wall.person.10cm.3.5m.found", 0.5, "wall"),
        (f"hard.{OURS}.all.claimed", 0.011, "claimed"),
        (f"hard.{OURS}.all.claimed_worst", 0.051, "claimed_worst"),
        ("floor.tf.level.worst.floor_kept", 0.0031, "floor.level.tf"),
        ("floor.estimate.all.worst.obstacle_kept", 0.979, "obstacle.all.estimate"),
    ],
)
def test_one_goal_missed(key, value, missed):
    figures = all_figures()
    assert key in figures
    figures[key] = figures[key]._replace(value=value)
    verdicts = {goal.key: goal.verdict for goal in goals.goals_of(figures)}
    assert [name for name, verdict in verdicts.items() if verdict == "MISSED"] == [missed]


def test_what_is_no_goal_is_not_judged():
    figures = all_figures()
    shallow, far = (f"cases.{OURS}.drop.{k}.reported" for k in ("5cm.1m", "20cm.2.5m"))
    others = f"table4.{OURS}.dim.1.5m", f"table4.{OURS}.strong.2.5m"
    for key in (shallow, far, *others):
        assert key in figures
        figures[key] = figures[key]._replace(value=0.0)
    assert {goal.verdict for goal in goals.goals_of(figures)} == {"reached"}


def test_goals_without_figures_are_not_run():
    found = goals.goals_of({})
    assert {goal.verdict for goal in found} == {"not run"}
    assert {v[3] for v in rivals.beating([])} == {None}


def test_beating():
    wide, above = Interval(-0.1, 0.2), Interval(0.01, 0.2)
    found = [Difference("dim", "rsc", name, 0.1, above) for name in rivals.FIGURES]
    assert all(verdict[3] for verdict in rivals.beating(found))
    unsure = [*found, Difference("dim", "dbscan", "f1", 0.05, wide)]
    verdicts = {verdict[0]: verdict[3] for verdict in rivals.beating(unsure)}
    assert verdicts["beats.f1"] is True and verdicts["beats.f1.sure"] is False
    worse = [*found, Difference("dim", "dbscan", "f1", 0.0, wide)]
    assert {v[0]: v[3] for v in rivals.beating(worse)}["beats.f1"] is False


def test_differences():
    ours = [Tally(visible=4, found=4)] * 5
    theirs = [Tally(visible=4, found=2, false=1)] * 5
    (one,) = differences("dim", "rsc", ours, theirs, ["accuracy"])
    assert one.value == pytest.approx(1 - 2 / 5)
    assert one.interval == pytest.approx((0.6, 0.6))
