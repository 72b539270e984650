"""Table 4 and Fig. 13: success rate by distance and illumination."""

from benchmarks.paper import paper_figures, plots
from benchmarks.paper.lab import Lab
from benchmarks.paper.pictures import encode, grid, shot_picture, titled
from benchmarks.paper.plan import DISTANCES_M, LIGHTS
from benchmarks.paper.section import Section, percent, wilson
from benchmarks.paper.shots import Spec
from benchmarks.paper.systems import DEFAULT, PAPER, paper
from jaxdet.eval import Tally, total

SHOWN = (DEFAULT, PAPER)
Cells = dict[tuple[str, float, str], Tally]
"""Counts by system, distance [m] and light."""


def specs_of(lab: Lab, distance_m: float, light: str) -> list[Spec]:
    """Return the scenes of a cell, with the same objects in every cell."""
    count = lab.counts.approach
    return [lab.spec("approach", s, count, light, distance_m=distance_m) for s in lab.seeds]


def cells_of(lab: Lab) -> Cells:
    """Return the counts of every cell, for the default and for the preset ``paper``."""
    chosen = [system for system in lab.systems if system.name in SHOWN]
    keys = [(distance, light) for distance in DISTANCES_M for light in LIGHTS]
    specs = [spec for key in keys for spec in specs_of(lab, *key)]
    lab.log(f"{sum(spec.frames for spec in specs)} frames of approached obstacles")
    parts = iter(lab.judge(specs, chosen))
    cells: Cells = {}
    for distance, light in keys:
        mine = [next(parts) for _ in lab.seeds]
        for system in chosen:
            tallies = [tally for part in mine for tally in part[system.name]]
            cells[system.name, distance, light] = total(tallies)
    return cells


def run(lab: Lab) -> Section:
    """Table 4 (share of obstacles found at 3 to 1 m in four lights) and Fig. 13 (near and far)."""
    section = Section("table4", "Table 4 and Fig. 13: success rate by distance and illumination")
    cells = cells_of(lab)
    standing = cells[DEFAULT, DISTANCES_M[-1], "normal"].visible
    section.say(
        "One obstacle of the kinds in the paper (person, cone, barrier, bucket, trunk, chair, "
        f"bin, box, table) stands at the given distance. There are {standing:.0f} simulated scenes "
        "per cell, the same in all cells (the paper: 20 sets). An obstacle is found if a detection "
        "of its own has at least half of its points on it. Intervals are Wilson score intervals: "
        "20 of 20 has one from 84 to 100 %. The range of the preset paper ends at 3 m, and objects "
        "beyond it are not required."
    )
    titles = {system.name: system.title for system in lab.systems}
    for name in SHOWN:
        rows: list[list[str]] = []
        for light in LIGHTS:
            row = [light]
            for k, distance in enumerate(DISTANCES_M):
                tally, theirs = cells[name, distance, light], paper_figures.SUCCESS[light][k]
                ends = wilson(int(tally.found), int(tally.visible))
                rate = tally.found / tally.visible if tally.visible else float("nan")
                section.add(f"{name}.{light}.{distance:g}m", rate, "", "higher", ends, theirs)
                row.append(f"{percent(rate, ends, 0)} ({100 * theirs:.1f})")
            rows.append(row)
        header = [titles[name], *(f"{d:g} m" for d in DISTANCES_M)]
        section.table(header, rows, "Success rate with 95 % interval (the paper's, in %)")
    _plot(section, cells, titles)
    _near_and_far(section, lab)
    return section


def _near_and_far(section: Section, lab: Lab) -> None:
    """Add Fig. 13: the detections of the preset ``paper`` far away and near."""
    views = []
    for seed in lab.seeds[:2]:
        for distance in (DISTANCES_M[0], DISTANCES_M[-1]):
            spec = lab.spec("approach", seed, lab.counts.approach, distance_m=distance)
            shot = lab.load([spec])[0]
            views.append(titled(shot_picture(shot, paper()), f"{distance:g} m", 640))
    caption = (
        "Fig. 13: two objects at 3 m and at 1 m in normal light, preset paper; nearer objects have "
        "more corners."
    )
    section.picture("fig13", encode(grid(views, 2)), caption)


def _plot(section: Section, cells: Cells, titles: dict[str, str]) -> None:
    figure, axes = plots.canvas(len(SHOWN), 11, 4)
    for ax, name in zip(axes, SHOWN, strict=True):
        series: dict[str, plots.Series] = {}
        for light in LIGHTS:
            mine = [cells[name, d, light] for d in DISTANCES_M]
            ends = [wilson(int(t.found), int(t.visible)) for t in mine]
            series[light] = plots.Series(
                [t.found / t.visible if t.visible else float("nan") for t in mine],
                [e.low for e in ends],
                [e.high for e in ends],
                paper_figures.SUCCESS[light][: len(DISTANCES_M)],
            )
        plots.lines(ax, DISTANCES_M, series, "success rate")
        ax.set_xlabel("distance [m]")
        ax.set_title(titles[name], fontsize=10)
        ax.set_ylim(-0.03, 1.03)
    plots.legend(figure, axes[0], 4)
    caption = "Success rate by distance, with 95 % bands; dashed: the paper, on its own data."
    section.picture("success", plots.png(figure), caption)
