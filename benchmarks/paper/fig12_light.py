"""Fig. 12: detection by illumination, and the time of the complete detection."""

from functools import partial

import numpy as np

from benchmarks.paper import paper_figures, plots
from benchmarks.paper.lab import Lab
from benchmarks.paper.measure import Measured, measured
from benchmarks.paper.plan import LIGHTS
from benchmarks.paper.section import Section, number, percent
from benchmarks.paper.shots import frames_of
from benchmarks.paper.systems import DEFAULT, PAPER, RULE
from benchmarks.paper.timing import in_turns, split_batch
from jaxdet.config import Config
from jaxdet.pipeline import BackendName, detect
from jaxdet.presets import preset
from jaxdet.sim import exposure
from jaxdet.types import Detections, Frames

ROWS = (PAPER, RULE, "hierarchical_ward", "rsc", "dbscan", DEFAULT)
"""Systems of the plot."""
FIGURES = {"accuracy": "ACC", "fmi": "FMI", "f1": "F1"}


def run(lab: Lab) -> Section:
    """Fig. 12 (a) ACC, (b) FMI, (c) time of the complete detection, in four lights; and F1."""
    section = Section("fig12", "Fig. 12: detection by illumination")
    section.say(
        f"The same simulated scenes in four lights: {_levels()}; the paper gives no levels. Its "
        "ACC is 91.72 % in normal and 71.4 % in dim light; the other bars of its figure have no "
        "numbers. These two values are shown with the preset paper, which is its method."
    )
    names = [system.name for system in lab.systems]
    titles = {system.name: system.title for system in lab.systems}
    found = {(n, i): measured(lab.tallies(n, lights=[i])) for n in names for i in LIGHTS}
    for figure, label in FIGURES.items():
        rows = [[titles[n], *(_cell(found[n, i], figure) for i in LIGHTS)] for n in names]
        section.table([label, *LIGHTS], rows)
        for n in names:
            for light in LIGHTS:
                one = found[n, light]
                paper = paper_figures.LIGHT_ACC.get(light)
                known = paper if (n, figure) == (PAPER, "accuracy") else None
                key, ends = f"{n}.{light}.{figure}", one.intervals[figure]
                section.add(key, one.value(figure), "", "higher", ends, known)
    shown, axes = plots.canvas(3, 13, 4.2)
    for ax, (figure, label) in zip(axes, FIGURES.items(), strict=True):
        series = {
            titles[n]: plots.Series(
                [found[n, i].value(figure) for i in LIGHTS],
                [found[n, i].intervals[figure].low for i in LIGHTS],
                [found[n, i].intervals[figure].high for i in LIGHTS],
                [paper_figures.LIGHT_ACC.get(i) for i in LIGHTS]
                if (n, figure) == (PAPER, "accuracy")
                else None,
            )
            for n in ROWS
            if n in titles
        }
        plots.bars(ax, LIGHTS, series, label)
        ax.set_ylim(0, 1)
    plots.legend(shown, axes[0], 4)
    section.picture("light", plots.png(shown), "By illumination; diamonds: ACC in the paper.")
    _time(section, lab)
    return section


def _levels() -> str:
    """Return the levels as ``strong 30 000 lx, normal 500 lx``, and so on."""
    levels = ((light, f"{exposure.LIGHTS[light].lux:,.0f}".replace(",", " ")) for light in LIGHTS)
    return ", ".join(f"{light} {lux} lx" for light, lux in levels)


def _cell(one: Measured, figure: str) -> str:
    show = percent if figure == "accuracy" else number
    return show(one.value(figure), one.intervals[figure])


def _time(section: Section, lab: Lab) -> None:
    """Add Fig. 12 (c)."""
    config = preset("paper")
    titles = {"reference": "NumPy reference", "jax": "JAX", "default": "Default of jaxdet"}
    rows: list[list[str]] = []
    for light in LIGHTS:
        specs = [lab.spec("roadblocks", s, lab.counts.scenes, light) for s in lab.seeds]
        each = split_batch(frames_of(lab.load(specs)[: lab.counts.timed]))
        functions = {
            "reference": partial(_detect, each, config, "reference"),
            "jax": partial(_detect, each, config, "jax"),
            "default": partial(_detect, each, lab.config, "jax"),
        }
        times = in_turns(functions, len(each), min(lab.counts.rounds, 3))
        for name, ms in times.items():
            section.add(f"time.{name}.{light}", float(np.median(ms)), "ms", "lower")
        rows.append([light, *(f"{np.median(ms):.1f}" for ms in times.values())])
    caption = (
        "Fig. 12 (c): complete detection [ms] by the preset paper (reference and JAX) and by the "
        "default, one frame at a time on the CPU of this machine; the paper: 53 ms on a TX2."
    )
    section.table(["Light", *titles.values()], rows, caption)


def _detect(each: list[Frames], config: Config, backend: BackendName, index: int) -> Detections:
    return detect(each[index], config, backend=backend)
