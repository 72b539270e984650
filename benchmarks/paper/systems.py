"""The systems that are compared, and one task of a worker: run them on some frames and score."""

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

OURS = "ours"
PAPER = "preset_paper"
RULE = "paper"
"""The paper's rule on the same points as the baselines, and tuned as they are."""
RIVALS = tuple(name for name, b in BASELINES.items() if name != RULE and not b.missing)
"""The clustering baselines that can run here."""
QUICK_RIVALS = (
    "hierarchical_ward",
    "hierarchical_default",
    "hierarchical_single",
    "rsc",
    "dbscan",
)
"""Baselines of a quick report: the paper's own two, with both readings of the traditional method,
and two that everybody has at hand."""
MISSING = {name: b.missing for name, b in BASELINES.items() if b.missing}
JOIN_M = (0.40, 0.10)
"""Lateral and depth gap that make two obstacles one by the paper's definition [m]."""
CITED = ("birch", "perch", "rock", "cure", "chameleon", "ddc", "dcc")
"""What the paper's Section 2 names beside hierarchical clustering and RSC, in its order."""
LEARNT = (
    "Its weights were learnt from 16,570 simulated frames of the same families and the harder ones "
    "by other seeds, and from two thirds of the labelled real frames; a baseline's two or three "
    "parameters are chosen on one frame of each scene, light and tuning seed."
)
"""What ours has seen, for the report."""
LEAST_POINTS = 18
"""The baselines' clusters of this many points or fewer are dropped: there are some 5,000 points
where the paper has corners alone, and drops 10."""
INDEXED = (OURS, PAPER, RULE, "hierarchical_ward", "rsc", *CITED)
"""The systems of Table 1, whose clusters are judged by internal indices too."""
INDEXED_LIGHT = "normal"
"""The light of Table 1."""
JOINED = "joined:"
"""Prefix of a system's name: scored on the truth with such obstacles joined."""
NEGATIVES = "negatives:"
"""Prefix of a system's name: joined, and with true negatives, the paper's definition of ACC."""


class System(NamedTuple):
    """A method with all its parameters."""

    name: str
    title: str
    method: str
    """``ours``, or a key of :data:`benchmarks.baselines.BASELINES`."""
    config: Config
    params: tuple[tuple[str, Any], ...] = ()

    @property
    def baseline(self) -> Baseline:
        """How it is run, if it is not ours."""
        return BASELINES[self.method]

    @property
    def params_text(self) -> str:
        """Its parameters with three digits."""
        return ", ".join(
            f"{name} {value:.3g}" if isinstance(value, float) else f"{name} {value}"
            for name, value in self.params
        )


def systems(
    config: Config, tuned: dict[str, dict[str, Any]], rivals: Sequence[str] = RIVALS
) -> list[System]:
    """Ours as it comes, the paper's preset, and the baselines with their tuned parameters.

    Args:
        config: Ours; the baselines get the same preprocessing.
        tuned: Parameters by the baseline's name.
        rivals: Names of the baselines.
    """
    theirs = of_points(config)
    others = [
        System(name, BASELINES[name].title, name, theirs, tuple(tuned.get(name, {}).items()))
        for name in (RULE, *rivals)
    ]
    return [ours(config), paper(), *others]


def ours(config: Config) -> System:
    """What is held against hard conditions."""
    return System(OURS, "Ours (default)", OURS, config)


def paper() -> System:
    """The paper's whole method, from alignment to outlines."""
    return System(PAPER, "Ours (preset paper)", OURS, preset("paper"))


def of_points(config: Config) -> Config:
    """What the baselines, which cluster points, get of ours: all but the rule of the least size."""
    return replace(config, cluster=ClusterConfig(points=True, min_points=LEAST_POINTS))


def eval_config(config: Config, *, indices: bool = False) -> EvalConfig:
    """What counts, by the range and step of the configuration; ``indices`` take long."""
    ground = config.ground
    return EvalConfig(
        ground.min_depth_m,
        ground.max_depth_m,
        step_height_m=ground.step_height_m,
        footprint=config.footprint,
        indices=indices,
    )


class Prepared:
    """Frames, and what the baselines get of them, made once for each configuration.

    Args:
        shots: Of one camera.
    """

    def __init__(self, shots: Sequence[Shot]) -> None:
        self.shots = shots
        self._frames: dict[Config, list[Frame]] = {}

    def frames(self, config: Config) -> list[Frame]:
        """One for each shot."""
        if config not in self._frames:
            self._frames[config] = prepare(frames_of(self.shots), config)
        return self._frames[config]


def truth_for(config: Config, shot: Shot) -> FrameTruth:
    """The truth of a frame from the camera that a method's lengths refer to."""
    return shot.color_truth if config.cluster.points else shot.truth


def tally_of(
    shot: Shot,
    found: Detections,
    config: Config,
    counted: EvalConfig | None = None,
    truth: FrameTruth | None = None,
) -> Tally:
    """A frame's detections compared with the truth.

    Args:
        shot: The frame.
        found: ``B = 1``.
        config: Configuration of the method.
        counted: What counts; by default :func:`eval_config`.
        truth: By default that of :func:`truth_for`.
    """
    counted, truth = counted or eval_config(config), truth or truth_for(config, shot)
    side = cell_side(shot.calibration.depth, config.surface.cell_rad)
    return evaluate_frames(found, truth, shot.calibration, counted, side=side)[0]


def found_by(system: System, prepared: Prepared) -> list[Detections]:
    """The obstacles of each frame, batches of one.

    What is known of the floor is the camera's mount; all but the preset ``paper`` have it corrected
    by each frame.
    """
    config = system.config
    if system.method == OURS:
        each = [frames_of([shot]) for shot in prepared.shots]
        return [to_host(detect(frames, config, backend="jax", with_cells=True)) for frames in each]
    frames, params = prepared.frames(config), dict(system.params)
    return [detect_with(system.baseline, frame, config, params) for frame in frames]


def joined(truth: FrameTruth) -> FrameTruth:
    """The truth with obstacles joined that the robot can't pass between; it has no outlines."""
    return group_objects(truth, *JOIN_M)._replace(footprint=None)


def judge(task: tuple[Path, tuple[System, ...]]) -> dict[str, list[Tally]]:
    """Run every system on every frame of a file; a worker's task.

    Returns:
        A tally for each frame by the system's name, and by :data:`JOINED` and :data:`NEGATIVES`
        before its name.
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
    """What the baselines are tuned for: the mean of the three figures they are judged by."""
    return (figures.accuracy + figures.fmi + figures.f1) / 3


class TuningTask(NamedTuple):
    """A baseline to tune on the frames in some files."""

    name: str
    paths: tuple[Path, ...]
    config: Config


def tune_one(task: TuningTask) -> tuple[dict[str, Any], float]:
    """A worker's task: the best parameters of a baseline, and the objective there."""
    frames, truths = _tuning_frames(task.paths, task.config)
    counted = eval_config(task.config)
    best = tune(BASELINES[task.name], frames, truths, tuning_objective, task.config, counted)
    return best.params, best.value


@lru_cache(maxsize=1)
def _tuning_frames(paths: tuple[Path, ...], config: Config) -> tuple[list[Frame], list[FrameTruth]]:
    shots = [shot for path in paths for shot in load_shots(path)]
    frames = [frame for shot in shots for frame in prepare(frames_of([shot]), config)]
    return frames, [truth_for(config, shot) for shot in shots]
