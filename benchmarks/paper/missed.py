"""Objects that the default misses, by class: apart, overlapping others, hardly measured."""

from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.paper.hard import CAMERAS, ERRORS, FAMILIES, specs_of
from benchmarks.paper.lab import Lab
from benchmarks.paper.plan import SCENES
from benchmarks.paper.section import Section, percent
from benchmarks.paper.shots import Shot, load_shots
from benchmarks.paper.systems import (
    DEFAULT,
    Prepared,
    System,
    default,
    eval_config,
    found_by,
    tally_of,
)
from jaxdet import reference
from jaxdet.eval import EvalConfig
from jaxdet.eval.polygon import overlap

CLASSES = ("apart", "under or over another", "hardly measured")


class ClassCounts(NamedTuple):
    """Numbers of required and of found objects, ``(3,)`` int64, in the order of ``CLASSES``."""

    required: np.ndarray
    found: np.ndarray


def kinds_of(shot: Shot, config: EvalConfig) -> np.ndarray:
    """Return the index in ``CLASSES`` of each object of a frame, ``(J,)`` int64.

    An object is hardly measured if the depth camera measures it on fewer colour pixels than
    required (next to nearer objects, or beyond the edge of the depth image). It is under or over
    another one if their footprints overlap, like those of a table and a chair under it.
    """
    truth, calibration = shot.truth, shot.calibration
    assert truth.footprint is not None and truth.depth_m is not None
    z_m = reference.paper.align(shot.depth[None], calibration).z[0] * calibration.depth_unit
    off = np.abs(z_m - np.asarray(truth.depth_m[0], np.float64))
    measured = truth.obstacle_id[0][(z_m > 0) & (off <= config.depth_slack(z_m))]
    pixels = np.bincount(measured, minlength=len(truth.is_wall) + 1)[1:]
    outlines = [one[~np.isnan(one[:, 0])] for one in truth.footprint[0]]
    kinds = np.zeros(len(outlines), np.int64)
    for one, outline in enumerate(outlines):
        others = outlines[:one] + outlines[one + 1 :]
        kinds[one] = any(overlap(outline, other) > 0 for other in others)
    return np.where(pixels < config.min_visible_pixels, 2, kinds)


def judge_missed(task: tuple[Path, System]) -> ClassCounts:
    """Run a system on all frames of a file; task of a worker."""
    path, system = task
    shots, config = load_shots(path), eval_config(system.config)
    total = ClassCounts(np.zeros(3, np.int64), np.zeros(3, np.int64))
    for shot, found in zip(shots, found_by(system, Prepared(shots)), strict=True):
        kinds = kinds_of(shot, config)
        for case in tally_of(shot, found, system.config).cases:
            total.required[kinds[case.number - 1]] += 1
            total.found[kinds[case.number - 1]] += case.found
    return total


def run(lab: Lab) -> Section:
    """Count the objects found of each class, by family."""
    section = Section("missed", "Missed objects")
    section.say(
        "Required objects in the scenes in normal light, as above, in three classes: number found "
        "of number required. Apart: measured, and no other footprint overlaps. Under or over "
        "another: footprints overlap, like those of a table and a chair under it. Hardly measured: "
        "of the 400 or more pixels in the colour image, fewer than 400 have a measured depth."
    )
    specs = {name: lab.test_specs(name, "normal") for name in SCENES}
    for family, error in product(FAMILIES, ERRORS):
        specs[f"{family}, {CAMERAS[error]}"] = specs_of(lab, family, error)
    rows, system = [], default(lab.config)
    every = ClassCounts(np.zeros(3, np.int64), np.zeros(3, np.int64))
    for family, own in specs.items():
        lab.store.ensure(own)
        parts = lab.run(judge_missed, [(lab.store.path(spec), system) for spec in own])
        one = ClassCounts(*(np.sum(part, axis=0) for part in zip(*parts, strict=True)))
        every = ClassCounts(*(a + b for a, b in zip(every, one, strict=True)))
        rows.append([family, *_cells(one)])
    rows.append(["all", *_cells(every)])
    section.table(["Family", *(name.capitalize() for name in CLASSES)], rows)
    for name, required, found in zip(CLASSES, *every, strict=True):
        key = f"{DEFAULT}.{name.replace(' ', '_')}.recall"
        section.add(key, float(found / required) if required else float("nan"), "", "higher")
    return section


def _cells(one: ClassCounts) -> list[str]:
    return [
        f"{found} of {required} ({percent(found / required)})" if required else "-"
        for required, found in zip(*one, strict=True)
    ]
