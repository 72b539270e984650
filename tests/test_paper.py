"""The report on the paper's experiments: every part with tiny counts, and the goals' logic."""

import json
import math
import sys
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("matplotlib")

from benchmarks.paper import goals, main, paper_figures, plan, realdata, report, rivals, section
from benchmarks.paper.fig14_cylinder import errors_of
from benchmarks.paper.lab import Lab
from benchmarks.paper.measure import Difference, differences
from benchmarks.paper.plan import Counts
from benchmarks.paper.section import Figure
from benchmarks.paper.shots import Shot
from benchmarks.paper.systems import OURS
from benchmarks.paper.table4_distance import run as table4
from jaxdet.eval import Case, Interval, Tally
from jaxdet.sim import SimConfig, write_log

TINY = Counts(
    scenes=1, test_seeds=2, tuning_seeds=1, approach=1, cylinder_seeds=1, floor_seeds=1,
    log_frames=3, timed=2, rounds=1, width=192, worst=2,
)  # fmt: skip
SMALLER = {
    "SCENES": plan.SCENES[1:3],
    "SCENE_TITLES": plan.SCENE_TITLES[1:3],
    "LIGHTS": ("normal", "dim"),
    "DISTANCES_M": plan.DISTANCES_M[:2],
    "CANNY_BOUNDS": plan.CANNY_BOUNDS[:1],
    "PITCHES_DEG": (10.0,),
    "ROLLS_DEG": (0.0,),
    "SLOPES_DEG": (0.0, 4.0),
    "RIVALS": ("hierarchical_ward", "rsc", "dbscan", "range_image"),
}


@pytest.fixture(scope="module")
def smaller():
    """Fewer cells in every experiment."""
    with pytest.MonkeyPatch.context() as patch:
        kept = ("benchmarks.paper.goals", "benchmarks.paper.plan")
        for name, module in [item for item in sys.modules.items() if item[0] not in kept]:
            for constant, value in SMALLER.items():
                if name.startswith("benchmarks.paper.") and hasattr(module, constant):
                    patch.setattr(module, constant, value)
        yield


@pytest.fixture(scope="module")
def lab(smaller, tmp_path_factory):
    made = Lab(TINY, tmp_path_factory.mktemp("frames"))
    made.quiet = True
    return made


@pytest.fixture(scope="module")
def sections(lab):
    return main.run(lab, tuple(main.EXPERIMENTS))


def test_seeds_are_disjoint():
    assert not set(plan.TUNING_SEEDS) & set(plan.TEST_SEEDS)


def test_every_experiment_says_something(sections):
    assert sections[0].name == "goals"
    assert {s.name for s in sections} == set(main.EXPERIMENTS)
    for one in sections:
        assert any(isinstance(block, section.Text) for block in one.blocks), one.name
        for table in (block for block in one.blocks if isinstance(block, section.Table)):
            assert {len(row) for row in table.rows} <= {len(table.header)}, one.name
    pictured = {s.name for s in sections if any(isinstance(b, section.Picture) for b in s.blocks)}
    shown = {"table1", "fig11", "table2", "fig12", "table4", "fig14", "fig15", "fig2"}
    assert shown <= pictured


def test_docstrings_name_the_table_or_figure():
    for name, experiment in main.EXPERIMENTS.items():
        number = name.lstrip("tablefig")
        label = f"Table {number}" if name.startswith("table") else f"Fig. {number}"
        assert experiment.__doc__
        assert not number.isdigit() or label in experiment.__doc__


def test_figures_as_json(sections, tmp_path):
    path = tmp_path / "deep" / "figures.json"
    report.write_json(path, sections, {"Command": "this"})
    data = json.loads(path.read_text(), parse_constant=pytest.fail)
    assert data["run"] == {"Command": "this"}
    rows = data["figures"]
    assert {tuple(row) for row in rows} == {
        ("key", "value", "unit", "direction", "low", "high", "paper")
    }
    keys = [row["key"] for row in rows]
    assert len(keys) == len(set(keys))
    assert {row["direction"] for row in rows} <= {"higher", "lower", "info"}
    by_key = {row["key"]: row for row in rows}
    ours = by_key["table2.ours.accuracy"]
    assert ours["paper"] == 0.8241 and ours["low"] <= ours["value"] <= ours["high"]
    assert by_key["table4.ours.normal.3m"]["paper"] == 0.873
    assert by_key["table1.rsc.roadblocks.davies_bouldin"]["direction"] == "lower"


def test_report_files(sections, tmp_path):
    report.write(tmp_path, "A report", sections, {"Seeds": "1 < 2"})
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "<li>Seeds: 1 &lt; 2</li>" in page
    assert "src='data:image/png;base64," in page and "http" not in page
    text = (tmp_path / "report.md").read_text(encoding="utf-8")
    assert "not run: weights not supplied" in text and "simulated" in text
    for line in text.splitlines():
        if line.startswith("!["):
            assert (tmp_path / line.rpartition("](")[2].rstrip(")")).is_file()


