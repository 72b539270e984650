"""Floor and obstacle pixels above the estimated floor, by pitch, roll and slope."""

from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.baselines.frames import color_plane
from benchmarks.paper.lab import Lab
from benchmarks.paper.measure import measured
from benchmarks.paper.plan import PITCHES_DEG, ROLLS_DEG, SLOPES_DEG
from benchmarks.paper.section import Direction, Section, percent
from benchmarks.paper.shots import Shot, frames_of, load_shots
from benchmarks.paper.systems import eval_config
from jaxdet import reference
from jaxdet.camera import cell_side
from jaxdet.config import Config
from jaxdet.eval import Tally, keep_shares, total
from jaxdet.pipeline import find_floors
from jaxdet.reference.paper._ground import above_floor

SOURCES = ("tf", "estimate")
"""Priors of the floor: the mount of the camera, or none."""
PIXELS = "_pixels"
"""Suffix of a source, for the figures of all pixels that show the floor or an obstacle."""
KINDS = ("", PIXELS)
DIRECTIONS: dict[str, Direction] = {"floor_kept": "lower", "obstacle_kept": "higher"}
Key = tuple[str, float, float, float]


class Task(NamedTuple):
    """Task of a worker."""

    path: Path
    config: Config


def judge_floor(task: Task) -> dict[str, list[Tally]]:
    """Count the pixels above the floor in each frame of a file, by source."""
    out: dict[str, list[Tally]] = {source + kind: [] for source in SOURCES for kind in KINDS}
    ground, counted = task.config.ground, eval_config(task.config)
    for shot in load_shots(task.path):
        for source in SOURCES:
            kept, z = _ground(shot, source, task.config)
            z = z * shot.calibration.depth_unit
            inside = (z >= ground.min_depth_m) & (z <= ground.max_depth_m)
            assert shot.height is not None and shot.truth.depth_m is not None
            off = np.abs(shot.truth.depth_m[0].astype(np.float32) - z)
            own = off <= counted.depth_slack(z)
            for key, taken in ((source, inside & own), (source + PIXELS, inside)):
                tally = keep_shares(
                    kept,
                    np.where(taken, z, 0.0),
                    shot.truth.obstacle_id[0],
                    shot.height.astype(np.float32),
                    shot.truth.is_wall,
                    ground.step_height_m,
                )
                out[key].append(tally)
    return out


def _ground(shot: Shot, source: str, config: Config) -> tuple[np.ndarray, np.ndarray]:
    """Return the pixels higher than the step of cells, ``(H, W)`` bool, and depths ``(H, W)``."""
    frames = frames_of([shot], plane=source == "tf")
    calibration, ground = frames.calibration, config.ground
    plane = color_plane(find_floors(frames, config, backend="reference").plane, calibration)
    side = cell_side(calibration.depth, config.surface.cell_rad)
    step = ground.step_height_per_m / side
    config = replace(config, ground=replace(ground, step_height_per_m=step))
    aligned = reference.paper.align(frames.depth, frames.calibration)
    return above_floor(aligned.z, plane, frames.calibration, config)[0], aligned.z[0]


def tallies_of(lab: Lab) -> dict[Key, list[Tally]]:
    """Return the tallies of frames by source, pitch, roll and slope [degree]."""
    seeds = lab.seeds[: lab.counts.floor_seeds]
    poses = list(product(PITCHES_DEG, ROLLS_DEG, SLOPES_DEG))
    specs = [
        lab.spec(
            "mixed",
            seed,
            1,
            camera_pitch_rad=float(np.radians(pitch)),
            camera_roll_rad=float(np.radians(roll)),
            slope_rad=float(np.radians(slope)),
            heights=True,
        )
        for pitch, roll, slope in poses
        for seed in seeds
    ]
    lab.log(f"{len(specs)} frames of tilted cameras and ramps")
    lab.store.ensure(specs)
    parts = iter(lab.run(judge_floor, [Task(lab.store.path(s), lab.config) for s in specs]))
    out: dict[Key, list[Tally]] = {}
    for pose in poses:
        mine = [next(parts) for _ in seeds]
        for source in mine[0]:
            out[(source, *pose)] = [tally for part in mine for tally in part[source]]
    return out


