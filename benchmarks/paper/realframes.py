"""Results on labelled frames of real cameras: recall, precision, floor kept, distances."""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.baselines.frames import color_plane
from benchmarks.paper.lab import Lab
from benchmarks.paper.labelled import Recording, find_recordings, labels_of
from benchmarks.paper.pictures import encode, grid, titled
from benchmarks.paper.section import Direction, Section, number, percent, wilson
from benchmarks.scores.boxes import (
    BoxTally,
    FrameLabels,
    count_tagged,
    on_known_ground,
    score_boxes,
    tally_boxes,
)
from jaxdet import reference
from jaxdet.camera import cell_side
from jaxdet.config import Config
from jaxdet.engine import decide_planes
from jaxdet.engine.device import method_frames
from jaxdet.eval.boxes import match_boxes
from jaxdet.eval.frame import cell_points
from jaxdet.floor.plane import floor_prior
from jaxdet.io import Log, open_log
from jaxdet.io.batch import Batch
from jaxdet.pipeline import detect
from jaxdet.presets import PRESETS
from jaxdet.reference.paper._ground import above_floor
from jaxdet.render import canvas
from jaxdet.render.camera import camera_view, shown_image
from jaxdet.results.metric import extents, floors
from jaxdet.results.rows import to_host
from jaxdet.types import Detections, Frames

WORST = 6
"""Number of frames of each recording of which pictures are drawn."""
COLUMNS, WIDTH = 3, 420
FOUND, MISSED = (255, 255, 255), (255, 40, 40)
TAGS = ("path", "low")
"""Tags for whose objects the recall is reported too; see labels/RULE.md."""
DIRECTIONS: dict[str, Direction] = {
    "recall": "higher",
    "precision": "higher",
    "swamped": "lower",
    "on_floor": "lower",
    "floor_kept": "lower",
    "error_median_m": "lower",
    "error_p90_m": "lower",
}


class Found(NamedTuple):
    """Frame of a log and its detections, each a batch of one."""

    frames: Frames
    """The frame, with the floor that was used."""
    detections: Detections
    config: Config

    @property
    def shown(self) -> np.ndarray:
        """Whether the colour image shows a part of each obstacle, ``(n,)`` bool."""
        return self.detections.obstacles.uv_max[0, : self.detections.num_obstacles[0], 0] >= 0

    @property
    def boxes(self) -> np.ndarray:
        """Image boxes of the shown obstacles, ``(k, 4)`` int32 [pixel]."""
        count, obstacles = self.detections.num_obstacles[0], self.detections.obstacles
        boxes = np.concatenate([obstacles.uv_min[0], obstacles.uv_max[0]], axis=1)[:count]
        return boxes[self.shown]

    @property
    def nearest_m(self) -> np.ndarray:
        """Smallest forward depth of the shown part of each obstacle, ``(k,)`` float [m]."""
        calibration, count = self.frames.calibration, int(self.detections.num_obstacles[0])
        cells = self.detections.cells
        if cells is None:
            box = extents(self.detections.obstacles, calibration.depth_unit)
            return box.minimum[0, :count, 2]
        side = cell_side(calibration.depth, self.config.surface.cell_rad)
        points, label = cell_points(cells, 0, calibration, side), cells.label[0]
        seen = points.valid & (label >= 0)
        least = np.full(count, np.inf)
        np.minimum.at(least, label[seen], points.z[seen] * calibration.depth_unit)
        return least[self.shown]


class Task(NamedTuple):
    """Task of a worker: a recording and a configuration."""

    recording: Recording
    folder: Path
    config: Config
    pictured: int
    """Number of worst frames of which pictures are drawn."""


class Judgement(NamedTuple):
    """Result on the labelled frames of a recording."""

    numbers: list[int]
    tallies: list[BoxTally]
    views: list[np.ndarray]
    """Pictures of the worst frames, the worst first."""


def frames_with_floor(log: Log, config: Config) -> Iterator[Batch]:
    """Yield the frames of a log, one by one, with the prior of their floor."""
    planes = decide_planes(log, config, "reference")
    for batch in log.batches(1, color=True, need_color=config.cluster.points):
        plane = planes.of(batch.frames.stamp_ns)
        yield batch._replace(frames=batch.frames._replace(plane=plane))


