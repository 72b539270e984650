"""Plots of the report with matplotlib, which needs no display."""

import io
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

OURS = "#1f6fb4"
COLORS = (OURS, "#e07b28", "#4c9f50", "#b04a8c", "#8a6d3b", "#5f7480", "#c9a400", "#3aa6a6")
INK = "#2b3038"
matplotlib.rcParams.update(
    {
        "font.size": 10,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.edgecolor": INK,
        "axes.grid": True,
        "axes.axisbelow": True,
        "grid.color": "#dfe3e8",
        "text.color": INK,
        "legend.frameon": False,
    }
)


class Series(NamedTuple):
    """Values with intervals, and the values of the paper."""

    values: Sequence[float]
    low: Sequence[float] | None = None
    high: Sequence[float] | None = None
    paper: Sequence[float | None] | None = None


def canvas(columns: int = 1, width: float = 9.0, height: float = 3.8) -> tuple[Figure, list[Axes]]:
    """Return an empty figure with plots side by side."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, columns, squeeze=False)[0]
    return figure, list(axes)


def png(figure: Figure) -> bytes:
    """Return a figure as a PNG file."""
    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=110, metadata={"Software": None})
    return buffer.getvalue()


def bars(axes: Axes, groups: Sequence[str], series: Mapping[str, Series], unit: str) -> None:
    """Draw groups of bars with intervals, and the values of the paper as diamonds."""
    width = 0.8 / max(len(series), 1)
    labelled = False
    for k, (name, one) in enumerate(series.items()):
        x = np.arange(len(groups)) + (k - (len(series) - 1) / 2) * width
        values = np.asarray(one.values, np.float64)
        axes.bar(x, values, width * 0.92, label=name, color=COLORS[k % len(COLORS)])
        if one.low is not None and one.high is not None:
            ends = np.array([values - one.low, one.high - values])
            ends = np.nan_to_num(np.maximum(ends, 0))
            axes.errorbar(x, values, ends, fmt="none", ecolor=INK, elinewidth=1, capsize=2)
        if one.paper is not None:
            known = [(a, p) for a, p in zip(x, one.paper, strict=True) if p is not None]
            if known:
                spots = tuple(zip(*known, strict=True))
                label = None if labelled else "the paper (its data)"
                axes.scatter(*spots, marker="D", s=26, c="white", ec=INK, zorder=3, label=label)
                labelled = True
    axes.set_xticks(np.arange(len(groups)), groups)
    axes.grid(visible=False, axis="x")
    axes.set_ylabel(unit)


def lines(axes: Axes, x: Sequence[float], series: Mapping[str, Series], unit: str) -> None:
    """Draw lines with intervals, and the values of the paper as dashed lines."""
    for k, (name, one) in enumerate(series.items()):
        color = COLORS[k % len(COLORS)]
        axes.plot(x, one.values, "o-", color=color, label=name, lw=2, ms=4)
        if one.low is not None and one.high is not None:
            axes.fill_between(x, one.low, one.high, color=color, alpha=0.13, lw=0)
        if one.paper is not None:
            axes.plot(x, np.array(one.paper, np.float64), "--", color=color, lw=1.2)
    axes.set_ylabel(unit)


def legend(figure: Figure, axes: Axes, columns: int = 1) -> None:
    """Add a legend below the figure."""
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=columns, fontsize=9)
