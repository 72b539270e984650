"""Detections of the default in single hard cases."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from benchmarks.paper.case_list import CASES, Case
from benchmarks.paper.free import claim_of
from benchmarks.paper.lab import Lab
from benchmarks.paper.section import Section, percent, wilson
from benchmarks.paper.shots import Shot, Spec, shot_of
from benchmarks.paper.systems import (
    DEFAULT,
    Prepared,
    System,
    default,
    eval_config,
    found_by,
    tally_of,
)
from jaxdet.eval import Tally, score
from jaxdet.results.free_floor import ray_bearings
from jaxdet.sim import SimConfig
from jaxdet.sim.draft import Draft
from jaxdet.sim.frames import simulate_frame
from jaxdet.types import Detections, FreeEnd

NEIGHBOURS = 5
"""Minimum number of neighbouring rays ending in a drop for a frame to report one."""
DROP_WITHIN_M = 0.3
"""Maximum distance of a reported step down from its position [m]."""


class Task(NamedTuple):
    """Task of a worker: a case and the seed of its scene."""

    key: str
    seed: int
    width: int
    system: System


class Outcome(NamedTuple):
    """Result of the scene of a case."""

    tally: Tally
    """Counts of the required objects."""
    drop_m: float
    """Distance of the reported step down [m], NaN if none is reported."""
    true_drop_m: float
    claimed: float
    """Share of the free floor inside outlines."""


def judge_case(task: Task) -> Outcome:
    """Simulate a scene and run the system on it."""
    case = CASES[task.key]
    shot, true_drop_m = _draw(case, task.seed, task.width)
    found = found_by(task.system, Prepared([shot]))[0]
    return Outcome(
        _tally(case, shot, found, task.system),
        drop_of(found, shot.calibration.depth_unit),
        true_drop_m,
        claim_of(shot, found, task.system.config).share,
    )


def _draw(case: Case, seed: int, width: int) -> tuple[Shot, float]:
    """Return the frame of a case, and the distance of its step down [m]."""
    scene = case.build(Draft(seed, "case"))
    config = SimConfig(seed=seed, frames=1, width=width, height=width * 3 // 4)
    config = replace(config, **dict(case.changes))
    shot = shot_of(Spec(case.key, seed, 1, config.light), simulate_frame(config, scene, 0))
    return shot, (scene.ground.edges_m or (float("nan"),))[0]


def _tally(case: Case, shot: Shot, found: Detections, system: System) -> Tally:
    """Return the counts of the required objects of a case, however low or small."""
    counted = eval_config(system.config)
    step = counted.step_height_m if case.least_pixels > 1 else 0.0
    counted = replace(counted, min_visible_pixels=case.least_pixels, step_height_m=step)
    tally = tally_of(shot, found, system.config, counted)
    mine = tuple(
        one._replace(found=one.found and abs(one.position_error_m) <= case.within_m)
        for one in tally.cases
    )
    return tally._replace(cases=mine, found=sum(one.found for one in mine))


def drop_of(found: Detections, unit: float) -> float:
    """Return the distance of the reported step down of a frame.

    Args:
        found: Detections with a scene, ``B = 1``.
        unit: Depth unit [m].

    Returns:
        The median forward distance [m] of the rays that end in a drop, of which at
        least :data:`NEIGHBOURS` are adjacent; NaN if there are none.
    """
    assert found.scene is not None
    ends = np.asarray(found.scene.free_end[0]) == FreeEnd.DROP
    edges = np.flatnonzero(np.diff(np.r_[False, ends, False]))
    runs = [np.arange(a, b) for a, b in edges.reshape(-1, 2) if b - a >= NEIGHBOURS]
    if not runs:
        return float("nan")
    which = np.concatenate(runs)
    _, way = ray_bearings()
    return float(np.median(found.scene.free[0, which, 1] * np.imag(way[which]))) * unit


def run(lab: Lab) -> Section:
    """Poles, low boxes, gaps, walls, slabs, steps down and more, each case several times."""
    section = Section("cases", "Single hard cases")
    seeds = lab.seeds[: lab.counts.case_seeds]
    section.say(
        f"{len(CASES)} cases with {len(seeds)} scenes each, which differ in floor, walls, lamp and "
        "appearance, and by centimetres in position. Unless stated otherwise, the camera is 0.30 m "
        "above the floor and looks 10° down, its mount is exact, depth has no errors, and the "
        "light is normal. An object is found if a detection of its own has at least half of its "
        "points on it, however low or small the object is (a pane of glass: within 30 cm of it, "
        "not behind it). A step down is reported if the free floor ends in a drop in at least "
        f"{NEIGHBOURS} neighbouring rays, within {100 * DROP_WITHIN_M:g} cm of its position."
    )
    system = default(lab.config)
    tasks = [Task(key, seed, lab.counts.width, system) for key in CASES for seed in seeds]
    lab.log(f"{len(tasks)} frames of single cases")
    lab.store.drawn += len(tasks)
    parts = iter(lab.run(judge_case, tasks))
    outcomes = {key: [next(parts) for _ in seeds] for key in CASES}
    for group in dict.fromkeys(case.group for case in CASES.values()):
        rows = []
        for case in (case for case in CASES.values() if case.group == group):
            cell = _cell(section, f"{DEFAULT}.{case.key}", case, outcomes[case.key])
            rows.append([case.title, cell])
        section.table(["Case", system.title], rows, group)
    return section


def _cell(section: Section, key: str, case: Case, mine: Sequence[Outcome]) -> str:
    """Add the figures of a case; return them as text."""
    if case.expected == "claimed":
        shares = [one.claimed for one in mine]
        section.add(f"{key}.claimed", float(np.mean(shares)), "", "lower")
        section.add(f"{key}.claimed_worst", max(shares), "", "lower")
        return f"{percent(float(np.mean(shares)))}, worst {percent(max(shares))}"
    if case.expected == "found":
        return _found_cell(section, key, case, [one.tally for one in mine])
    found_m, true = ([getattr(one, name) for one in mine] for name in ("drop_m", "true_drop_m"))
    reported = [drop for drop in found_m if np.isfinite(drop)]
    off = np.abs(np.subtract(found_m, true))
    right = int(
        (off <= DROP_WITHIN_M).sum() if case.expected == "drop" else np.isnan(found_m).sum()
    )
    name = "reported" if case.expected == "drop" else "none_reported"
    section.add(f"{key}.{name}", right / len(mine), "", "higher", wilson(right, len(mine)))
    text = f"{right} of {len(mine)}"
    if case.expected == "drop" and reported:
        middle = float(np.median(reported))
        section.add(f"{key}.distance_off", middle - mine[0].true_drop_m, "m", "info")
        text += f", at {middle:.2f} m"
    return text


def _found_cell(section: Section, key: str, case: Case, tallies: list[Tally]) -> str:
    one = score(tallies)
    hits, asked = int(one.tally.found), int(one.tally.visible)
    rate = hits / asked if asked else float("nan")
    section.add(f"{key}.found", rate, "", "higher", wilson(hits, asked))
    text = f"{hits} of {asked}"
    if one.tally.false:
        pieces = int(one.tally.splits)
        text += f", {one.tally.false:.0f} false" + (f" ({pieces} pieces)" if pieces else "")
    if case.shown == "width_error_m" and hits:
        off = [k.width_error_m for k in one.tally.cases if k.found]
        worst = max(off, key=abs)
        section.add(f"{key}.width_error", abs(worst), "m", "lower")
        text += f", width {100 * worst:+.1f} cm"
    if case.shown == "iou" and hits:
        section.add(f"{key}.iou", one.iou, "", "higher")
        text += f", IoU {one.iou:.2f}"
    return text
