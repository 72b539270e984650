"""Evaluation of detections against ground truth, frame by frame.

Each kept point votes for the object in its pixel, or for a neighbouring object at its depth
(:func:`objects_of`). Points are the corners of the preset ``paper``, otherwise the depth cells
(``detect(..., with_cells=True)``) in the colour image, to which the ground truth refers. A
detection and an obstacle may match if at least half of the detection's votes are for the obstacle;
matches are one to one and maximise the votes (:func:`jaxdet.eval.match.match`). Then

- a required obstacle is *found* (true positive) if it is matched, otherwise *missed*;
- an unmatched detection is *false*, even if it is a second detection of an obstacle;
- an unmatched detection is *ignored* if half of its votes are on walls, if it could match an
  obstacle that is not required (too far, mostly hidden, lower than the step), or if its cells are
  outside of the colour image.
"""

import math
from dataclasses import dataclass

import numpy as np

from jaxdet.eval.indices import davies_bouldin, silhouette
from jaxdet.eval.match import eligible, feature_objects, match, measured_objects, vote_table
from jaxdet.eval.partition import fowlkes_mallows, pair_counts
from jaxdet.eval.shapes import Shapes, count_shapes
from jaxdet.eval.tally import Tally, total
from jaxdet.eval.truth import EvalConfig, FrameTruth
from jaxdet.reference._cells import cell_boxes
from jaxdet.results.metric import distances, floors
from jaxdet.types import Calibration, CellLabels, Detections, Features


def evaluate(
    detections: Detections,
    truth: FrameTruth,
    calibration: Calibration | None = None,
    config: EvalConfig | None = None,
    valid: np.ndarray | None = None,
    side: int | None = None,
) -> Tally:
    """Evaluate a batch of detections: the sum of :func:`evaluate_frames`."""
    return total(evaluate_frames(detections, truth, calibration, config, valid, side))


def evaluate_frames(
    detections: Detections,
    truth: FrameTruth,
    calibration: Calibration | None = None,
    config: EvalConfig | None = None,
    valid: np.ndarray | None = None,
    side: int | None = None,
) -> list[Tally]:
    """Evaluate each frame of a batch.

    Args:
        detections: Detections of ``B`` frames, from either backend or another method; with cells if
            obstacles are made of surfaces. Their obstacles need the field ``c``; also ``a`` and
            ``b`` for ``truth.ground_min``, ``has_vertex`` for ``truth.footprint``, and contours, or
            ``a`` and ``b``, for ``truth.nearest_floor_m``.
        truth: Ground truth of these frames; it refers to the colour image.
        calibration: Calibration of the log. If detections have points, only its depth unit is used;
            None: millimetres.
        config: Evaluation parameters.
        valid: Mask ``(B,)`` bool, False for padding; None: all frames count.
        side: Side of a cell [depth pixel], see :func:`jaxdet.camera.cell_side`; None: detections
            have points.

    Returns:
        A tally per frame without padding, for :func:`jaxdet.eval.score`.

    Raises:
        ValueError: The number of frames differs, or cells lack their calibration.
    """
    config = config or EvalConfig()
    frames = len(detections.num_obstacles)
    depth_unit = calibration.depth_unit if calibration else 0.001
    if frames != len(truth.obstacle_id):
        raise ValueError(
            f"{frames} frames of detections, but ground truth of {len(truth.obstacle_id)} frames"
        )
    required = truth.required(config)
    distances_m = None
    if truth.nearest_floor_m is not None:
        distances_m = distances(detections) * depth_unit
        if detections.scene is not None:
            unknown = ~floors(detections.scene, depth_unit).plane.valid
            distances_m[unknown] = np.nan
    tallies: list[Tally] = []
    for b in range(frames):
        if valid is None or valid[b]:
            points, labels = points_of(detections, b, calibration, side)
            count = int(detections.num_obstacles[b])
            frame = _match_frame(points, labels, count, truth, b, required[b], depth_unit, config)
            shapes = Shapes(detections, truth, b, frame.count, depth_unit, config, distances_m)
            parts = [
                _count_detections(frame, config),
                _count_points(frame, config),
                count_shapes(frame.required, frame.pair, shapes, config),
            ]
            tallies.append(total(parts)._replace(frames=1))
    return tallies


@dataclass(frozen=True)
class _Matched:
    """Points of a frame, its ``L`` detections, and the matches between detections and objects."""

    labels: np.ndarray
    """Label of each point, ``(n,)``."""
    objects: np.ndarray
    """Object number of each point, ``(n,)``."""
    votes: np.ndarray
    """Votes of each detection for each object, ``(L, J + 1)``."""
    pair: np.ndarray
    """Number of the matched obstacle, ``(L,)``, 0 = none."""
    positions: np.ndarray
    """x and z of the points, ``(n, 2)`` [m]."""
    required: np.ndarray
    """Whether each object is required, ``(J + 1,)`` bool."""
    kinds: np.ndarray
    """Kind of each object, ``(J + 1,)``, see :attr:`FrameTruth.kinds`."""

    @property
    def count(self) -> int:
        return len(self.votes)


