"""Fig. 14: errors on a cylinder of 9 cm diameter, by distance and illumination."""

from typing import NamedTuple

import numpy as np

from benchmarks.paper import paper_figures, plots
from benchmarks.paper.lab import Lab
from benchmarks.paper.plan import DISTANCES_M, LIGHTS
from benchmarks.paper.section import Section, bootstrap
from benchmarks.paper.systems import System, default, paper
from jaxdet.eval import Tally, total

NAMES = ("position", "width")


class Errors(NamedTuple):
    """Errors of one cell; a cylinder that was not found has an infinite error."""

    position: np.ndarray
    """Absolute error of the forward distance of point C, ``(n,)`` [m]."""
    width: np.ndarray
    """Absolute error of the width, ``(n,)`` [m]."""

    def quantile(self, name: str, share: float) -> float:
        """Return an order statistic, so that infinite errors don't spread by interpolation."""
        values = getattr(self, name)
        return float(np.quantile(values, share, method="higher")) if len(values) else float("nan")


def errors_of(tally: Tally) -> Errors:
    """Return the errors of all required cylinders."""
    every = np.array([(c.position_error_m, c.width_error_m) for c in tally.cases]).reshape(-1, 2)
    found = np.array([case.found for case in tally.cases], bool)
    return Errors(*np.where(found[:, None], np.abs(every), np.inf).T)


def cells_of(lab: Lab, systems: list[System]) -> dict[tuple[str, float, str], Errors]:
    """Return the errors in every cell, by system, distance and light."""
    seeds = lab.seeds[: lab.counts.cylinder_seeds]
    keys = [(distance, light) for distance in DISTANCES_M for light in LIGHTS]
    specs = [
        lab.spec("cylinder", seed, 1, light, distance_m=d) for d, light in keys for seed in seeds
    ]
    lab.log(f"{len(specs)} frames of the cylinder")
    parts = iter(lab.judge(specs, systems))
    cells: dict[tuple[str, float, str], Errors] = {}
    for key in keys:
        mine = [next(parts) for _ in seeds]
        for name in (system.name for system in systems):
            cells[name, *key] = errors_of(total(tally for part in mine for tally in part[name]))
    return cells


def run(lab: Lab) -> Section:
    """Fig. 14 (error of width and position of the 9 cm cylinder, four lights)."""
    section = Section("fig14", "Fig. 14: accuracy on a cylinder of 9 cm diameter")
    systems = [default(lab.config), paper()]
    cells = cells_of(lab, systems)
    section.say(
        f"{min(lab.counts.cylinder_seeds, len(lab.seeds))} simulated scenes per cell. Position is "
        "the forward distance of point C, width the lateral distance from A to B, both compared "
        "with the visible surface. The tables have the median and the 90th percentile of the "
        "absolute errors in cm; a cylinder that was not found has an infinite error. The figure of "
        f"the paper has no numbers; its text states: {paper_figures.CYLINDER}."
    )
    for system in systems:
        _system(
            section,
            system,
            {(d, light): one for (name, d, light), one in cells.items() if name == system.name},
        )
    return section


def _system(section: Section, system: System, cells: dict[tuple[float, str], Errors]) -> None:
    """Add the tables and the plot of one system."""
    for name in NAMES:
        rows: list[list[str]] = []
        for light in LIGHTS:
            row = [light]
            for distance in DISTANCES_M:
                one = cells[distance, light]
                middle, high = one.quantile(name, 0.5), one.quantile(name, 0.9)
                ends = bootstrap(getattr(one, name), 0.5)
                key = f"{system.name}.{light}.{distance:g}m.{name}"
                section.add(f"{key}.median", middle, "m", "lower", ends)
                section.add(f"{key}.p90", high, "m", "lower")
                row.append(f"{_cm(middle)} / {_cm(high)}")
            rows.append(row)
        header = [f"{name.capitalize()} [cm]", *(f"{d:g} m" for d in DISTANCES_M)]
        section.table(header, rows, f"{system.title}: median / 90th percentile")
    figure, axes = plots.canvas(2, 11, 4)
    for ax, name in zip(axes, NAMES, strict=True):
        series = {
            light: plots.Series(
                [_finite(100 * cells[d, light].quantile(name, 0.5)) for d in DISTANCES_M]
            )
            for light in LIGHTS
        }
        plots.lines(ax, DISTANCES_M, series, f"median {name} error [cm]")
        ax.axhline(2.0, color=plots.INK, lw=1, ls=":")
        ax.set_xlabel("distance [m]")
        ax.set_ylim(bottom=0)
    plots.legend(figure, axes[0], 4)
    caption = f"Errors of {system.title} on the cylinder; dotted: the 2 cm of the paper."
    section.picture(f"{system.name}_errors", plots.png(figure), caption)


def _cm(metres: float) -> str:
    return f"{100 * metres:.2f}" if np.isfinite(metres) else "not found"


def _finite(value: float) -> float:
    return value if np.isfinite(value) else float("nan")
