"""Systems that are compared, and the task of a worker: run them on some frames and score them."""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.baselines import BASELINES, Baseline, Frame, detect_with, prepare, tune
from benchmarks.paper.shots import Shot, frames_of, load_shots
from benchmarks.scores.group import group_objects
from benchmarks.scores.negatives import negative_samples, with_negatives
from jaxdet import detect
from jaxdet.camera import cell_side
from jaxdet.config import ClusterConfig, Config
from jaxdet.eval import EvalConfig, FrameTruth, Score, Tally, evaluate_frames
from jaxdet.presets import preset
from jaxdet.results.rows import to_host
from jaxdet.types import Detections

DEFAULT = "default"
"""Name of the default of jaxdet."""
PAPER = "preset_paper"
"""Name of the complete method of the paper."""
RULE = "paper"
"""Name of the paper's rule, on the same points as the baselines and tuned in the same way."""
RIVALS = tuple(name for name, b in BASELINES.items() if name != RULE and not b.missing)
"""Names of the clustering baselines whose packages are installed."""
QUICK_RIVALS = (
    "hierarchical_ward",
    "hierarchical_default",
    "hierarchical_single",
    "rsc",
    "dbscan",
)
"""Baselines of a quick report: RSC, two readings of the traditional method, two common methods."""
MISSING = {name: b.missing for name, b in BASELINES.items() if b.missing}
JOIN_M = (0.40, 0.10)
"""Largest lateral and depth gap between obstacles that are joined [m]."""
CITED = ("birch", "perch", "rock", "cure", "chameleon", "ddc", "dcc")
"""Methods in Section 2 of the paper other than hierarchical clustering and RSC, in its order."""
LEARNT = (
    "Its weights were trained on 21,570 simulated frames of the same and of harder families, with "
    "other seeds, and on two thirds of the labelled real frames. The two or three parameters of a "
    "baseline are chosen on one frame per scene, light and tuning seed."
)
"""Training data of the default, for the report."""
LEAST_POINTS = 18
"""Clusters of the baselines with this many points or fewer are discarded. They cluster corners and
a grid of pixels, thus more points than the preset ``paper``."""
INDEXED = (DEFAULT, PAPER, RULE, "hierarchical_ward", "rsc", *CITED)
"""Systems of Table 1, for which internal indices are computed."""
INDEXED_LIGHT = "normal"
"""Light of Table 1."""
JOINED = "joined:"
"""Prefix of a system's name: scores with obstacles joined by :data:`JOIN_M`."""
NEGATIVES = "negatives:"
"""Prefix of a system's name: scores with joined obstacles and negative samples, as in the paper."""


class System(NamedTuple):
    """Method with its parameters."""

    name: str
    title: str
    method: str
    """:data:`DEFAULT`, or a key of :data:`benchmarks.baselines.BASELINES`."""
    config: Config
    params: tuple[tuple[str, Any], ...] = ()

    @property
    def baseline(self) -> Baseline:
        """Baseline of this system."""
        return BASELINES[self.method]

    @property
    def params_text(self) -> str:
        """Parameters with three digits."""
        return ", ".join(
            f"{name} {value:.3g}" if isinstance(value, float) else f"{name} {value}"
            for name, value in self.params
        )


def systems(
    config: Config, tuned: dict[str, dict[str, Any]], rivals: Sequence[str] = RIVALS
) -> list[System]:
    """Return the default, the preset ``paper``, and the baselines with their tuned parameters.

    Args:
        config: Configuration of the default; the baselines have the same preprocessing.
        tuned: Parameters by the name of the baseline.
        rivals: Names of the baselines.
    """
    theirs = of_points(config)
    others = [
        System(name, BASELINES[name].title, name, theirs, tuple(tuned.get(name, {}).items()))
        for name in (RULE, *rivals)
    ]
    return [default(config), paper(), *others]


def default(config: Config) -> System:
    """Return the default method."""
    return System(DEFAULT, "Default of jaxdet", DEFAULT, config)


def paper() -> System:
    """Return the complete method of the paper, from alignment to outlines."""
    return System(PAPER, "Preset paper", DEFAULT, preset("paper"))


def of_points(config: Config) -> Config:
    """Return the configuration of the baselines: the default's, with clustering of points."""
    return replace(config, cluster=ClusterConfig(points=True, min_points=LEAST_POINTS))


def eval_config(config: Config, *, indices: bool = False) -> EvalConfig:
    """Return the evaluation for the range and step of a configuration; ``indices`` take long."""
    ground = config.ground
    return EvalConfig(
        ground.min_depth_m,
        ground.max_depth_m,
        step_height_m=ground.step_height_m,
        footprint=config.footprint,
        indices=indices,
    )


