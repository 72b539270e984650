"""Evaluation metrics from tallies."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from jaxdet.eval.tally import COUNTS, Case, Tally, total


class Score(NamedTuple):
    """Metrics of a log; NaN if a metric has no data.

    TP are found obstacles, FN missed ones, FP false detections (:mod:`jaxdet.eval.frame`).
    """

    recall: float
    """``TP / (TP + FN)``."""
    precision: float
    """``TP / (TP + FP)``."""
    f1: float
    """``2 TP / (2 TP + FP + FN)``."""
    accuracy: float
    """ACC in our interpretation, ``TP / (TP + FP + FN)``. The paper calls "ground shadows, noise,
    or other non-existent situations" negative samples, so its ACC is ``(TP + TN) / (TP + TN + FP +
    FN)``. True negatives, i.e. objects that neither exist nor were detected, can't be counted;
    without them the value can only be lower."""
    point_accuracy: float
    """ACC of the clustering literature: fraction of points with the correct label, after one-to-one
    matching of labels and obstacles. Points on the floor or without an object are correct if they
    have no label."""
    fmi: float
    """Mean over frames of the Fowlkes-Mallows index of points, see
    :func:`jaxdet.eval.partition.fowlkes_mallows`."""
    fmi_pooled: float
    """Fowlkes-Mallows index of the pairs of all frames."""
    fmi_obstacles: float
    """``sqrt(precision recall)``, the Fowlkes-Mallows formula over obstacles. It fits the paper's
    values: the precision 85.54 and the recall 90.22 give 0.8785, and the stated FMI is 0.8773."""
    silhouette: float
    """Mean over frames of the silhouette coefficient, see
    :func:`jaxdet.eval.indices.silhouette`."""
    davies_bouldin: float
    """Mean over frames of the Davies-Bouldin index."""
    coverage: float
    """Fraction of the visible sides of found obstacles inside their detection's rectangle, with the
    margin ``coverage_margin_m``. The sides are sampled every centimetre along the edges of the
    footprint's convex hull that face the camera, within ``coverage_range_m`` and the extent of the
    visible surface."""
    safe_coverage: float
    """Fraction of the visible sides of all required obstacles inside of any rectangle."""
    floor_kept: float
    """Fraction of floor pixels kept by the ground stage."""
    obstacle_kept: float
    """Fraction of obstacle pixels above the step height kept by the ground stage."""
    free_claimed: float
    """Fraction of drivable floor pixels inside an outline. Only pixels in range and measured as
    floor count, and outlines of hanging obstacles are ignored; see
    :func:`jaxdet.eval.claimed_floor`."""
    free_claimed_worst: float
    """``free_claimed`` in the worst frame."""
    nearest_error_m: float
    """Median absolute error of ``distance_m`` relative to the nearest visible point [m]."""
    nearest_error_p90_m: float
    """90th percentile of the absolute error of ``distance_m`` [m]."""
    nearest_bias_m: float
    """Median signed error of ``distance_m``, negative if too near [m]."""
    position_error_m: float
    """Median absolute error of the forward coordinate of point C [m]."""
    position_error_p90_m: float
    """90th percentile of the absolute error of the forward coordinate of point C [m]."""
    width_error_m: float
    """Median absolute error of the width [m]."""
    width_error_p90_m: float
    """90th percentile of the absolute error of the width [m]."""
    iou: float
    """Median intersection over union of rectangles and true footprints."""
    tally: Tally
    """Counts from which the metrics are computed."""

    def to_dict(self) -> dict[str, float]:
        """Return all metrics and counts by name."""
        figures = {k: v for k, v in self._asdict().items() if k != "tally"}
        return {**figures, **self.tally.to_dict()}


def score(tallies: Iterable[Tally]) -> Score:
    """Compute the metrics of the sum of tallies."""
    tally = total(tallies)
    shares = {k: float(v) for k, v in rates(np.array(tally.counts, np.float64)).items()}
    worst = max(tally.claims, default=float("nan"))
    figures = shares | errors(case_table(tally.cases)) | {"free_claimed_worst": worst}
    return Score(**figures, tally=tally)


def rates(counts: np.ndarray) -> dict[str, np.ndarray]:
    """Compute the metrics that are ratios of counts.

    Args:
        counts: Counts ``(..., C)`` float64, in the order of :data:`jaxdet.eval.tally.COUNTS`.

    Returns:
        Metrics by name, each ``(...)`` float64; NaN where the denominator is 0.
    """
    c = {name: counts[..., i] for i, name in enumerate(COUNTS)}
    tp, fp, fn = c["found"], c["false"], c["visible"] - c["found"]
    recall, precision = _ratio(tp, tp + fn), _ratio(tp, tp + fp)
    pairs = np.sqrt(c["pairs_detected"] * c["pairs_true"])
    none = (c["pairs_detected"] == 0) & (c["pairs_true"] == 0)
    return {
        "recall": recall,
        "precision": precision,
        "f1": _ratio(2 * tp, 2 * tp + fp + fn),
        "accuracy": _ratio(tp, tp + fp + fn),
        "point_accuracy": _ratio(c["points_right"], c["points"]),
        "fmi": _ratio(c["fmi_sum"], c["fmi_frames"]),
        "fmi_pooled": np.where(none, np.nan, np.nan_to_num(_ratio(c["pairs_both"], pairs))),
        "fmi_obstacles": np.sqrt(precision * recall),
        "silhouette": _ratio(c["silhouette_sum"], c["index_frames"]),
        "davies_bouldin": _ratio(c["davies_bouldin_sum"], c["index_frames"]),
        "coverage": _ratio(c["near_covered"], c["near_points"]),
        "safe_coverage": _ratio(c["near_safe"], c["near_asked"]),
        "floor_kept": _ratio(c["floor_pixels_kept"], c["floor_pixels"]),
        "obstacle_kept": _ratio(c["obstacle_pixels_kept"], c["obstacle_pixels"]),
        "free_claimed": _ratio(c["drivable_claimed"], c["drivable_pixels"]),
    }


def _ratio(part: np.ndarray, whole: np.ndarray) -> np.ndarray:
    return np.divide(part, whole, out=np.full(np.shape(whole), np.nan), where=whole > 0)


def case_table(cases: Sequence[Case]) -> np.ndarray:
    """Return the cases as ``(n, 7)`` float64, with the fields of :class:`Case` as columns."""
    return np.array(cases, np.float64).reshape(len(cases), len(Case._fields))


def errors(cases: np.ndarray) -> dict[str, float]:
    """Compute the metrics that are quantiles over found obstacles.

    Args:
        cases: Cases ``(n, 7)`` float64, see :func:`case_table`.

    Returns:
        Metrics by name; NaN without values.
    """
    position, width, iou, nearest = np.abs(cases[:, 3:]).T
    return {
        "nearest_error_m": _quantile(nearest, 0.5),
        "nearest_error_p90_m": _quantile(nearest, 0.9),
        "nearest_bias_m": _quantile(cases[:, -1], 0.5),
        "position_error_m": _quantile(position, 0.5),
        "position_error_p90_m": _quantile(position, 0.9),
        "width_error_m": _quantile(width, 0.5),
        "width_error_p90_m": _quantile(width, 0.9),
        "iou": _quantile(iou, 0.5),
    }


def _quantile(values: np.ndarray, share: float) -> float:
    values = values[~np.isnan(values)]
    return float(np.quantile(values, share)) if len(values) else float("nan")
