"""The settings that the paper leaves open, chosen as the baselines' are: grid, then search.

The paper prints Canny's bounds as examples, and neither N nor the corners' distance nor d_z and
d_x. ``python -m benchmarks.paper.choose`` tries them on the tuning seeds and prints the best;
:mod:`jaxdet.presets` has what it chose.
"""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tyro

from benchmarks.baselines.sortgap import sort_and_gap
from benchmarks.baselines.tune import search
from benchmarks.paper.main import start_worker
from benchmarks.paper.measure import measured
from benchmarks.paper.plan import LIGHTS, PRESET_SEEDS, SCENES, TUNING_SEEDS
from benchmarks.paper.section import percent
from benchmarks.paper.shots import Shot, Spec, Store, frames_of
from benchmarks.paper.systems import eval_config, tuning_objective
from jaxdet import reference, stages
from jaxdet.config import Config, FeaturesConfig
from jaxdet.eval import FrameTruth, Score, Tally, evaluate_frames, score, total
from jaxdet.floor.plane import plane_in_color
from jaxdet.presets import preset
from jaxdet.reference._canny import grey
from jaxdet.types import Calibration, Detections, Features, GroundPlane, Labels, Points

FIRST = {
    "canny_high": 200.0,
    "min_distance": 5.0,
    "min_points": 10,
    "depth_gap_m": 0.1,
    "lateral_gap_m": 0.4,
}
"""What the preset had before (297f469), by guess."""
JUDGED: dict[str, dict[str, Any]] = {
    "first values": FIRST,
    "first values, N = 3": FIRST | {"min_points": 3},
    "first values, N = 3, Canny at 50 and 100": FIRST | {"min_points": 3, "canny_high": 100.0},
    "preset paper with d_z 0.10, d_x 0.40": {"depth_gap_m": 0.1, "lateral_gap_m": 0.4},
    "preset paper": {},
}
"""Variants that are evaluated on the held-out seeds; no setting is chosen by them."""
GRID: dict[str, tuple[Any, ...]] = {
    "canny_high": (100.0, 150.0, 200.0, 300.0),
    "min_distance": (2.0, 3.0, 5.0, 7.0),
    "min_points": (3, 5, 10),
    "depth_gap_m": (0.05, 0.1, 0.2, 0.4),
    "lateral_gap_m": (0.2, 0.4, 0.6),
}
"""Values that the search begins with. Canny's lower bound is half of the upper one, as in all
bounds that the paper prints."""
QUANTILES = (0.80, 0.85, 0.90, 0.95)
"""Of a frame's gradients: laws for Canny's upper bound, tried on the tuning seeds."""
BATCH = 16


class Frames:
    """Tuning frames up to their floor, with the features of each setting made once.

    Args:
        shots: Of one camera.
        config: The preset whose settings are tried.
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
        found = stages.features(color, depth, self.calibration, settings)
        found = stages.ground(found, plane, self.calibration, self.config)
        return Features(*(np.asarray(a) for a in found))

    def with_bounds(self, share: float) -> list[Features]:
        """Corners with the upper bound at a quantile of each frame's own gradients."""
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

    def tallies(self, params: dict[str, Any], corners: list[Features] | None = None) -> list[Tally]:
        """A tally of each frame for the preset with other settings, or with other corners."""
        config = with_settings(self.config, params)
        unit = self.calibration.depth_unit
        parts = self.features(config.features) if corners is None else corners
        tallies: list[Tally] = []
        for number, (features, (_, depth, plane)) in enumerate(zip(parts, self.parts, strict=True)):
            labels = sort_and_gap(features, unit, config)
            count = (labels.max(axis=1, initial=-1) + 1).astype(np.int32)
            marked = Labels(labels, count)
            outlines = reference.footprint(features, marked, plane, unit, config)
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
                truth = self.truths[number * BATCH + b]
                tallies += evaluate_frames(found, truth, self.calibration, self.counted)
        return tallies


def _labels_only(truth: FrameTruth) -> FrameTruth:
    """The truth without what outlines are compared with, which takes most of the time."""
    return truth._replace(footprint=None, nearest_floor_m=None, ground_min=None)


