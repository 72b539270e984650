"""``jaxdet run --truth``: comparison with a simulated log's ground truth or with labelled boxes."""

from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxdet.camera import cell_side
from jaxdet.config import Config
from jaxdet.errors import ConfigError, InputError
from jaxdet.eval import (
    EvalConfig,
    Tally,
    claimed_floor,
    evaluate,
    floor_positions,
    measured_floor,
    nearest_on_floor,
    score,
    total,
    truth_of,
)
from jaxdet.eval.boxes import evaluate_boxes, near_surface
from jaxdet.eval.labels import read_labels
from jaxdet.reference.paper import align
from jaxdet.results.manifest import fingerprint
from jaxdet.results.metric import distances
from jaxdet.sim import Truth, load_depths, load_drivable, load_obstacle_ids, load_truth
from jaxdet.types import Calibration, Detections

if TYPE_CHECKING:
    from jaxdet.io import Batch

_SUFFIX = ".truth.npz"
_MIN_PIXELS = 1000
"""Minimum number of obstacle pixels per batch for the check that log and ground truth match."""
_MAX_OFF = 0.2
"""Maximum median of ``|ln(z / z_true)|`` on obstacles. With a D435's noise the median is at most
0.06 for the log's own scene, and at least 0.21 for nine of ten other scenes."""


def _identity(path: Path) -> dict[str, Any]:
    file = fingerprint(path)
    return {name: file.get(name) for name in ("size", "fingerprint")}


Observed = Sequence[Tally | str]
"""Counts per batch; a string is the reason why a batch can't be compared."""


def _summary(seen: Observed) -> dict[str, Any] | None:
    """Return the metrics of a log, or an error; None if no frame was compared."""
    tallies = [one for one in seen if isinstance(one, Tally)]
    if len(tallies) < len(seen):
        return {"error": next(one for one in seen if isinstance(one, str))}
    figures = score(tallies) if tallies else None
    return figures.to_dict() if figures and figures.tally.frames else None


def score_against(truth: Path, config: Config, logs: int) -> "TruthScore | LabelScore":
    """Return the observer that compares a run's detections with ground truth.

    Args:
        truth: Simulated log, its ground truth file, or a JSON file of labelled boxes.
        config: Configuration of the run.
        logs: Number of logs of the run.

    Raises:
        ConfigError: A file of labels is passed for several logs.
        InputError: The ground truth can't be read.
    """
    if truth.suffix.lower() != ".json":
        simulated = TruthScore(truth, config)
        simulated.check()
        return simulated
    if logs != 1:
        problem = f"labels refer to one log, got {logs} logs"
        raise ConfigError(problem, path=str(truth), remedy="run the logs one by one")
    return LabelScore(truth, config)


class LabelScore:
    """Observer that compares image boxes with labelled boxes (:class:`jaxdet.engine.Observer`).

    A labelled object is required if the depth in its box is within the method's range. Frames
    without labels are skipped.

    Args:
        path: JSON file (:func:`jaxdet.eval.labels.read_labels`).
        config: Configuration with the depth range.

    Raises:
        InputError: The file can't be read, or is not a file of labels.
    """

    summary = staticmethod(_summary)

    def __init__(self, path: Path, config: Config) -> None:
        self._path, self._ground = str(path), config.ground
        self._labels = read_labels(path)
        self.file = _identity(path)
        """Size and fingerprint of the file of labels; the results record them."""

    def __call__(self, batch: "Batch", found: Detections) -> Tally | str:
        """Return a batch's counts, or why it can't be compared; ``found`` has NumPy arrays."""
        frames, numbers = batch.frames, np.asarray(batch.frames.number).tolist()
        labels = [
            self._labels.get(("frame", number), self._labels.get(("stamp_ns", stamp)))
            for number, stamp in zip(numbers, frames.stamp_ns.tolist(), strict=True)
        ]
        if not any(labels):
            return Tally()
        calibration = frames.calibration
        image, unit = calibration.image, calibration.depth_unit
        z_m = align(np.asarray(frames.depth), calibration).z * unit
        boxes = np.concatenate([found.obstacles.uv_min, found.obstacles.uv_max], axis=-1)
        distance_m = distances(found) * unit
        tallies = []
        for b in np.flatnonzero(frames.valid).tolist():
            own, count = labels[b], int(found.num_obstacles[b])
            if own is None:
                continue
            if own.size not in (None, (image.width, image.height)):
                size = "the labels are for images of {} x {} pixels, but the log has {} x {}"
                problem = size.format(*own.size, image.width, image.height)
                return str(InputError(problem, path=self._path))
            required = np.array([self._is_in_range(z_m[b], box) for box in own.boxes], bool)
            one = evaluate_boxes(own, required, boxes[b, :count], distance_m[b, :count])
            tallies.append(one)
        return total(tallies)

    def _is_in_range(self, z_m: np.ndarray, box: np.ndarray) -> bool:
        """Return whether the near surface in a box is in the depth range."""
        left, top, right, bottom = np.rint(box).astype(np.int64).clip(0).tolist()
        z_m = z_m[top : bottom + 1, left : right + 1]
        near = near_surface(z_m[z_m > 0])
        return self._ground.min_depth_m <= near <= self._ground.max_depth_m