def find_obstacles(log: Log, config: Config) -> Iterator[Found]:
    """Yield the frames of a log with the obstacles of ``jaxdet run --backend reference``."""
    for batch in frames_with_floor(log, config):
        read = method_frames(batch.frames, config)
        found = to_host(detect(read, config, backend="reference", with_cells=True))
        yield Found(batch.frames, found, config)


def judge(task: Task) -> Judgement:
    """Compare all labelled frames of a recording with their labels."""
    with open_log(str(task.folder / task.recording.place)) as log:
        each = [(found, *_held(task, found)) for found in find_obstacles(log, task.config)]
    known = [(found, labels, tally) for found, labels, tally in each if labels is not None]
    worst = sorted(known, key=lambda one: _right(one[2]))[: task.pictured]
    return Judgement(
        [int(found.frames.number[0]) for found, _, _ in known],
        [tally for _, _, tally in known],
        [_picture(task.recording, *one) for one in worst],
    )


def _held(task: Task, found: Found) -> tuple[FrameLabels | None, BoxTally]:
    """Return the labels and counts of a frame; None and zeros if it has no labels."""
    frames, calibration = found.frames, found.frames.calibration
    aligned = reference.paper.align(frames.depth, calibration)
    z_m = np.asarray(aligned.z[0]) * calibration.depth_unit
    labels = labels_of(task.recording, task.folder, int(frames.number[0]), z_m, calibration)
    if labels is None:
        return None, BoxTally()
    scene = found.detections.scene
    prior = floor_prior(frames, task.config)
    plane = floors(scene, calibration.depth_unit).plane if scene else prior
    plane = color_plane(plane, calibration)
    kept = above_floor(aligned.z, plane, calibration, task.config)[0]
    boxes, nearest, least = found.boxes, found.nearest_m, task.recording.least_iou
    return labels, tally_boxes(labels, boxes, nearest, kept, z_m > 0, least)


def _right(tally: BoxTally) -> float:
    """Return the matched objects as a share of all objects and detections; 1 if there are none."""
    every = tally.objects + tally.detections - tally.matched
    return tally.matched / every if every else 1.0


def run(lab: Lab) -> Section:
    """Report the figures on labelled frames of real cameras; not in the paper."""
    section = Section("realframes", "Labelled frames of real cameras")
    places = find_recordings(lab.recordings, lab.labelled)
    if not places:
        section.say(
            "Not run: no labelled recording was found; pass their folder as --recordings FOLDER."
        )
        return section
    section.say(
        "A detection is correct if its image box and that of a labelled object overlap by the "
        f"minimum IoU ({', '.join(f'{one.name} {one.least_iou:g}' for one, _ in places)}), one to "
        "one. Detections that are mostly on unlabelled ground are ignored. A frame is swamped if "
        "one box covers more than half of its floor. Floor kept: share of the measured floor "
        "pixels above the estimated floor; with labels of boxes only, the floor is everything "
        "outside of them. Distance: smallest depth of the detection, compared with the near "
        "surface of the object. The prior is one plane per recording, which each frame corrects "
        "with wheeled, but not with paper, though only aims_slam is one drive."
    )
    section.say(
        "Use of the recordings: nothing was trained on held-out frames, but figures of some of "
        "them were known when parameters were chosen (see choices.md). Those of aims_slam are of "
        "the same drive as its other frames, and the three frames of wheelchair decided "
        "parameters; wheelchair_5cm excludes lower objects. The rooms (scripts/rooms_to_mcap) were "
        "labelled before anything was run on them, and nothing was trained on them; rules were "
        "changed after some of them had been evaluated, but not after those called untouched. The "
        "public recordings were split by repository and labelled before anything was run on them "
        "(labels/RULE.md): the part learn may be used for training, the part last may not. If the "
        "ground is a table top, preset tabletop is compared. Path: recall of objects labelled as "
        "in the path of the robot; low: recall of objects 5 to 10 cm high within 3 m."
    )
    tasks = [
        Task(recording, folder, PRESETS[name], 0 if i or recording.least_height_m else WORST)
        for recording, folder in places
        for i, name in enumerate(recording.presets)
    ]
    titles = [name for recording, _ in places for name in recording.presets]
    parts: dict[tuple[str, str], list[BoxTally]] = {}
    pictures = []
    for task, title, judged in zip(tasks, titles, lab.run(judge, tasks), strict=True):
        for part, tallies in parts_of(task.recording, judged).items():
            parts.setdefault((part, title), []).extend(tallies)
        if judged.views:
            pictures.append((task.recording.name, title, judged.views))
    rows = [
        [part, title, *_row(section, f"{part}.{title}", tallies)]
        for (part, title), tallies in parts.items()
    ]
    header = ["Recording", "Preset", "Frames", "Objects", "Recall", "Precision"]
    header += ["Recall, path", "Recall, low", "Swamped"]
    header += ["False on floor", "Floor kept", "Distance error, median [m]", "90th percentile"]
    section.table(header, rows)
    for name, title, views in pictures:
        caption = f"{name}, {title}: the frames with the fewest right of what is there or was "
        caption += "found. White outlines: objects found, red: missed."
        section.picture(name, encode(grid(views, COLUMNS)), caption)
    return section


