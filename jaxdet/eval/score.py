"""Scores of detections against the truth, frame by frame, added up over a log.

The rule. Each kept feature votes for the truth object it lies on, or for the nearest one within
``tolerance_px``, since the corners of a contour fall beside the object; obstacles go before
walls and walls before floor. A detection *belongs* to the object that gets most of its votes (of
equals, the one with the smaller number, the floor first).
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from jaxdet.types import Detections


@dataclass(frozen=True)
class EvalConfig:
    """What counts as an obstacle to be found, and when it is."""

    min_depth_m: float = 0.15
    """An obstacle nearer than this is not asked for [m]."""
    max_depth_m: float = 4.0
    """An obstacle whose nearest visible point is farther is not asked for [m]."""
    min_visible_pixels: int = 400
    """An obstacle with fewer visible colour pixels is not asked for."""
    tolerance_px: int = 2
    """How far beside an object its features may lie [pixel], along rows and columns."""
    merge_share: float = 0.2
    """An object with at least this share of a detection's votes is part of it."""


class FrameTruth(NamedTuple):
    """The truth of ``B`` frames with ``J`` objects; object ``j`` has the number ``j + 1``."""

    obstacle_id: np.ndarray
    """``(B, H, W)`` integer, number of the object at each colour pixel, 0 = floor or nothing."""
    visible_pixels: np.ndarray
    """``(B, J)`` integer, colour pixels that show the object."""
    nearest_m: np.ndarray
    """``(B, J)`` float, smallest z of its visible surface in the colour camera [m]."""
    nearest_forward_m: np.ndarray
    """``(B, J)`` float, distance of its nearest face: smallest forward coordinate of its visible
    surface in the camera's ground frame [m]."""
    is_wall: np.ndarray
    """``(J,)`` bool, walls need not be found and are no mistake."""


class Tally(NamedTuple):
    """Counts that add up over frames, batches and logs."""

    frames: int = 0
    visible: int = 0
    """Obstacles asked for, each frame anew."""
    found: int = 0
    """Of those, the ones to which a detection belongs."""
    detections: int = 0
    matched: int = 0
    """Detections that belong to an obstacle, asked for or not."""
    on_floor: int = 0
    """Detections that belong to the floor, or to nothing."""
    on_wall: int = 0
    """Detections that belong to a wall."""
    splits: int = 0
    """Detections beyond the first that belong to one obstacle in one frame."""
    merges: int = 0
    """Obstacles beyond the first that are part of one detection."""
    position_errors: tuple[float, ...] = ()
    """For each obstacle found, how far the distance of its nearest face is off: forward
    coordinate of point C of its largest detection, against the truth [m]."""


def total(tallies: Iterable[Tally]) -> Tally:
    """All tallies as one."""
    every = list(tallies)
    counts = [sum(numbers) for numbers in zip(*(one[:9] for one in every), strict=True)]
    errors = tuple(e for one in every for e in one.position_errors)
    return Tally(*counts, position_errors=errors)


class Score(NamedTuple):
    """The figures of a log; NaN where there was nothing to count."""

    recall: float
    """Found / visible."""
    precision: float
    """Matched / (detections - those on walls)."""
    f1: float
    """Harmonic mean of the two."""
    position_error_m: float
    """Median of the position errors [m]."""
    position_error_p90_m: float
    """Their 90th percentile [m]."""
    tally: Tally


def _ratio(part: float, whole: float) -> float:
    return part / whole if whole else float("nan")


def score(tallies: Iterable[Tally]) -> Score:
    """The figures of all tallies together."""
    tally = total(tallies)
    recall = _ratio(tally.found, tally.visible)
    precision = _ratio(tally.matched, tally.detections - tally.on_wall)
    errors = np.array(tally.position_errors or [np.nan])
    median, p90 = np.quantile(errors, [0.5, 0.9]).tolist()
    f1 = _ratio(2 * recall * precision, recall + precision)
    return Score(recall, precision, f1, median, p90, tally)