def points_of(
    detections: Detections, b: int, calibration: Calibration | None, side: int | None
) -> tuple[Features, np.ndarray]:
    """Return the kept or labelled points of frame ``b``, ``(n,)``, and their labels.

    Raises:
        ValueError: The points are cells, and their calibration or side is None.
    """
    if detections.points is not None:
        points, label = detections.points.features, detections.points.labels.labels[b]
        own = Features(*(np.asarray(part[b]) for part in points))
    elif detections.cells is None or calibration is None or side is None:
        raise ValueError("detections need points, or cells together with calibration and side")
    else:
        own, label = cell_points(detections.cells, b, calibration, side), detections.cells.label[b]
    own, label = Features(*(np.ravel(part) for part in own)), np.ravel(label)
    used = own.valid & (own.kept | (label >= 0))
    return Features(*(part[used] for part in own[:-1]), overflow=own.overflow), label[used]


def cell_points(found: CellLabels, b: int, calibration: Calibration, side: int) -> Features:
    """Return the cells of frame ``b`` as points ``(R, C)`` in the colour camera.

    A cell's pixel is the centre of its box; cells inside the colour image are valid.
    """
    xyz = np.stack([np.asarray(axis[b]) for axis in found.cells]).astype(np.int32)
    low, high, inside = (part[0] for part in cell_boxes(xyz[2:], calibration, side))
    u, v = np.moveaxis((low + high) // 2, -1, 0)
    if calibration.color_from_depth is not None:
        T = calibration.color_from_depth.T
        shift = T[:3, 3] / calibration.depth_unit
        moved = np.tensordot(T[:3, :3], xyz, axes=1) + shift[:, None, None]
        xyz = np.rint(moved).astype(np.int32)
    x, y, z = xyz
    kept = np.asarray(found.keep[b]) & inside
    return Features(u, v, x, y, z, inside, kept, overflow=np.zeros(1, bool))


def _match_frame(
    points: Features,
    labels: np.ndarray,
    count: int,
    truth: FrameTruth,
    b: int,
    required: np.ndarray,
    depth_unit: float,
    config: EvalConfig,
) -> _Matched:
    objects = objects_of(points, truth, b, depth_unit, config)
    positions = np.stack([points.x, points.z], axis=-1) * depth_unit
    kinds = truth.kinds
    votes = vote_table(labels, objects, count, len(kinds))
    pair = match(votes, kinds == 2, config.match_share)
    required = np.concatenate([[False], required])
    return _Matched(labels, objects, votes, pair, positions, required, kinds)


def objects_of(
    points: Features, truth: FrameTruth, b: int, depth_unit: float, config: EvalConfig
) -> np.ndarray:
    """Return the object number of each point of frame ``b``, ``(n,)`` int64, 0 = floor.

    The object is that at or next to the point's pixel (:func:`feature_objects`). If the true depth
    is known and only a neighbouring pixel has the measured depth, the object is that in the
    neighbouring pixel (:func:`measured_objects`).
    """
    u, v, z = points.u, points.v, points.z
    ids = truth.obstacle_id[b]
    by_pixel = feature_objects(ids, truth.is_wall, u, v, config.tolerance_px)
    if truth.depth_m is None:
        return by_pixel
    z = z * depth_unit
    by_depth = measured_objects(
        ids, truth.depth_m[b], truth.is_wall, u, v, z, config.depth_slack(z), config.smear_px
    )
    return np.where(by_depth >= 0, by_depth, by_pixel)


def _count_detections(frame: _Matched, config: EvalConfig) -> Tally:
    votes, kinds, required = frame.votes, frame.kinds, frame.required
    whole = np.maximum(votes.sum(axis=1), 1)
    could = eligible(votes, kinds == 2, config.match_share)
    true_positive = required[frame.pair]
    elsewhere = ~true_positive & (could & ~required).any(axis=1)
    elsewhere |= ~true_positive & (votes.sum(axis=1) == 0)
    wall = ~true_positive & ~elsewhere & (votes[:, kinds == 1].sum(axis=1) >= 0.5 * whole)
    false = ~true_positive & ~elsewhere & ~wall
    parts = ((votes >= config.merge_share * whole[:, None]) & (kinds == 2)).sum(axis=1)
    return Tally(
        visible=int(required.sum()),
        found=int(true_positive.sum()),
        detections=len(votes),
        matched=int((frame.pair > 0).sum()),
        false=int(false.sum()),
        ignored=int((elsewhere | wall).sum()),
        on_floor=int((false & (votes[:, 0] >= 0.5 * whole)).sum()),
        on_wall=int(wall.sum()),
        splits=int((false & could.any(axis=1)).sum()),
        merges=int(np.maximum(parts - 1, 0).sum()),
    )


def _count_points(frame: _Matched, config: EvalConfig) -> Tally:
    judged = frame.kinds[frame.objects] != 1
    labels, objects = frame.labels[judged], frame.objects[judged]
    pair = np.append(frame.pair, 0)[labels]
    pairs = pair_counts(labels, np.where(objects > 0, objects, -1))
    fmi = fowlkes_mallows(pairs)
    tally = Tally(
        points=len(labels),
        points_right=int(np.where(objects > 0, pair == objects, labels < 0).sum()),
        pairs_both=pairs.both,
        pairs_detected=pairs.detected,
        pairs_true=pairs.true,
        fmi_sum=0.0 if math.isnan(fmi) else fmi,
        fmi_frames=int(not math.isnan(fmi)),
    )
    if not config.indices or frame.count < 2:
        return tally
    return tally._replace(
        silhouette_sum=silhouette(frame.positions, frame.labels),
        davies_bouldin_sum=davies_bouldin(frame.positions, frame.labels),
        index_frames=1,
    )
