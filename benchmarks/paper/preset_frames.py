"""The preset ``paper`` with other settings on simulated frames; corners are stored."""

from dataclasses import replace
from functools import lru_cache
from typing import Any

import cv2
import numpy as np

from benchmarks.baselines.sortgap import sort_and_gap
from benchmarks.paper.shots import Shot, frames_of
from benchmarks.paper.systems import eval_config
from benchmarks.scores.group import group_objects
from jaxdet import reference, stages
from jaxdet.config import Config, FeaturesConfig
from jaxdet.eval import FrameTruth, Tally, evaluate_frames
from jaxdet.floor.plane import plane_in_color
from jaxdet.reference.paper._canny import grey
from jaxdet.types import Calibration, Detections, Features, GroundPlane, Labels, Points

BATCH = 16


class PresetFrames:
    """Frames with their floor; the corners are computed once per setting.

    Args:
        shots: Frames of one camera.
        config: Preset whose settings are changed.
    """

    def __init__(self, shots: list[Shot], config: Config) -> None:
        self.shots, self.config = shots, config
        self.calibration: Calibration = shots[0].calibration
        self.counted = eval_config(config)
        self.truths = [_labels_only(shot.color_truth) for shot in shots]
        self.parts = [self._batch(n) for n in range(0, len(shots), BATCH)]
        self.features = lru_cache(maxsize=16)(self._features)

    def _batch(self, first: int) -> tuple[np.ndarray, np.ndarray, GroundPlane]:
        frames = frames_of(self.shots[first : first + BATCH])
        assert frames.plane is not None and frames.color is not None
        plane = plane_in_color(frames.plane, self.calibration)
        return frames.color, frames.depth, plane

    def _features(self, settings: FeaturesConfig) -> list[Features]:
        return [self._above_floor(*part, settings) for part in self.parts]

    def _above_floor(
        self, color: np.ndarray, depth: np.ndarray, plane: GroundPlane, settings: FeaturesConfig
    ) -> Features:
        found = stages.paper.features(color, depth, self.calibration, settings)
        found = stages.paper.ground(found, plane, self.calibration, self.config)
        return Features(*(np.asarray(a) for a in found))

    def with_bounds(self, share: float) -> list[Features]:
        """Return corners with the upper threshold at a quantile of the gradients of each frame."""
        each: list[Features] = []
        for color, depth, plane in self.parts:
            found = []
            for b in range(len(color)):
                bound = float(np.quantile(gradient(grey(color[b])), share))
                settings = replace(self.config.features, canny_low=bound / 2, canny_high=bound)
                one = slice(b, b + 1)
                floor = GroundPlane(*(np.asarray(a)[one] for a in plane))
                found.append(self._above_floor(color[one], depth[one], floor, settings))
            each.append(Features(*(np.concatenate(a) for a in zip(*found, strict=True))))
        return each

    def passable(self, width_m: float) -> list[FrameTruth]:
        """Return the truth of each frame with obstacles joined that are less than a width apart."""
        joined = (group_objects(shot.color_truth, width_m, width_m) for shot in self.shots)
        return [_labels_only(truth) for truth in joined]

    def tallies(
        self,
        params: dict[str, Any],
        corners: list[Features] | None = None,
        truths: list[FrameTruth] | None = None,
    ) -> list[Tally]:
        """Return a tally of each frame for the preset with other settings, corners or truths."""
        config, truths = with_settings(self.config, params), truths or self.truths
        unit = self.calibration.depth_unit
        parts = self.features(config.features) if corners is None else corners
        tallies: list[Tally] = []
        for number, (features, (_, depth, plane)) in enumerate(zip(parts, self.parts, strict=True)):
            labels = sort_and_gap(features, unit, config)
            count = (labels.max(axis=1, initial=-1) + 1).astype(np.int32)
            marked = Labels(labels, count)
            outlines = reference.paper.footprint(features, marked, plane, unit, config)
            for b in range(len(labels)):
                one = slice(b, b + 1)
                found = Detections(
                    count[one],
                    features.overflow[one],
                    (depth[one] > 0).any(axis=(1, 2)),
                    type(outlines)(*(None if a is None else a[one] for a in outlines)),
                    points=Points(
                        Features(*(a[one] for a in features)), Labels(labels[one], count[one])
                    ),
                )
                truth = truths[number * BATCH + b]
                tallies += evaluate_frames(found, truth, self.calibration, self.counted)
        return tallies


def _labels_only(truth: FrameTruth) -> FrameTruth:
    """Return the truth without outlines, whose comparison takes most of the time."""
    return truth._replace(footprint=None, nearest_floor_m=None, ground_min=None)


def with_settings(config: Config, params: dict[str, Any]) -> Config:
    """Return a configuration with other settings, by the names of their fields.

    The lower Canny threshold is half of the upper one, as in the paper.
    """
    corners = {k: v for k, v in params.items() if hasattr(config.features, k)}
    if "canny_high" in corners:
        corners["canny_low"] = corners["canny_high"] / 2
    gaps = {k: v for k, v in params.items() if hasattr(config.cluster, k)}
    return replace(
        config,
        features=replace(config.features, **corners),
        cluster=replace(config.cluster, **gaps),
    )


def gradient(image: np.ndarray) -> np.ndarray:
    """Return Canny's gradient of a grey image ``(H, W)``: L1 norm of Sobel filters, int16."""
    across, down = (cv2.Sobel(image, cv2.CV_16S, *order, ksize=3) for order in ((1, 0), (0, 1)))
    return np.abs(across) + np.abs(down)
