"""Fig. 8 and Section 4.1.1: detections in scenes of SUN RGB-D."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.paper.lab import Lab
from benchmarks.paper.pictures import encode, grid, titled
from benchmarks.paper.realframes import FOUND, MISSED, Found
from benchmarks.paper.section import Section, percent, wilson
from benchmarks.paper.sun_scenes import (
    FLOORS,
    MAX_DEPTH_M,
    NO_THINGS,
    SunScene,
    find_scenes,
    labels_of_scene,
    read_scene,
)
from benchmarks.scores.boxes import BoxTally, tally_boxes
from jaxdet.config import Config
from jaxdet.engine.device import method_frames
from jaxdet.errors import InputError, JaxdetError
from jaxdet.eval.boxes import MIN_IOU, match_boxes
from jaxdet.floor.plane import down_vector
from jaxdet.pipeline import detect, find_floors
from jaxdet.presets import PRESETS
from jaxdet.reference.paper._ground import above_floor
from jaxdet.render import canvas
from jaxdet.render.camera import camera_view, shown_image
from jaxdet.results.rows import to_host

TITLES = "paper", "wheeled"
"""Presets that are compared."""
ASKED = {"standing": True, "things": False}
"""Required objects: those that stand on the floor, or all."""
PICTURED, WIDTH = 12, 420
"""Number of scenes in the picture, evenly spaced, and width of each view [pixel]."""


class Task(NamedTuple):
    """Scene to evaluate."""

    root: Path
    folder: Path
    pictured: bool


class Judgement(NamedTuple):
    """Result of a scene."""

    problem: str
    """Reason why the scene can't be read; then the other fields are empty."""
    tallies: dict[tuple[str, str], BoxTally]
    """Counts by required objects and preset; empty without labels."""
    tilt_rad: float
    """Angle between the estimated normal of the floor and the dataset's; NaN without either."""
    views: list[np.ndarray]
    """Pictures, one per preset."""


def run(lab: Lab) -> Section:
    """Score the scenes of a folder and show pictures of them."""
    section = Section("sunrgbd", "Fig. 8: scenes of SUN RGB-D")
    if lab.sunrgbd is None:
        section.say("Not run: no folder of SUN RGB-D was named (--sunrgbd ROOT names one).")
        return section
    try:
        folders = find_scenes(lab.sunrgbd)
    except InputError as error:
        section.say(f"Not run: {error}")
        return section
    chosen = _spread(folders, lab.scenes or len(folders))
    pictured = set(_spread(chosen, PICTURED))
    tasks = [Task(lab.sunrgbd, folder, folder in pictured) for folder in chosen]
    judged = lab.run(judge, tasks)
    problems = [one.problem for one in judged if one.problem]
    labelled = [one for one in judged if one.tallies]
    tilts = np.degrees([one.tilt_rad for one in judged if not np.isnan(one.tilt_rad)])
    section.say(
        f"{len(chosen)} of {len(folders)} scenes; {len(labelled)} have labels, {len(problems)} "
        f"can't be read{': ' if problems else ''}{'; '.join(problems[:3])}. Objects are the "
        "polygons of annotation2Dfinal whose near surface is within "
        f"{MAX_DEPTH_M:g} m. Objects called {', '.join(sorted(NO_THINGS))} are not required; "
        f"{', '.join(sorted(FLOORS))} are floor. Standing objects reach down to the labelled "
        "floor; objects on a table or shelf are ignored. A detection is correct if the IoU of the "
        f"boxes is at least {MIN_IOU:g}; only detections on labelled floor and objects count. The "
        "depth is the measured one (folder depth), from which the floor of each frame is "
        "estimated."
    )
    if len(tilts):
        section.say(
            "The normal of the floor differs from that of the dataset by "
            f"{np.median(tilts):.1f} degrees (median of {len(tilts)} scenes)."
        )
    rows = [
        [
            asked,
            preset,
            *_row(section, f"{preset}.{asked}", [one.tallies[asked, preset] for one in labelled]),
        ]
        for asked in ASKED
        for preset in TITLES
        if labelled
    ]
    section.table(["Objects", "Preset", "Scenes", "Number", "Recall", "Precision"], rows)
    views = [view for one in judged for view in one.views]
    if views:
        caption = "Left: preset paper, right: wheeled. White outlines: objects found, red: missed."
        section.picture("scenes", encode(grid(views, 2 * len(TITLES))), caption)
    return section