def parts_of(recording: Recording, judged: Judgement) -> dict[str, list[BoxTally]]:
    """Split the tallies for the report: all together, or the tuning and the held-out part."""
    if not recording.held_out:
        return {recording.group or recording.name: judged.tallies}
    parts: dict[str, list[BoxTally]] = {"tuning": [], "held_out": []}
    for frame, tally in zip(judged.numbers, judged.tallies, strict=True):
        parts["held_out" if recording.holds_out(frame) else "tuning"].append(tally)
    return {f"{recording.name}.{part}": tallies for part, tallies in parts.items()}


def _row(section: Section, key: str, tallies: list[BoxTally]) -> list[str]:
    """Add the figures of some frames; return them as texts."""
    score = score_boxes(tallies)
    objects, detections, matched = (
        sum(getattr(tally, name) for tally in tallies)
        for name in ("objects", "detections", "matched")
    )
    ends = {"recall": wilson(matched, objects), "precision": wilson(matched, detections)}
    for name, direction in DIRECTIONS.items():
        unit = "m" if name.endswith("_m") else ""
        section.add(f"{key}.{name}", getattr(score, name), unit, direction, ends.get(name))
    tagged = []
    for tag in TAGS:
        found, every = count_tagged(tallies, tag)
        share = found / every if every else float("nan")
        tagged.append(f"{percent(share, wilson(found, every))} of {every}" if every else "-")
        if every:
            section.add(f"{key}.recall_{tag}", share, "", "higher", wilson(found, every))
    return [
        f"{len(tallies)}",
        f"{objects}",
        percent(score.recall, ends["recall"]),
        percent(score.precision, ends["precision"]),
        *tagged,
        f"{score.swamped}",
        f"{score.on_floor}",
        percent(score.floor_kept),
        number(score.error_median_m),
        number(score.error_p90_m),
    ]


def _picture(
    recording: Recording, found: Found, labels: FrameLabels, tally: BoxTally
) -> np.ndarray:
    """Draw the camera's view with the labelled boxes."""
    frames = found.frames
    view = camera_view(shown_image(frames, 0, found.config), found.detections, 0, found.config, 1.0)
    counted = found.boxes[on_known_ground(labels, found.boxes)]
    pairs = match_boxes(labels.boxes, counted, recording.least_iou)
    for box, pair in zip(labels.boxes, pairs.tolist(), strict=True):
        left, top, right, bottom = box.tolist()
        corners = np.array([[left, top], [right, top], [right, bottom], [left, bottom]])
        canvas.polygon(view, corners, FOUND if pair >= 0 else MISSED, width=1 if pair >= 0 else 2)
    text = f"{recording.name} {frames.number[0]}: {tally.matched} of {tally.objects} found, "
    text += f"{tally.detections - tally.matched} false"
    return titled(view, text, WIDTH)