def with_settings(config: Config, params: dict[str, Any]) -> Config:
    """A configuration with settings by their names in :data:`GRID`."""
    corners = {k: v for k, v in params.items() if hasattr(config.features, k)}
    if "canny_high" in corners:
        corners["canny_low"] = corners["canny_high"] / 2
    gaps = {k: v for k, v in params.items() if hasattr(config.cluster, k)}
    return replace(
        config,
        features=replace(config.features, **corners),
        cluster=replace(config.cluster, **gaps),
    )


@dataclass(frozen=True)
class Options:
    """Choose the preset paper's settings on the tuning seeds."""

    frames: Path
    """Folder that keeps the simulated frames."""
    seeds: int = len(TUNING_SEEDS)
    """Tuning seeds used; the full report tunes the baselines on as many."""
    judge: bool = False
    """Choose nothing; compare the preset with its first values on seeds used for nothing else."""
    laws: bool = False
    """Choose nothing; compare bounds that follow each frame's gradients, on the tuning seeds."""


def main(options: Options) -> None:
    """Print every better trial, then the best; or the figures on the seeds kept apart."""
    start_worker()
    start, store = time.perf_counter(), Store(options.frames)
    if options.judge:
        specs = _specs(PRESET_SEEDS)
        frames = Frames(store.load(specs), preset("paper"))
        for name, params in JUDGED.items():
            _print(name, specs, frames.tallies(params))
        return
    specs = _specs(TUNING_SEEDS[: options.seeds])
    frames = Frames(store.load(specs), preset("paper"))
    if options.laws:
        _print("preset paper", specs, frames.tallies({}))
        for share in QUANTILES:
            _print(f"quantile {share:g}", specs, frames.tallies({}, frames.with_bounds(share)))
        return
    best, tried = -math.inf, 0

    def value(params: dict[str, Any]) -> float:
        nonlocal best, tried
        found, tried = score(frames.tallies(params)), tried + 1
        judged = tuning_objective(found)
        if judged > best:
            best = judged
            _report(time.perf_counter() - start, tried, params, found)
        return judged

    trials = [dict(zip(GRID, values, strict=True)) for values in product(*GRID.values())]
    chosen = search(trials, list(GRID), value)
    print(f"{len(specs)} frames, {tried} trials; chosen: {chosen.params}")


def _specs(seeds: Sequence[int]) -> list[Spec]:
    """One frame of each scene and seed in each light."""
    return [Spec(scene, seed, 1, light) for scene, seed, light in product(SCENES, seeds, LIGHTS)]


def gradient(image: np.ndarray) -> np.ndarray:
    """Canny's gradient of a grey image ``(H, W)``, by L1 of 3x3 Sobel filters, int16."""
    across, down = (cv2.Sobel(image, cv2.CV_16S, *order, ksize=3) for order in ((1, 0), (0, 1)))
    return np.abs(across) + np.abs(down)


def _print(name: str, specs: Sequence[Spec], tallies: Sequence[Tally]) -> None:
    """Prints figures with intervals, in all lights and in each; a scene is a unit."""
    for light in (None, *LIGHTS):
        units: dict[tuple[str, int], list[Tally]] = {}
        for spec, tally in zip(specs, tallies, strict=True):
            if light in (None, spec.light):
                units.setdefault((spec.family, spec.seed), []).append(tally)
        one = measured([total(unit) for unit in units.values()])
        figures = [percent(one.value(k), one.intervals[k]) for k in ("accuracy", "fmi")]
        shares = f"precision {percent(one.score.precision)} recall {percent(one.score.recall)}"
        print(f"{name}, {light or 'all lights'}: ACC {figures[0]} FMI {figures[1]} {shares}")


def _report(seconds: float, tried: int, params: dict[str, Any], found: Score) -> None:
    figures = f"ACC {found.accuracy:.4f} FMI {found.fmi:.4f} F1 {found.f1:.4f}"
    print(f"{seconds:6.0f} s  trial {tried}: {figures} {params}", flush=True)


if __name__ == "__main__":
    main(tyro.cli(Options))
