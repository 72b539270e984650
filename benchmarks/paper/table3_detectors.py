"""Table 3: comparison with the figures that the paper gives for deep detectors."""

import time

import numpy as np

from benchmarks.paper import paper_figures
from benchmarks.paper.lab import Lab
from benchmarks.paper.measure import Measured, measured
from benchmarks.paper.people import add_people
from benchmarks.paper.plan import SCENES
from benchmarks.paper.section import Section, percent
from benchmarks.paper.shots import Shot
from benchmarks.paper.systems import DEFAULT, PAPER, Prepared, System, found_by

FIGURES = ("accuracy", "precision", "recall", "f1")


def run(lab: Lab) -> Section:
    """Table 3 (ACC, precision, recall, F1, time against YOLOv7 and Swin-Transformer YOLOv5)."""
    section = Section("table3", "Table 3: against deep detectors")
    section.say(
        "The detectors of the paper were trained on its own images, and their weights are not "
        "public, so only their figures in the paper are shown. Our figures are for all test scenes "
        "in all lights."
    )
    shots = lab.load(lab.test_specs(SCENES[0], "normal"))[: lab.counts.timed]
    titles = {system.name: system.title for system in lab.systems}
    rows: list[list[str]] = []
    for name in (DEFAULT, PAPER):
        system = next(system for system in lab.systems if system.name == name)
        one = measured(lab.tallies(name))
        rows.append(_row(section, titles[name], name, one, _seconds(system, shots)))
    for name, paper in paper_figures.DETECTORS.items():
        if name != "Ours":
            rows.append([name, "not run: weights not public", "", "", "", "", *_paper(paper)])
    header = ["Method", "ACC", "Precision", "Recall", "F1", "Time here [s]"]
    section.table([*header, "paper: ACC, P, R, F1", "paper: time, TX2 [s]"], rows)
    add_people(lab, section)
    return section


def _row(section: Section, title: str, name: str, one: Measured, seconds: float) -> list[str]:
    paper = paper_figures.DETECTORS["Ours"]
    for k, figure in enumerate(FIGURES):
        value, ends = one.value(figure), one.intervals[figure]
        section.add(f"{name}.{figure}", value, "", "higher", ends, paper[k])
    section.add(f"{name}.time", seconds, "s", "lower", paper=paper[4])
    cells = [percent(one.value(figure), one.intervals[figure]) for figure in FIGURES]
    return [title, *cells, f"{seconds:.3f}", *_paper(paper)]


def _paper(paper: tuple[float, ...]) -> list[str]:
    return [", ".join(f"{100 * share:.2f}" for share in paper[:4]), f"{paper[4]:.3f}"]


def _seconds(system: System, shots: list[Shot]) -> float:
    """Return the median time of the complete detection on a frame [s], without compilation."""
    times: list[float] = []
    found_by(system, Prepared(shots[:1]))  # compiles
    for shot in shots:
        start = time.perf_counter()
        found_by(system, Prepared([shot]))
        times.append(time.perf_counter() - start)
    return float(np.median(times))
