"""Comparison of a run with a committed baseline, and creation of the baseline from several runs.

``python -m benchmarks.gate BASELINE RUN RUN RUN`` writes a baseline from the JSON files of runs.
"""

import json
import math
import statistics
from pathlib import Path

import tyro

from benchmarks.run import Metric, Missing


def read(path: Path) -> list[Metric]:
    """Read the metrics from a JSON file."""
    return [Metric(**row) for row in json.loads(path.read_text("utf-8"))]


def write(path: Path, metrics: list[Metric]) -> None:
    """Write metrics as a JSON list of key, value, unit, direction, tolerance."""
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = [metric._asdict() for metric in metrics]
    path.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


def regressions(
    metrics: list[Metric], baseline: list[Metric], missing: dict[str, Missing] | None = None
) -> list[str]:
    """Return a line for each gated metric that is worse than the baseline allows, or is missing.

    Args:
        metrics: Metrics of this run.
        baseline: Baseline; its tolerances apply.
        missing: Peers that could not be imported, by metric key; their lines contain the reason.
    """
    now = {metric.key: metric for metric in metrics}
    lines = []
    for old in baseline:
        if old.direction == "info":
            continue
        if (new := now.get(old.key)) is None:
            why = (missing or {}).get(old.key)
            because = f": {why.reason}; {why.remedy}" if why else ""
            lines.append(f"gate: {old.key} was not measured{because}")
            continue
        worse = new.value / old.value if old.direction == "lower" else old.value / new.value
        if not worse <= 1 + old.tolerance:
            lines.append(f"gate: {old.key} {old.value:.4g} -> {new.value:.4g} {old.unit}")
    return lines


def baseline_of(runs: list[list[Metric]]) -> list[Metric]:
    """Return the medians of the gated metrics, with tolerances of at least twice the largest loss.

    Args:
        runs: Metrics of one or more runs on the same kind of device.

    Returns:
        The gated metrics that all runs have, in the order of the first run.
    """
    tables = [{metric.key: metric for metric in run} for run in runs]
    found = []
    for metric in runs[0]:
        if metric.direction == "info" or not all(metric.key in table for table in tables):
            continue
        values = [table[metric.key].value for table in tables]
        middle = statistics.median(values)
        lost = max(values) / middle if metric.direction == "lower" else middle / min(values)
        tolerance = max(metric.tolerance, math.ceil(round(40 * (lost - 1), 6)) / 20)
        found.append(metric._replace(value=float(f"{middle:.4g}"), tolerance=tolerance))
    return found


def main(baseline: tyro.conf.Positional[Path], runs: tyro.conf.Positional[tuple[Path, ...]]) -> int:
    """Write a baseline from the JSON files of several runs on one kind of device.

    Args:
        baseline: File to write.
        runs: Files of ``python -m benchmarks DEVICE --json FILE``, at least one.
    """
    write(baseline, baseline_of([read(run) for run in runs]))
    return 0


if __name__ == "__main__":
    raise SystemExit(tyro.cli(main, prog="python -m benchmarks.gate"))