class Prepared:
    """Frames, and the points that baselines cluster, computed once per configuration.

    Args:
        shots: Frames of one camera.
    """

    def __init__(self, shots: Sequence[Shot]) -> None:
        self.shots = shots
        self._frames: dict[Config, list[Frame]] = {}

    def frames(self, config: Config) -> list[Frame]:
        """Return the prepared frames, one per shot."""
        if config not in self._frames:
            self._frames[config] = prepare(frames_of(self.shots), config)
        return self._frames[config]


def truth_for(config: Config, shot: Shot) -> FrameTruth:
    """Return the ground truth for the camera that the lengths of a method refer to."""
    return shot.color_truth if config.cluster.points else shot.truth


def tally_of(
    shot: Shot,
    found: Detections,
    config: Config,
    counted: EvalConfig | None = None,
    truth: FrameTruth | None = None,
) -> Tally:
    """Compare the detections of a frame with the ground truth.

    Args:
        shot: Frame.
        found: Its detections, ``B = 1``.
        config: Configuration of the method.
        counted: Configuration of the evaluation; default: :func:`eval_config`.
        truth: Ground truth; default: :func:`truth_for`.
    """
    counted, truth = counted or eval_config(config), truth or truth_for(config, shot)
    side = cell_side(shot.calibration.depth, config.surface.cell_rad)
    return evaluate_frames(found, truth, shot.calibration, counted, side=side)[0]


def found_by(system: System, prepared: Prepared) -> list[Detections]:
    """Return the obstacles of each frame, as batches of one.

    The floor follows from the mount of the camera; except with the preset ``paper``, each frame
    corrects it.
    """
    config = system.config
    if system.method == DEFAULT:
        each = [frames_of([shot]) for shot in prepared.shots]
        return [to_host(detect(frames, config, backend="jax", with_cells=True)) for frames in each]
    frames, params = prepared.frames(config), dict(system.params)
    return [detect_with(system.baseline, frame, config, params) for frame in frames]


def joined(truth: FrameTruth) -> FrameTruth:
    """Return the ground truth with obstacles joined by :data:`JOIN_M`, without outlines."""
    return group_objects(truth, *JOIN_M)._replace(footprint=None)


def judge(task: tuple[Path, tuple[System, ...]]) -> dict[str, list[Tally]]:
    """Run every system on every frame of a file; task of a worker.

    Returns:
        A tally per frame, by the name of the system, also with the prefixes :data:`JOINED` and
        :data:`NEGATIVES`.
    """
    path, chosen = task
    shots = load_shots(path)
    indexed = INDEXED if shots[0].spec.light == INDEXED_LIGHT else ()
    prepared, samples = Prepared(shots), [samples_of(shot) for shot in shots]
    out: dict[str, list[Tally]] = {}
    for system in chosen:
        config = system.config
        mine, together, paired = [], [], []
        counted, plainly = eval_config(config, indices=system.name in indexed), eval_config(config)
        for found, shot, own in zip(found_by(system, prepared), shots, samples, strict=True):
            whole = joined(truth_for(config, shot))
            mine.append(tally_of(shot, found, config, counted))
            together.append(tally_of(shot, found, config, plainly, whole))
            side = cell_side(shot.calibration.depth, config.surface.cell_rad)
            paired.append(with_negatives(together[-1], own, found, shot.calibration, side))
        out[system.name] = mine
        out[JOINED + system.name], out[NEGATIVES + system.name] = together, paired
    return out


def samples_of(shot: Shot) -> np.ndarray:
    """Return the negative samples of a frame, by the corners and the range of preset ``paper``."""
    config = preset("paper")
    return negative_samples(
        shot.color, shot.color_truth, config.features, config.ground.max_depth_m
    )


def tuning_objective(figures: Score) -> float:
    """Return the objective of tuning: the mean of ACC, FMI and F1."""
    return (figures.accuracy + figures.fmi + figures.f1) / 3


class TuningTask(NamedTuple):
    """Baseline to tune on the frames in some files."""

    name: str
    paths: tuple[Path, ...]
    config: Config


def tune_one(task: TuningTask) -> tuple[dict[str, Any], float]:
    """Return the best parameters of a baseline and their objective; task of a worker."""
    frames, truths = _tuning_frames(task.paths, task.config)
    counted = eval_config(task.config)
    best = tune(BASELINES[task.name], frames, truths, tuning_objective, task.config, counted)
    return best.params, best.value


@lru_cache(maxsize=1)
def _tuning_frames(paths: tuple[Path, ...], config: Config) -> tuple[list[Frame], list[FrameTruth]]:
    shots = [shot for path in paths for shot in load_shots(path)]
    frames = [frame for shot in shots for frame in prepare(frames_of([shot]), config)]
    return frames, [truth_for(config, shot) for shot in shots]
