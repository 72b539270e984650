"""Pictures of the worst frames of the default, and the causes of missed obstacles."""

from collections import Counter
from typing import NamedTuple

import numpy as np

from benchmarks.paper.lab import Lab
from benchmarks.paper.pictures import encode, grid, shot_picture, titled
from benchmarks.paper.plan import DISTANCES_M, LIGHTS, SCENES
from benchmarks.paper.section import Section, percent
from benchmarks.paper.shots import Shot, Spec
from benchmarks.paper.systems import DEFAULT, Prepared, System, eval_config, found_by, tally_of
from benchmarks.paper.table4_distance import specs_of
from jaxdet.camera import cell_side
from jaxdet.config import Config
from jaxdet.eval import Tally
from jaxdet.eval.frame import objects_of, points_of
from jaxdet.types import Detections

NEAR_M = 2.0
"""Frames with an obstacle missed within this distance are shown first [m]."""

FEW_POINTS = 2
"""Maximum number of points (corners and sampled cells) of an obstacle with too few points."""


class Failure(NamedTuple):
    """Frame with errors."""

    spec: Spec
    number: int
    tally: Tally

    @property
    def mistakes(self) -> float:
        """Number of missed obstacles and false detections."""
        return self.tally.visible - self.tally.found + self.tally.false


def run(lab: Lab) -> Section:
    """Count the causes of errors in all test frames, and show the worst frames."""
    section = Section("failures", "Errors of the default")
    system = next(system for system in lab.systems if system.name == DEFAULT)
    failed = _failures(lab)
    causes = {light: Counter[str]() for light in LIGHTS}
    missed: list[str] = []
    for failure in failed:
        shot = lab.load([failure.spec])[failure.number]
        for number, cause in reasons(shot, system, failure.tally):
            causes[failure.spec.light][cause] += 1
            missed.append(shot.names[number - 1])
        causes[failure.spec.light]["false: a piece of a found obstacle"] += int(
            failure.tally.splits
        )
        rest = failure.tally.false - failure.tally.splits
        causes[failure.spec.light]["false: anything else"] += int(rest)
    frames = sum(len(by[DEFAULT]) for by in lab.scores.values())
    section.say(
        f"{len(failed)} of {frames} test frames have a missed obstacle or a false detection "
        f"({percent(len(failed) / frames)}). Missed, by kind: "
        + (", ".join(f"{k} {n}" for k, n in Counter(missed).most_common()) or "none")
        + "."
    )
    names = sorted({cause for one in causes.values() for cause in one})
    rows = [[name, *(str(causes[light][name]) for light in LIGHTS)] for name in names]
    section.table(["Cause", *LIGHTS], rows)
    for light in LIGHTS:
        for name in names:
            key = name.replace(":", "").replace(" ", "_")
            section.add(f"{light}.{key}", causes[light][name], "", "lower")
    _pictures(section, lab, system, failed)
    _near(section, lab, system)
    return section


def _failures(lab: Lab) -> list[Failure]:
    """Return all test frames with errors, the worst first."""
    each = lab.counts.scenes
    failed = [
        Failure(lab.spec(scene, lab.seeds[i // each], each, light), i % each, tally)
        for scene in SCENES
        for light in LIGHTS
        for i, tally in enumerate(lab.scores[scene, light][DEFAULT])
    ]
    failed = [failure for failure in failed if failure.mistakes > 0]
    return sorted(failed, key=lambda failure: -failure.mistakes)


def reasons(shot: Shot, system: System, tally: Tally) -> list[tuple[int, str]]:
    """Return the number of each missed obstacle of a frame, and the cause."""
    missed = [case.number for case in tally.cases if not case.found]
    if not missed:
        return []
    found = found_by(system, Prepared([shot]))[0]
    return [(number, _reason(found, shot, number, system.config)) for number in missed]


def _reason(found: Detections, shot: Shot, number: int, config: Config) -> str:
    calibration, truth = shot.calibration, shot.truth
    side = cell_side(calibration.depth, config.surface.cell_rad)
    points, labels = points_of(found, 0, calibration, side)
    objects = objects_of(points, truth, 0, calibration.depth_unit, eval_config(config))
    mine = labels[objects == number]
    if len(mine) <= FEW_POINTS:
        return "missed: too few of its points are measured above the floor"
    if (mine >= 0).sum() <= FEW_POINTS:
        return "missed: no obstacle contains its measured points"
    label = np.bincount(mine[mine >= 0]).argmax()
    others = objects[labels == label]
    solid = np.concatenate([[False], ~truth.is_wall])
    strangers = others[others != number]
    if np.mean(solid[strangers]) >= 0.5:
        return "missed: joined with another obstacle"
    return "missed: joined with wall or floor"


def _pictures(section: Section, lab: Lab, system: System, failed: list[Failure]) -> None:
    """Add pictures of the worst frames of each light, each scene once."""
    pictures = []
    for failure in worst_of(failed, lab.counts.worst):
        shot, tally = lab.load([failure.spec])[failure.number], failure.tally
        text = (
            f"{shot.title}: {tally.visible - tally.found:.0f} of {tally.visible:.0f} missed, "
            f"{tally.false:.0f} false"
        )
        why = _text(reasons(shot, system, tally))
        image = shot_picture(shot, system)
        pictures.append(titled(image, f"{text} ({why})" if why else text, 640))
    if pictures:
        caption = "The worst test frames of each light: camera view and top view."
        section.picture("worst", encode(grid(pictures, 2)), caption)


def worst_of(failed: list[Failure], count: int) -> list[Failure]:
    """Return about ``count`` of the worst frames, equally many per light level, each scene once."""
    chosen: list[Failure] = []
    seen: set[tuple[str, int, int]] = set()
    for light in LIGHTS:
        for failure in (f for f in failed if f.spec.light == light):
            scene = failure.spec.family, failure.spec.seed, failure.number
            if len(chosen) * len(LIGHTS) >= count * (LIGHTS.index(light) + 1):
                break
            if scene not in seen:
                seen.add(scene)
                chosen.append(failure)
    return chosen


def _text(causes: list[tuple[int, str]]) -> str:
    """Return the causes with their counts, as text."""
    counted = Counter(cause.removeprefix("missed: ") for _, cause in causes)
    return "; ".join(f"{cause} ({n})" for cause, n in counted.items())


def _near(section: Section, lab: Lab, system: System) -> None:
    """Add the number of obstacles of Table 4 that were missed within two metres."""
    if "table4" not in lab.sections:
        return
    cells = [(d, light) for d in DISTANCES_M if d <= NEAR_M for light in LIGHTS]
    pictures, count = [], 0
    for distance, light in cells:
        for shot in lab.load(specs_of(lab, distance, light)):
            found = found_by(system, Prepared([shot]))[0]
            tally = tally_of(shot, found, system.config)
            if tally.found == tally.visible:
                continue
            count += 1
            if len(pictures) < lab.counts.worst:
                why = _text(reasons(shot, system, tally))
                kinds = ", ".join(shot.names[c.number - 1] for c in tally.cases if not c.found)
                text = f"{kinds} at {distance:g} m, {light}: {why}"
                pictures.append(titled(shot_picture(shot, system), text, 640))
    section.say(f"Obstacles of Table 4 missed within {NEAR_M:g} m, all lights: {count}.")
    if pictures:
        caption = f"Obstacles of Table 4 missed within {NEAR_M:g} m, the farthest first."
        section.picture("near", encode(grid(pictures, 2)), caption)
