"""Curves through the sweep: cost against batch size and against the number of features."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from benchmarks.run import Metric
from benchmarks.sweep import AXES, Point

GROWTH: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "n": lambda n: n,
    "n_log_n": lambda n: n * np.log2(n),
    "n2": lambda n: n * n,
}
"""What the cost of a frame may grow with."""


class Fit(NamedTuple):
    """``cost = fixed + slope * growth``, by least squares of the relative errors."""

    fixed: float
    slope: float
    residual: float
    """The largest relative error."""


def fit(growth: np.ndarray, cost: np.ndarray) -> Fit:
    """Fits a line with no negative part; at least two points.

    >>> fit(np.array([1.0, 2.0, 4.0]), np.array([3.0, 5.0, 9.0]))
    Fit(fixed=1.0, slope=2.0, residual=0.0)
    """
    rows = np.stack([np.ones_like(growth), growth], axis=1) / cost[:, None]
    both = np.linalg.lstsq(rows, np.ones_like(cost))[0]
    if both.min() < 0:  # then one of the two alone
        alone = [(rows[:, i].sum() / (rows[:, i] ** 2).sum(), i) for i in (0, 1)]
        tries = [np.eye(2)[i] * value for value, i in alone]
        both = min(tries, key=lambda a: float(np.sum((rows @ a - 1) ** 2)))
    residual = float(np.abs(rows @ both - 1).max())
    return Fit(*(round(float(a), 12) for a in (*both, residual)))


def fits_of(stage: str, times: dict[Point, float]) -> list[Metric]:
    """The fits of a stage, as metrics that the gate leaves alone.

    Args:
        stage: A stage, or ``pipeline``.
        times: Milliseconds a frame at the points of :func:`benchmarks.sweep.points_of`.

    Returns:
        ``<stage>.batch_fit``: a call costs ``fixed`` plus ``per_frame`` times the batch size.
        ``<stage>.slots_fit``: a frame costs ``fixed`` plus ``per_n_log_n`` times n log2 n; the
        residuals of n and n squared beside it. Only where at least three points lie on the axis.
    """
    metrics = []
    batch = axis_of(times, "batch")
    if len(batch) >= 3:
        sizes = np.array([point.batch for point in batch], float)
        line = fit(sizes, np.array(list(batch.values())) * sizes)
        metrics += [
            _info(f"{stage}.batch_fit.per_frame", line.slope, "ms"),
            _info(f"{stage}.batch_fit.fixed", line.fixed, "ms/call"),
            _info(f"{stage}.batch_fit.residual", line.residual, ""),
        ]
    slots = axis_of(times, "slots")
    if "slots" in AXES[stage] and len(slots) >= 3:
        n = np.array([point.slots for point in slots], float)
        cost = np.array(list(slots.values()))
        lines = {name: fit(growth(n), cost) for name, growth in GROWTH.items()}
        metrics += [
            _info(f"{stage}.slots_fit.per_n_log_n", 1e6 * lines["n_log_n"].slope, "ns"),
            _info(f"{stage}.slots_fit.fixed", lines["n_log_n"].fixed, "ms"),
            *(_info(f"{stage}.slots_fit.residual_{k}", a.residual, "") for k, a in lines.items()),
        ]
    return metrics


def axis_of(times: dict[Point, float], axis: str) -> dict[Point, float]:
    """The points along an axis: those that share the other coordinates with most."""
    lines: dict[tuple, dict[Point, float]] = {}
    for point, time in sorted(times.items()):
        others = tuple(value for name, value in point._asdict().items() if name != axis)
        lines.setdefault(others, {})[point] = time
    return max(lines.values(), key=len, default={})


def _info(key: str, value: float, unit: str) -> Metric:
    return Metric(key, value, unit, "info", 0.0)