class TruthScore:
    """Observer that compares detections with ground truth (:class:`jaxdet.engine.Observer`).

    Frames are matched by the timestamp of the depth image. If log and ground truth don't match, the
    log gets an error instead of a score; its results are kept.

    Args:
        path: Simulated log, or its ground truth file.
        config: Configuration of the run; its depth range determines the required obstacles.
    """

    def __init__(self, path: Path, config: Config) -> None:
        self._log = Path(str(path).removesuffix(_SUFFIX))
        self.file = _identity(Path(f"{self._log}{_SUFFIX}"))
        """Size and fingerprint of the ground truth file; the results record them."""
        ground = config.ground
        self._method = config
        self.config = EvalConfig(
            ground.min_depth_m,
            ground.max_depth_m,
            step_height_m=ground.step_height_m,
            footprint=config.footprint,
        )

    def check(self) -> None:
        """Read the ground truth, without its images.

        Raises:
            InputError: The file does not exist or can't be read.
        """
        load_truth(self._log)

    def __call__(self, batch: "Batch", found: Detections) -> Tally | str:
        """Return a batch's counts, or why it can't be compared; ``found`` has NumPy arrays."""
        try:
            return self._compare(batch, found)
        except InputError as error:
            return str(error)

    def _compare(self, batch: "Batch", found: Detections) -> Tally:
        truth, frames = self._truth, batch.frames
        numbers = [self._number.get(stamp, -1) for stamp in frames.stamp_ns.tolist()]
        known = np.array(numbers) >= 0
        if not known.any():
            return Tally()
        which = np.where(known, numbers, 0)
        loads = load_obstacle_ids, load_depths, load_drivable
        images = [load(self._log, which) for load in loads]
        calibration = frames.calibration
        size = calibration.image.height, calibration.image.width
        if images[0].shape[1:] != size or images[0].max(initial=0) > len(truth.is_wall):
            problem, remedy = (
                "the ground truth belongs to other images",
                "pass the ground truth of this log",
            )
            raise InputError(problem, path=str(self._log), remedy=remedy)
        # In the preset paper, lengths refer to the colour camera.
        lengths = Calibration(calibration.image) if self._method.cluster.points else calibration
        unit, valid = calibration.depth_unit, frames.valid & known
        z_m = align(np.asarray(frames.depth), calibration).z * unit
        self._check_depth(z_m[valid], *(of_all[valid] for of_all in images[:2]))
        ids, depths, drivable = images
        shown = truth_of(truth, which, ids, depths, drivable, lengths)
        mount = truth.camera_height, truth.camera_pitch, truth.camera_roll
        height, pitch, roll = (of_all[which] for of_all in mount)
        step_m = self.config.step_height_m
        nearest = nearest_on_floor(shown, lengths, height, pitch, roll, step_m)
        shown = shown._replace(nearest_floor_m=nearest)
        side = cell_side(calibration.depth, self._method.surface.cell_rad)
        right = evaluate(found, shown, calibration, self.config, valid, side)
        poses = truth.T_world_camera[which]
        floor_m = floor_positions(images[1], images[2], lengths, poses)
        floor_m = measured_floor(floor_m, images[1], z_m, self.config)
        return total([right, *claimed_floor(found, floor_m, unit, self.config, valid)])

    def _check_depth(self, z_m: np.ndarray, ids: np.ndarray, true_m: np.ndarray) -> None:
        """Check depths on obstacles against true depths, to notice the truth of another log.

        The timestamps of two logs may be equal.

        Raises:
            InputError: The depths differ too much.
        """
        low, high = self.config.min_depth_m, self.config.max_depth_m
        seen = (ids > 0) & (z_m > 0) & (true_m >= low) & (true_m <= high)
        if np.count_nonzero(seen) < _MIN_PIXELS:
            return
        off = np.median(np.abs(np.log(z_m[seen] / true_m[seen])))
        if off > _MAX_OFF:
            problem = "the log's depth does not match the obstacles of the ground truth"
            remedy = "pass the ground truth, depth unit and calibration of this log"
            raise InputError(problem, path=str(self._log), remedy=remedy)

    summary = staticmethod(_summary)

    @cached_property
    def _truth(self) -> Truth:
        return load_truth(self._log)

    @cached_property
    def _number(self) -> dict[int, int]:
        return {stamp: number for number, stamp in enumerate(self._truth.depth_stamp_ns.tolist())}