def run(lab: Lab) -> Section:
    """Measure the shares of floor and obstacle pixels above the floor, by pitch, roll and slope."""
    section = Section("floor", "Floor and obstacle pixels above the floor")
    section.say(
        f"{lab.counts.floor_seeds} simulated scenes (family mixed) per pitch, roll and ramp ahead, "
        "normal light. Shares of the pixels in range that count as above the floor: of true floor "
        "(an error; the step is that of cells), and of true obstacles above the step height "
        "(correct). Pixels that show floor next to an object, but have the depth of the object, as "
        "stereo cameras measure it, don't count as floor; the last table counts all pixels by the "
        "object that they show. The plane and the ramp ahead are estimated from the depth of each "
        "frame, with the mount of the camera (tf), which doesn't contain the ramp, or without a "
        "prior (estimate). Without a prior, all pixels of a frame that shows too little floor are "
        "above it. The paper has no such figures."
    )
    every = tallies_of(lab)
    _totals(section, every)
    rows: list[list[str]] = []
    for pitch, roll, slope in product(PITCHES_DEG, ROLLS_DEG, SLOPES_DEG):
        row = [f"{pitch:g}", f"{roll:g}", f"{slope:+g}"]
        for source in SOURCES:
            found = measured(every[source, pitch, roll, slope]).score
            for figure, direction in DIRECTIONS.items():
                key = f"{source}.{pitch:g}.{roll:g}.{slope:g}.{figure}"
                section.add(key, getattr(found, figure), "", direction)
            row += [percent(found.floor_kept, digits=2), percent(found.obstacle_kept)]
        rows.append(row)
    header = ["Pitch [°]", "Roll [°]", "Ramp [°]"]
    names = [f"{part} kept, {source}" for source in SOURCES for part in ("floor", "obstacle")]
    section.table([*header, *names], rows)
    _pixels(section)
    return section


def _pixels(section: Section) -> None:
    """Add the figures of all pixels, by the object that they show."""
    values = {figure.key: figure.value for figure in section.figures}
    rows = []
    for source, slopes in product(SOURCES, ("level", "all")):
        stem = f"{source}{PIXELS}.{slopes}"
        shares = (values[f"{section.name}.{stem}.{k}"] for k in DIRECTIONS)
        worst = (values[f"{section.name}.{stem}.worst.{k}"] for k in DIRECTIONS)
        rows.append([f"{source}, {slopes}", *(percent(x, digits=2) for x in (*shares, *worst))])
    header = ["All pixels", "floor kept", "obstacle kept"]
    section.table([*header, *(f"{name}, worst pose" for name in header[1:])], rows)


def _totals(section: Section, every: dict[Key, list[Tally]]) -> None:
    """Add the figures of all poses and of the worst, without and with ramps."""
    sources = [source + kind for source in SOURCES for kind in KINDS]
    for source, (name, slopes) in product(sources, (("level", (0.0,)), ("all", SLOPES_DEG))):
        poses = [every[key] for key in every if key[0] == source and key[3] in slopes]
        one = measured([tally for pose in poses for tally in pose])
        worst = [measured([total(pose)]).score for pose in poses]
        key = f"{source}.{name}"
        for figure, direction in DIRECTIONS.items():
            section.add(f"{key}.{figure}", one.value(figure), "", direction, one.intervals[figure])
        values = [s.floor_kept for s in worst], [s.obstacle_kept for s in worst]
        section.add(f"{key}.worst.floor_kept", float(np.nanmax(values[0])), "", "lower")
        section.add(f"{key}.worst.obstacle_kept", float(np.nanmin(values[1])), "", "higher")
