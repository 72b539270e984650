"""Table 3: against deep detectors, where their weights are supplied."""

import time

import numpy as np

from benchmarks.paper import paper_figures
from benchmarks.paper.lab import Lab, units
from benchmarks.paper.measure import Measured, measured
from benchmarks.paper.plan import LIGHTS, SCENES
from benchmarks.paper.section import Section, percent
from benchmarks.paper.shots import Shot
from benchmarks.paper.systems import OURS, PAPER, Prepared, System, found_by, of_points

FIGURES = ("accuracy", "precision", "recall", "f1")


def run(lab: Lab) -> Section:
    """Table 3 (ACC, precision, recall, F1, time against YOLOv7 and Swin-Transformer YOLOv5)."""
    section = Section("table3", "Table 3: against deep detectors")
    section.say(
        "The paper's detectors are trained on its own images; their weights are not public, and a "
        "detector of others' classes would have to know buckets and tree trunks. Rows are run "
        "for weights given as --detector NAME=FILE.onnx: a box's obstacle is what lies near the "
        "median depth inside it, scored on a grid of kept pixels, all test scenes in all lights."
    )
    shots = lab.load(lab.test_specs(SCENES[0], "normal"))[: lab.counts.timed]
    titles = {system.name: system.title for system in lab.systems}
    rows: list[list[str]] = []
    for name in (OURS, PAPER):
        system = next(system for system in lab.systems if system.name == name)
        paper = paper_figures.DETECTORS["Ours"]
        one = measured(lab.tallies(name))
        rows.append(_row(section, titles[name], name, one, _seconds(system, shots), paper))
    for name, path in lab.detectors.items():
        system = System(name, name, "onnx", of_points(lab.config), model=path)
        tallies = units(lab.score_scenes([system]), name, SCENES, LIGHTS)
        paper = paper_figures.DETECTORS.get(name)
        one = measured(tallies)
        rows.append(_row(section, name, name, one, _seconds(system, shots), paper))
    for name, paper in paper_figures.DETECTORS.items():
        if name != "Ours" and name not in lab.detectors:
            rows.append([name, "not run: weights not supplied", "", "", "", "", *_paper(paper)])
    header = ["Method", "ACC", "Precision", "Recall", "F1", "Time here [s]"]
    section.table([*header, "paper: ACC, P, R, F1", "paper: time, TX2 [s]"], rows)
    return section


def _row(
    section: Section,
    title: str,
    name: str,
    one: Measured,
    seconds: float,
    paper: tuple[float, ...] | None,
) -> list[str]:
    for k, figure in enumerate(FIGURES):
        known = paper[k] if paper else None
        value, ends = one.value(figure), one.intervals[figure]
        section.add(f"{name}.{figure}", value, "", "higher", ends, known)
    section.add(f"{name}.time", seconds, "s", "lower", paper=paper[4] if paper else None)
    cells = [percent(one.value(figure), one.intervals[figure]) for figure in FIGURES]
    return [title, *cells, f"{seconds:.3f}", *_paper(paper)]


def _paper(paper: tuple[float, ...] | None) -> list[str]:
    if paper is None:
        return ["", ""]
    return [", ".join(f"{100 * share:.2f}" for share in paper[:4]), f"{paper[4]:.3f}"]


def _seconds(system: System, shots: list[Shot]) -> float:
    """Median time of the whole process on a frame, by the reference stages."""
    times: list[float] = []
    for shot in shots:
        start = time.perf_counter()
        found_by(system, Prepared([shot]))
        times.append(time.perf_counter() - start)
    return float(np.median(times))