def test_frames_are_drawn_once_and_the_same(lab, smaller):
    spec = lab.test_specs("bucket", "normal")[0]
    path = lab.store.path(spec)
    one = lab.load([spec])[0]
    assert isinstance(one, Shot) and one.height is None
    path.unlink()
    again = lab.load([spec])[0]
    assert np.array_equal(one.color, again.color) and np.array_equal(one.depth, again.depth)


def test_recordings(lab, tmp_path):
    config = SimConfig(scene="single_box", frames=2, width=96, height=72)
    write_log(tmp_path / "one.mcap", config)
    found = realdata.run(lab, tmp_path)
    assert [b.name for b in found.blocks if isinstance(b, section.Picture)] == [
        "recordings0_one_00"
    ]
    empty = tmp_path / "empty"
    empty.mkdir()
    last = realdata.run(lab, empty).blocks[-1]
    assert isinstance(last, section.Text) and "Not read" in last.text


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (main.Options(quick=True, full=True), "not both"),
        (main.Options(only=("table9",)), "table9"),
    ],
)
def test_wrong_options(options, said, capsys):
    assert main.main(options) == 2
    assert said in capsys.readouterr().err


def figure(key, value, low=math.nan, high=math.nan):
    return Figure(key, value, "", "higher", low, high)


def all_figures(value=1.0):
    """Figures that reach every goal."""
    keys = [f"table2.{OURS}.accuracy", f"coverage.{OURS}.all.coverage"]
    keys += [f"fig12.{OURS}.{light}.accuracy" for light in plan.LIGHTS]
    distances = (3.0, 2.5, 2.0, 1.5, 1.25, 1.0)
    lights = ("strong", "normal", "weaker", "dim")
    keys += [f"table4.{OURS}.{i}.{d:g}m" for i in lights for d in distances]
    figures = {key: figure(key, value, value - 0.01, value) for key in keys}
    for d in distances:
        for name in ("width", "position"):
            for part in ("median", "p90"):
                key = f"fig14.normal.{d:g}m.{name}.{part}"
                figures[key] = figure(key, 0.009 if d <= 1.5 else 0.019)
    for slope in ("level", "all"):
        for part, good in (("floor_kept", 0.005), ("obstacle_kept", 0.98)):
            for stem in (f"floor.tf.{slope}", f"floor.tf.{slope}.worst"):
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
        (f"fig12.{OURS}.normal.accuracy", 0.9499, "acc.normal"),
        (f"fig12.{OURS}.dim.accuracy", 0.79, "acc.dim"),
        (f"table4.{OURS}.weaker.1.25m", 0.99, "success.weaker"),
        (f"table4.{OURS}.dim.1.25m", 0.95, "success.dim"),
        (f"table4.{OURS}.normal.3m", 0.94, "success.3m"),
        ("fig14.normal.2.5m.width.p90", 0.0201, "cylinder.width.3m"),
        ("fig14.normal.1m.position.p90", 0.0101, "cylinder.position.1.5m"),
        (f"coverage.{OURS}.all.coverage", 0.98, "coverage"),
        ("floor.tf.level.worst.floor_kept", 0.011, "floor.level"),
        ("floor.tf.all.worst.obstacle_kept", 0.96, "obstacle.all"),
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
    for key in (f"table4.{OURS}.dim.1.5m", f"table4.{OURS}.strong.2.5m"):
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


def test_a_cylinder_not_found_has_an_infinite_error():
    cases = (Case(1, 2.0, True, -0.01, 0.02, 0.5), Case(1, 2.0, False, *[math.nan] * 3))
    found = errors_of(Tally(cases=cases))
    assert found.position.tolist() == [0.01, math.inf]
    assert found.quantile("width", 0.5) == math.inf
    assert math.isnan(errors_of(Tally()).quantile("width", 0.5))


def test_wilson():
    low, high = section.wilson(20, 20)
    assert high == 1.0 and low == pytest.approx(20 / (20 + 1.959964**2))
    assert section.wilson(0, 10).low == 0.0
    assert math.isnan(section.wilson(0, 0).low)


def test_texts():
    assert section.percent(0.9123, Interval(0.9, 0.95)) == "91.2 % [90.0, 95.0]"
    assert section.number(math.nan) == "-"
    assert section.plain(math.inf) is None and section.plain(np.float64(0.1)) == 0.1


def test_the_paper_s_cells_fit_ours():
    assert set(paper_figures.SUCCESS) == {"strong", "normal", "weaker", "dim"}
    assert {len(row) for row in paper_figures.SUCCESS.values()} == {6}
    assert table4.__doc__ and replace(TINY).width == 192
