"""Table 1 and Fig. 10: silhouette coefficient and Davies-Bouldin index by scene."""

import numpy as np

from benchmarks.baselines import BASELINES
from benchmarks.paper import paper_figures, plots
from benchmarks.paper.lab import Lab
from benchmarks.paper.measure import Measured, measured
from benchmarks.paper.pictures import side_by_side
from benchmarks.paper.plan import SCENE_TITLES, SCENES
from benchmarks.paper.section import Direction, Section, number
from benchmarks.paper.systems import CITED, DEFAULT, INDEXED_LIGHT, MISSING, PAPER, RULE

ROWS = {
    DEFAULT: "ours",
    PAPER: "ours",
    RULE: "ours",
    "hierarchical_ward": "traditional",
    "rsc": "rsc",
}
"""Systems, and the rows of the paper with which they are compared."""
INDICES: dict[str, Direction] = {"silhouette": "higher", "davies_bouldin": "lower"}


def run(lab: Lab) -> Section:
    """Table 1 (SC and DB in the four scenes) and Fig. 10 (the clusters in a picture of each)."""
    section = Section("table1", "Table 1 and Fig. 10: clustering indices by scene")
    section.say(
        "Silhouette coefficient SC (larger is better) and Davies-Bouldin index DB (smaller is "
        "better): means over the frames with at least two clusters, in normal light. Points "
        "without a label are left out, so these indices reward a method that discards points, and "
        "they don't depend on the ground truth. DB is not bounded by 1. The paper's rule, RSC, "
        "ward and the other baselines cluster the same corners and grid of pixels; the preset "
        "paper clusters its own corners, the default corners and a sample of its cells. The paper "
        "has one picture per scene; here each scene is a family of simulated ones. The methods "
        "that it cites in Section 2 follow, with parameters tuned as in Table 2."
    )
    titles = {system.name: system.title for system in lab.systems}
    found = {
        (name, scene): measured(lab.tallies(name, [scene], [INDEXED_LIGHT]))
        for name in (*ROWS, *CITED)
        if name in titles
        for scene in SCENES
    }
    _table(section, found, titles)
    _plot(section, found, titles)
    _clusters(section, lab, titles)
    return section


def _table(
    section: Section, found: dict[tuple[str, str], Measured], titles: dict[str, str]
) -> None:
    rows: list[list[str]] = []
    for name in dict.fromkeys(name for name, _ in found):
        row = [titles[name]]
        for k, scene in enumerate(SCENES):
            one = found[name, scene]
            for j, (figure, direction) in enumerate(INDICES.items()):
                paper = paper_figures.INDICES[ROWS[name]][k][j] if name in ROWS else None
                value, ends = one.value(figure), one.intervals[figure]
                section.add(f"{name}.{scene}.{figure}", value, "", direction, ends, paper)
                theirs = f" ({paper:.2f})" if paper is not None else ""
                row.append(f"{number(value, ends, 2)}{theirs}")
        rows.append(row)
    blanks = [""] * (len(SCENES) * len(INDICES) - 1)
    rows += [
        [BASELINES[name].title, f"not run: {MISSING[name]}", *blanks]
        for name in CITED
        if name in MISSING
    ]
    header = ["Method", *(f"{t} {i}" for t in SCENE_TITLES for i in ("SC", "DB"))]
    section.table(header, rows, "Simulated scenes, with 95 % intervals (the paper's value)")


def _plot(section: Section, found: dict[tuple[str, str], Measured], titles: dict[str, str]) -> None:
    figure, axes = plots.canvas(2, 11, 4)
    for j, (ax, name) in enumerate(zip(axes, INDICES, strict=True)):
        series = {
            titles[system]: plots.Series(
                [found[system, scene].value(name) for scene in SCENES],
                [found[system, scene].intervals[name].low for scene in SCENES],
                [found[system, scene].intervals[name].high for scene in SCENES],
                [paper_figures.INDICES[paper][k][j] for k in range(len(SCENES))],
            )
            for system, paper in ROWS.items()
            if system in titles
        }
        plots.bars(ax, SCENE_TITLES, series, ("SC, larger is better", "DB, smaller is better")[j])
    plots.legend(figure, axes[0], 5)
    section.picture("indices", plots.png(figure), "Table 1 as a plot; diamonds: the paper.")


def _clusters(section: Section, lab: Lab, titles: dict[str, str]) -> None:
    """Add pictures of the first frame with the most obstacles of each scene."""
    chosen = [s for s in lab.systems if s.name in (RULE, "hierarchical_ward", "rsc", DEFAULT)]
    chosen.sort(key=lambda system: list(ROWS).index(system.name))
    strips = []
    for scene in SCENES:
        tallies = lab.scores[scene, INDEXED_LIGHT][DEFAULT]
        full = int(np.argmax([tally.visible for tally in tallies]))
        each = lab.counts.scenes
        spec = lab.spec(scene, lab.seeds[full // each], each, INDEXED_LIGHT)
        shot = lab.load([spec])[full % each]
        strips.append(side_by_side(shot, chosen, [titles[s.name] for s in chosen]))
    for scene, strip in zip(SCENES, strips, strict=True):
        caption = f"Fig. 10, {scene}: points coloured by cluster (white: none, grey: discarded)."
        section.picture(scene, strip, caption)
