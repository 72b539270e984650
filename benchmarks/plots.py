"""Plots of a run: ``python -m benchmarks.plots FILE.json FOLDER``."""

import re
from pathlib import Path

import matplotlib
import numpy as np
import tyro
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.fit import GROWTH, axis_of, fit
from benchmarks.gate import read
from benchmarks.run import Metric
from benchmarks.sweep import AXES, DEFAULT_BATCH, DEFAULT_SLOTS, SIZES, Point

matplotlib.use("Agg")

POINT = re.compile(r"(\w+)\.(?:(\d+x\d+(?:-\d+x\d+)?)\.)?(?:n(\d+)\.)?b(\d+)\.(time|copy_share)")
OURS, PEER = "tab:blue", "tab:grey"


def draw(metrics: list[Metric], folder: Path) -> list[Path]:
    """Draws what the metrics hold: ratios, batch sizes, feature slots, image sizes.

    Args:
        metrics: Of one run.
        folder: Where the PNG files go.

    Returns:
        Their paths.
    """
    figures = {
        "ratios": _ratios(metrics),
        "batch": _curves(metrics, "batch"),
        "slots": _curves(metrics, "slots"),
        "stages": _stages(metrics),
    }
    paths = []
    for name, figure in figures.items():
        if figure is not None:
            paths.append(folder / f"{name}.png")
            figure.savefig(paths[-1], dpi=120)
    return paths


def sweep_of(metrics: list[Metric], part: str) -> dict[str, dict[Point, float]]:
    """The sweep's ``time`` or ``copy_share`` by stage and point."""
    found: dict[str, dict[Point, float]] = {}
    for metric in metrics:
        match = POINT.fullmatch(metric.key)
        if match and match[5] == part:
            point = Point(match[2] or "", int(match[3] or 0), int(match[4]))
            found.setdefault(match[1], {})[point] = metric.value
    return found


def _ratios(metrics: list[Metric]) -> Figure | None:
    """How many times faster than each peer, on a logarithmic axis."""
    all_values = {m.key: m.value for m in metrics}
    ratios = [(key, all_values[key]) for key in all_values if f"{key}.peer" in all_values]
    if not ratios:
        return None
    figure = Figure(figsize=(8, 0.8 + 0.28 * len(ratios)), layout="constrained")
    axes = figure.add_subplot()
    keys, values = zip(*reversed(ratios), strict=True)
    bars = axes.barh(keys, values, color=[OURS if value >= 1 else PEER for value in values])
    axes.bar_label(bars, [f"  {value:.3g}" for value in values])
    axes.plot([all_values[f"{key}.cpu_ratio"] for key in keys], keys, "k|", markersize=10)
    axes.set_xscale("log")
    axes.margins(x=0.15, y=0.01)
    axes.axvline(1, color="black", linewidth=0.8)
    axes.set_xlabel("peer's time over ours (right of 1: ours is faster); strokes: CPU time")
    return figure


def _curves(metrics: list[Metric], axis: str) -> Figure | None:
    """Cost of a frame along an axis of the sweep, with its fit."""
    lines = {
        stage: axis_of(times, axis)
        for stage, times in sweep_of(metrics, "time").items()
        if axis in AXES[stage]
    }
    lines = {stage: line for stage, line in lines.items() if len(line) > 1}
    if not lines:
        return None
    figure = Figure(figsize=(8, 5), layout="constrained")
    axes = figure.add_subplot()
    for number, (stage, line) in enumerate(lines.items()):
        x = np.array([getattr(point, axis) for point in line], float)
        cost = np.array(list(line.values()))
        axes.plot(x, cost, "o", color=f"C{number}", label=stage)
        _fitted(axes, axis, x, cost, f"C{number}")
    axes.set_xscale("log", base=2)
    axes.set_yscale("log")
    axes.set_ylabel("ms/frame")
    texts = {"batch": ("frames of a call", "fixed/B + c"), "slots": ("slots N", "a + b N log N")}
    axes.set_xlabel(f"{texts[axis][0]}; lines: {texts[axis][1]}")
    axes.legend()
    return figure


def _fitted(axes: Axes, axis: str, x: np.ndarray, cost: np.ndarray, color: str) -> None:
    smooth = np.geomspace(x.min(), x.max(), 100)
    if axis == "batch":
        line = fit(x, cost * x)
        curve = line.fixed / smooth + line.slope
    else:
        growth = GROWTH["n_log_n"]
        line = fit(growth(x), cost)
        curve = line.fixed + line.slope * growth(smooth)
    axes.plot(smooth, curve, color=color, linewidth=1)


def _stages(metrics: list[Metric]) -> Figure | None:
    """The time of each stage by image size, and its share of the copy rate."""
    figure = Figure(figsize=(9, 4), layout="constrained")
    panels = figure.subplots(1, 2)
    parts = ("time", "ms/frame"), ("copy_share", "share of the copy rate")
    found = False
    for axes, (part, label) in zip(panels, parts, strict=True):
        sweep = sweep_of(metrics, part)
        for number, size in enumerate(SIZES):
            values = [_at_size(sweep.get(stage, {}), size) for stage in AXES]
            found |= any(values)
            place = np.arange(len(values)) + 0.27 * (number - 1)
            axes.bar(place, values, 0.25, label=size)
        axes.set_xticks(range(len(AXES)), list(AXES), rotation=30)
        axes.set_ylabel(label)
        axes.set_yscale("log")
    panels[0].legend(fontsize="small")
    return figure if found else None


def _at_size(sweep: dict[Point, float], size: str) -> float:
    """The value at an image size; stages that work on points have one for all sizes."""
    for point, value in sweep.items():
        here = point.size in ("", size) and point.slots in (0, DEFAULT_SLOTS)
        if here and point.batch in DEFAULT_BATCH.values():
            return value
    return 0.0


def main(json_file: tyro.conf.Positional[Path], folder: tyro.conf.Positional[Path]) -> int:
    """Draws the plots of a run.

    Args:
        json_file: What ``python -m benchmarks DEVICE --json FILE`` wrote.
        folder: Where the PNG files go.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for path in draw(read(json_file), folder):
        print(path)
    return 0


if __name__ == "__main__":
    raise SystemExit(tyro.cli(main, prog="python -m benchmarks.plots"))
