"""Detection of people and chairs on labelled real frames by a deep detector and the presets."""

import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.paper.detector import CLASSES, MIN_SCORE, load_detector, why_absent
from benchmarks.paper.lab import Lab
from benchmarks.paper.labelled import BOXES, Recording, find_recordings, read_boxes, read_names
from benchmarks.paper.realframes import find_obstacles
from benchmarks.paper.section import Section, percent, wilson
from benchmarks.scores.boxes import FrameLabels, labels_of_boxes, on_known_ground
from jaxdet.eval.boxes import match_boxes
from jaxdet.io import open_log
from jaxdet.presets import PRESETS

DETECTOR = "centernet"
METHODS = ("wheeled", "paper")
"""Presets that are compared with the detector."""
PEOPLE = frozenset({"man", "woman", "person"})
AFTER = frozenset({"with", "on", "behind", "in", "under", "of", "at", "bent"})
"""Words with which the part of a label that names the object's class ends."""
WHERE = frozenset({"left", "right", "front", "middle", "near", "far"})


class Task(NamedTuple):
    """Task of a worker: a recording."""

    recording: Recording
    folder: Path
    detector: Path


class Count(NamedTuple):
    """Counts of one class in some frames."""

    objects: int = 0
    matched: int = 0
    detections: int = 0
    """Number of detections of the class on labelled pixels; 0 for the presets, which don't
    classify.
    """


class Judgement(NamedTuple):
    """Result on a recording."""

    frames: int
    """Number of frames with labels."""
    counts: dict[tuple[str, str], Count]
    """Counts by method and class."""
    seconds: list[float]
    """Time of the detector on each frame except the first [s]."""


def class_of(name: str) -> str:
    """Return the class of a label's name, empty if it is none of those compared.

    Example:
        >>> [class_of(name) for name in ("office chair, left", "chair leg", "man on a stool")]
        ['chair', '', 'person']
    """
    words = name.split("[")[0].split(",")[0].lower().split()
    end = next((k for k, word in enumerate(words) if word in AFTER), len(words))
    kept = [word for word in words[:end] if word not in WHERE]
    last = kept[-1] if kept else ""
    return "person" if last in PEOPLE else last if last in CLASSES else ""


def add_people(lab: Lab, section: Section) -> None:
    """Add the labelled people and chairs that the detector and the presets find."""
    if problem := why_absent(lab.detector):
        section.say(f"CenterNet, whose weights are part of a package, was not run: {problem}.")
        return
    assert lab.detector is not None
    tasks = [
        Task(recording, folder, lab.detector)
        for recording, folder in find_recordings(lab.recordings)
        if not recording.images
    ]
    judged = lab.run(judge, tasks)
    seconds = [one for each in judged for one in each.seconds]
    section.say(
        "CenterNet (MobileNetV3, 512 x 512, COCO; benchmarks/paper/detector.py) on labelled frames "
        f"of real cameras, with a score of at least {MIN_SCORE:g}. Only objects labelled as man, "
        "woman, person or chair are required; an object is found if a box overlaps it as in the "
        "experiment realframes. The detector finds the classes of its training, anywhere, and "
        "gives no distance; the presets find any object on the floor and have no classes, so they "
        "have no precision by class. wheeled was trained on frames of aims_slam and d435_boxes, "
        "and its rules were changed after some of the rooms had been evaluated (realframes). "
        f"{sum(one.frames for one in judged)} frames of {len(judged)} recordings; CenterNet takes "
        f"{np.median(seconds or [np.nan]):.3f} s per frame on one core."
    )
    section.add(f"{DETECTOR}.time", float(np.median(seconds or [np.nan])), "s", "lower")
    rows = []
    for method in (DETECTOR, *METHODS):
        row = [method]
        for name in CLASSES:
            every = [one.counts[method, name] for one in judged if (method, name) in one.counts]
            total = Count(*(sum(column) for column in zip(*every, strict=True)))
            row += _cells(section, method, name, total)
        rows.append(row)
    header = [f"{name}: {text}" for name in CLASSES for text in ("found", "recall", "precision")]
    section.table(["Method", *header], rows)


def _cells(section: Section, method: str, name: str, count: Count) -> list[str]:
    texts = [f"{count.matched} of {count.objects}"]
    for figure, whole in (("recall", count.objects), ("precision", count.detections)):
        share = count.matched / whole if whole else float("nan")
        ends = wilson(count.matched, whole)
        if method == DETECTOR or figure == "recall":
            section.add(f"{method}.{name}.{figure}", share, "", "higher", ends)
        texts.append(percent(share, ends))
    return texts


def classes_of(recording: Recording) -> dict[int, np.ndarray]:
    """Return the class of each labelled obstacle, by the number of the frame."""
    names = read_names(BOXES / f"{recording.name}.txt")
    return {
        frame: np.array([class_of(name) for name in mine], np.str_) for frame, mine in names.items()
    }


def judge(task: Task) -> Judgement:
    """Run the detector and the presets on the labelled frames of a recording."""
    wanted, detector = classes_of(task.recording), load_detector(task.detector)
    least, counts, seconds = task.recording.least_iou, {}, []
    boxes = read_boxes(BOXES / f"{task.recording.name}.txt")
    with open_log(str(task.folder / task.recording.place)) as log:
        for title in METHODS:
            config = PRESETS[title]
            for found in find_obstacles(log, config):
                frames, number = found.frames, int(found.frames.number[0])
                if number not in wanted:
                    continue
                image = frames.calibration.image
                known = boxes[number]
                sides = image.width, image.height
                labels = labels_of_boxes(known.boxes, known.distance_m, known.ignored, *sides)
                _add(counts, title, wanted[number], labels, found.boxes, least)
                if not config.cluster.points or frames.color is None:
                    continue  # colour images are only read for the preset paper
                start = time.perf_counter()
                things = detector(frames.color[0])
                seconds.append(time.perf_counter() - start)
                for name, key in CLASSES.items():
                    mine = things.boxes[things.classes == key]
                    chosen = np.where(wanted[number] == name, name, "")
                    _add(counts, DETECTOR, chosen, labels, mine, least, name)
    return Judgement(len(wanted), counts, seconds[1:])


def _add(
    counts: dict[tuple[str, str], Count],
    method: str,
    classes: np.ndarray,
    labels: FrameLabels,
    boxes: np.ndarray,
    least_iou: float,
    only: str = "",
) -> None:
    """Add a frame to the counts.

    Args:
        counts: Counts by method and class, which are changed.
        method: Method that the boxes are from.
        classes: Class of each labelled object, ``(T,)`` str.
        labels: Labels of the frame.
        boxes: Boxes of the detections, ``(n, 4)`` integer.
        least_iou: Minimum IoU of a pair.
        only: Class of all boxes; empty if they have no class.
    """
    counted = boxes[on_known_ground(labels, boxes)]
    of_class = classes == only if only else np.ones(len(classes), bool)
    pairs = np.full(len(classes), -1)
    pairs[of_class] = match_boxes(labels.boxes[of_class], counted, least_iou)
    for name in [only] if only else CLASSES:
        mine = classes == name
        one = Count(int(mine.sum()), int((pairs[mine] >= 0).sum()), len(counted) if only else 0)
        before = counts.get((method, name), Count())
        counts[method, name] = Count(*(a + b for a, b in zip(before, one, strict=True)))
