"""Figures from tallies."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from jaxdet.eval.tally import COUNTS, Case, Tally, total


class Score(NamedTuple):
    """The figures of a log; NaN where there was nothing to count.

    With TP obstacles found, FN missed and FP false detections (:mod:`jaxdet.eval.frame`):
    """

    recall: float
    """``TP / (TP + FN)``."""
    precision: float
    """``TP / (TP + FP)``."""
    f1: float
    """``2 TP / (2 TP + FP + FN)``."""
    accuracy: float
    """ACC as we read it, ``TP / (TP + FP + FN)``: correct clusters among all that were found or
    should have been. The paper labels "ground shadows, noise, or other non-existent situations"
    as negative samples, so its ACC is ``(TP + TN) / (TP + TN + FP + FN)``; a true negative is
    something that isn't there and wasn't found, which can't be counted without inventing it, and
    leaving TN out can only lower the figure."""
    point_accuracy: float
    """ACC as the literature on clustering has it: the share of points with the right label, the
    labels matched one to one to the obstacles, where "no label" is right on floor and nothing."""
    fmi: float
    """Fowlkes-Mallows index over the points, the mean of the frames', see
    :func:`jaxdet.eval.partition.fowlkes_mallows`."""
    fmi_pooled: float
    """The same from the pairs of all frames together."""
    fmi_obstacles: float
    """``sqrt(precision recall)``: the same formula over obstacles. The paper's figures fit this
    one: its precision 85.54 and recall 90.22 give 0.8785, its FMI is 0.8773."""
    silhouette: float
    """Mean of the frames' silhouette coefficients, see
    :func:`jaxdet.eval.indices.silhouette`."""
    davies_bouldin: float
    """Mean of the frames' Davies-Bouldin indices."""
    coverage: float
    """Of the points on the visible side of the footprints of obstacles found (every centimetre
    along the edges of the convex hull that face the camera, within ``coverage_range_m`` and the
    visible surface's extent), the share in the rectangle of the obstacle's detection,
    ``coverage_margin_m`` allowed."""
    safe_coverage: float
    """Of these points of all obstacles asked for, found or not, the share in any rectangle."""
    floor_kept: float
    """Share of the floor's pixels that the ground stage keeps."""
    obstacle_kept: float
    """Share of the pixels on obstacles, above the step, that it keeps."""
    free_claimed: float
    """Of the pixels of drivable floor that are near and measured as floor, the share inside of any
    outline, see :func:`jaxdet.eval.claimed_floor`; what hangs takes none."""
    free_claimed_worst: float
    """The same in the worst frame."""
    nearest_error_m: float
    """Median of the absolute errors of ``distance_m`` against the nearest visible point [m]."""
    nearest_error_p90_m: float
    """Their 90th percentile [m]."""
    nearest_bias_m: float
    """Median of these errors with their sign, negative where ``distance_m`` is too near [m]."""
    position_error_m: float
    """Median of the absolute errors of the forward coordinate of point C [m]."""
    position_error_p90_m: float
    """Their 90th percentile [m]."""
    width_error_m: float
    """Median of the width's absolute errors [m]."""
    width_error_p90_m: float
    """Their 90th percentile [m]."""
    iou: float
    """Median overlap of the rectangles with the true footprints."""
    tally: Tally

    def to_dict(self) -> dict[str, float]:
        """All figures and counts by name."""
        figures = {k: v for k, v in self._asdict().items() if k != "tally"}
        return {**figures, **self.tally.to_dict()}


def score(tallies: Iterable[Tally]) -> Score:
    """The figures of all tallies together."""
    tally = total(tallies)
    shares = {k: float(v) for k, v in rates(np.array(tally.counts, np.float64)).items()}
    worst = max(tally.claims, default=float("nan"))
    figures = shares | errors(case_table(tally.cases)) | {"free_claimed_worst": worst}
    return Score(**figures, tally=tally)


def rates(counts: np.ndarray) -> dict[str, np.ndarray]:
    """The figures that are ratios of counts.

    Args:
        counts: ``(..., C)`` float64, in the order of :data:`jaxdet.eval.tally.COUNTS`.

    Returns:
        By name, each ``(...)`` float64; NaN where the denominator is 0.
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
    """The cases as ``(n, 7)`` float64, columns as the fields of :class:`Case`."""
    return np.array(cases, np.float64).reshape(len(cases), len(Case._fields))


def errors(cases: np.ndarray) -> dict[str, float]:
    """The figures that are quantiles over the obstacles found.

    Args:
        cases: ``(n, 7)`` float64, see :func:`case_table`.

    Returns:
        By name; NaN where nothing was measured.
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