def evaluate(
    detections: Detections,
    truth: FrameTruth,
    depth_unit: float = 0.001,
    config: EvalConfig | None = None,
    valid: np.ndarray | None = None,
) -> Tally:
    """Compare a batch of detections with the truth.

    Args:
        detections: Of ``B`` frames, from either backend; ``u v`` of the features, the labels,
            the points ``c`` and ``num_obstacles`` are used.
        truth: Of the same frames.
        depth_unit: Metres in one depth unit.
        config: What counts.
        valid: ``(B,)`` bool, False marks padding; None: all frames count.

    Returns:
        Their tally; :func:`score` makes figures of one or more.

    Raises:
        ValueError: The truth is of another number of frames.
    """
    config = config or EvalConfig()
    labels = np.asarray(detections.labels.labels)
    u, v = np.asarray(detections.features.u), np.asarray(detections.features.v)
    forward_m = np.asarray(detections.obstacles.c)[..., 1] * depth_unit
    if len(labels) != len(truth.obstacle_id):
        raise ValueError(f"{len(labels)} frames, but the truth of {len(truth.obstacle_id)}")
    tallies: list[Tally] = []
    for b in range(len(labels)):
        if valid is not None and not valid[b]:
            continue
        used = labels[b] >= 0
        ids = feature_objects(
            truth.obstacle_id[b], truth.is_wall, u[b, used], v[b, used], config.tolerance_px
        )
        objects, count = len(truth.is_wall) + 1, int(detections.labels.num_obstacles[b])
        votes = np.bincount(labels[b, used] * objects + ids, minlength=count * objects)
        votes = votes.reshape(count, objects)
        tallies.append(_tally_frame(votes, forward_m[b, :count], truth, b, config))
    return total(tallies)


def feature_objects(
    obstacle_id: np.ndarray, is_wall: np.ndarray, u: np.ndarray, v: np.ndarray, tolerance: int
) -> np.ndarray:
    """The object each feature votes for.

    Args:
        obstacle_id: ``(H, W)`` integer.
        is_wall: ``(J,)`` bool.
        u: ``(n,)`` columns.
        v: ``(n,)`` rows.
        tolerance: How far away it may lie [pixel].

    Returns:
        ``(n,)`` int64 object numbers, 0 = floor.
    """
    reach = np.arange(-tolerance, tolerance + 1)
    dv, du = (a.ravel() for a in np.meshgrid(reach, reach, indexing="ij"))
    order = np.argsort(du * du + dv * dv, kind="stable")
    padded = np.pad(obstacle_id, tolerance).astype(np.int64)
    around = padded[v[:, None] + dv[order] + tolerance, u[:, None] + du[order] + tolerance]
    rank = np.concatenate([[0], np.where(is_wall, 1, 2)])
    best = np.argmax(rank[around], axis=1)
    return np.take_along_axis(around, best[:, None], 1)[:, 0]


def _tally_frame(
    votes: np.ndarray, forward_m: np.ndarray, truth: FrameTruth, b: int, config: EvalConfig
) -> Tally:
    """Frame ``b``: ``votes`` ``(L, J + 1)`` of its detections, ``forward_m`` ``(L,)``."""
    kind = np.concatenate([[0], np.where(truth.is_wall, 1, 2)])
    owner = np.argmax(votes, axis=1) if len(votes) else np.zeros(0, np.int64)
    nearest = truth.nearest_m[b]
    asked = ~truth.is_wall & (truth.visible_pixels[b] >= config.min_visible_pixels)
    asked &= (nearest >= config.min_depth_m) & (nearest <= config.max_depth_m)
    owned = owner[kind[owner] == 2]
    found = np.flatnonzero(asked & np.isin(np.arange(len(asked)) + 1, owned))
    errors: list[float] = []
    for j in found:
        largest = int(np.argmax(np.where(owner == j + 1, votes[:, j + 1], -1)))
        errors.append(abs(float(forward_m[largest] - truth.nearest_forward_m[b, j])))
    shares = votes / np.maximum(votes.sum(1, keepdims=True), 1)
    parts = ((shares >= config.merge_share) & (kind == 2)).sum(1)
    return Tally(
        frames=1,
        visible=int(asked.sum()),
        found=len(found),
        detections=len(owner),
        matched=len(owned),
        on_floor=int((kind[owner] == 0).sum()),
        on_wall=int((kind[owner] == 1).sum()),
        splits=len(owned) - len(np.unique(owned)),
        merges=int(np.maximum(parts - 1, 0).sum()),
        position_errors=tuple(errors),
    )