def _spread(folders: list[Path], count: int) -> list[Path]:
    """Return ``count`` evenly spaced folders."""
    numbers = np.linspace(0, len(folders) - 1, min(count, len(folders)))
    return [folders[k] for k in np.rint(numbers).astype(int).tolist()]


def _row(section: Section, key: str, tallies: list[BoxTally]) -> list[str]:
    """Add the figures of some scenes; return them as texts."""
    objects, detections, matched = (
        sum(getattr(tally, name) for tally in tallies)
        for name in ("objects", "detections", "matched")
    )
    texts = [f"{len(tallies)}", f"{objects}"]
    for name, whole in (("recall", objects), ("precision", detections)):
        share, ends = matched / whole if whole else float("nan"), wilson(matched, whole)
        section.add(f"{key}.{name}", share, "", "higher", ends)
        texts.append(percent(share, ends))
    return texts


def judge(task: Task) -> Judgement:
    """Detect the obstacles of a scene with each preset; task of a worker."""
    try:
        scene = read_scene(task.folder, task.root)
        found = {name: _found(scene, PRESETS[name]) for name in TITLES}
    except JaxdetError as error:
        return Judgement(str(error), {}, float("nan"), [])
    plane = found[TITLES[0]].frames.plane
    assert plane is not None
    tilt = float("nan")
    if scene.down is not None and plane.valid[0]:
        cosine = down_vector(plane.pitch, plane.roll)[0] @ scene.down
        tilt = float(np.arccos(min(cosine, 1.0)))
    tallies = {}
    if scene.polygons is not None:
        tallies = {
            (asked, name): _tally(scene, one, standing)
            for asked, standing in ASKED.items()
            for name, one in found.items()
        }
    views = [_picture(scene, name, one) for name, one in found.items()] if task.pictured else []
    return Judgement("", tallies, tilt, views)


def _found(scene: SunScene, config: Config) -> Found:
    """Return the obstacles of a scene, with the floor estimated from its depth."""
    frames = scene.frames
    frames = frames._replace(plane=find_floors(frames, config, backend="reference").plane)
    read = method_frames(frames, config)
    return Found(
        frames, to_host(detect(read, config, backend="reference", with_cells=True)), config
    )


def _tally(scene: SunScene, found: Found, standing: bool) -> BoxTally:
    frames, plane = scene.frames, found.frames.plane
    assert plane is not None
    kept = above_floor(frames.depth, plane, frames.calibration, found.config)[0]
    labels = labels_of_scene(scene, standing)
    measured = frames.depth[0] > 0
    return tally_boxes(labels, found.boxes, found.nearest_m, kept, measured, MIN_IOU)


def _picture(scene: SunScene, title: str, found: Found) -> np.ndarray:
    """Draw the detections and the required labelled objects of a scene."""
    shown = shown_image(found.frames, 0, found.config)
    view = camera_view(shown, found.detections, 0, found.config, 1.0)
    text = f"{title}, {scene.name}: no labels"
    if scene.polygons is not None:
        boxes = labels_of_scene(scene, standing=False).boxes
        pairs = match_boxes(boxes, found.boxes, MIN_IOU)
        for (left, top, right, bottom), pair in zip(boxes.tolist(), pairs.tolist(), strict=True):
            corners = np.array([[left, top], [right, top], [right, bottom], [left, bottom]])
            canvas.polygon(view, corners, FOUND if pair >= 0 else MISSED, width=1)
        text = f"{title}, {scene.name}: {(pairs >= 0).sum()} of {len(boxes)}"
    return titled(view, text, WIDTH)
