"""Labelled real recordings: their locations, and the labels of their frames."""

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from benchmarks.paper import stills
from benchmarks.scores.boxes import FrameLabels, labels_of_boxes, labels_of_image
from jaxdet.errors import InputError
from jaxdet.types import Calibration

SHARED_DATA = Path(__file__).parents[3] / "shared" / "data"
"""Folder of recordings if no folders are given."""
BOXES = stills.LABELS
"""Folder of boxes labelled for this project, with a text file for each recording."""
KINDS = ("obstacle", "ignore")
TABLE = ("tabletop", "wheeled")
"""Presets that are compared if the ground is a table top."""


class Recording(NamedTuple):
    """Recording and its labels."""

    name: str
    place: str
    """Path of the log or the folder of stills in the folder of recordings."""
    least_iou: float
    """Minimum overlap (IoU) of a detection with its object."""
    images: str = ""
    """Folder of label images; if empty, the labels are the boxes in :data:`BOXES` under the
    recording's name.
    """
    least_pixels: int = 1
    """Minimum number of pixels of an object that is to be found (label images)."""
    least_height_m: float = 0.0
    """Minimum height of objects; lower ones are neither missed nor false (label images) [m]."""
    learnt: bool = True
    """Whether frames that are not held out are used to train the pairwise evidence."""
    group: str = ""
    """Name of the group with which the recording is reported."""
    held_out: int = 0
    """Interval n of held-out frames: numbers n - 1, 2n - 1 and so on; 0 = none is held out."""
    presets: tuple[str, ...] = ("wheeled", "paper")
    """Presets that are compared; pictures show the first one."""

    def holds_out(self, frame: int) -> bool:
        """Return whether a frame is held out."""
        return self.held_out > 0 and frame % self.held_out == self.held_out - 1


def recordings_of(recipe: Path) -> Iterator[Recording]:
    """Yield the recordings that scripts/rooms_to_mcap makes from a recipe.

    Their group consists of the recipe's name, their ``split``, and their ``place`` if there is one.
    """
    for room in stills.read_recipe(recipe):
        group = [recipe.stem, room["split"], *([room["place"]] if "place" in room else [])]
        name, place = f"{recipe.stem}_{room['name']}", f"{recipe.stem}/{room['name']}.mcap"
        one = Recording(name, place, 0.5, learnt=False, group=".".join(group))
        yield one._replace(presets=TABLE) if room.get("place") == "table" else one


RECORDINGS = (
    Recording(
        "mosd",
        "labelled/mosd.mcap",
        0.5,
        "labelled/mosd_labels",
        300,
        held_out=3,
        presets=(*TABLE, "paper"),
    ),
    Recording("wheelchair", "labelled/wheelchair.mcap", 0.3, "labelled/wheelchair_labels", 150),
    Recording(
        "wheelchair_5cm",
        "labelled/wheelchair.mcap",
        0.3,
        "labelled/wheelchair_labels",
        150,
        least_height_m=0.05,
    ),
    Recording("aims_slam", "aims_slam/aims_slam_18frames.mcap", 0.5, held_out=3),
    Recording("d435_boxes_felixchenfy", "d435_boxes_felixchenfy", 0.5, held_out=3),
    *(one for recipe in (stills.ROOMS, *stills.PUBLIC) for one in recordings_of(recipe)),
)


def find_recordings(
    places: Sequence[Path], names: Sequence[str] = ()
) -> list[tuple[Recording, Path]]:
    """Return the labelled recordings that exist, with their folder.

    Args:
        places: Folders of recordings, or recordings' own folders.
        names: Prefixes of the names or groups of the recordings to find; by default all.
    """
    starts = tuple(names) or ("",)
    folders = [folder for place in places for folder in (place, place.parent)]
    found = []
    for recording in RECORDINGS:
        if not (recording.name.startswith(starts) or recording.group.startswith(starts)):
            continue
        there = [folder for folder in folders if (folder / recording.place).exists()]
        found += [(recording, folder) for folder in there[:1]]
    return found


def labels_of(
    recording: Recording, folder: Path, frame: int, z_m: np.ndarray, calibration: Calibration
) -> FrameLabels | None:
    """Return the labels of a frame, None if it has none.

    Args:
        recording: Recording of :data:`RECORDINGS`.
        folder: Folder of the recording.
        frame: Number of the frame in the log.
        z_m: Forward depth of the colour pixels, ``(H, W)`` float [m], 0 = none.
        calibration: Calibration of the log.
    """
    camera = calibration.image
    if recording.images:
        path = folder / recording.images / f"{frame:03d}.png"
        image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED) if path.is_file() else None
        if image is None:
            return None
        least = recording.least_pixels, recording.least_height_m
        return labels_of_image(image, z_m, camera, *least)
    mine = read_boxes(BOXES / f"{recording.name}.txt").get(frame)
    if mine is None:
        return None
    return labels_of_boxes(
        mine.boxes, mine.distance_m, mine.ignored, camera.width, camera.height, mine.tags
    )


class FrameBoxes(NamedTuple):
    """Labelled boxes of a frame with ``T`` obstacles."""

    boxes: np.ndarray
    """Boxes of the obstacles, ``(T, 4)`` int64 [pixel]."""
    distance_m: np.ndarray
    """Distances of the obstacles, ``(T,)`` float64 [m]."""
    ignored: np.ndarray
    """Boxes of ignored regions, ``(I, 4)`` int64 [pixel]."""
    tags: tuple[frozenset[str], ...]
    """Tags of each obstacle, such as ``low``; see labels/RULE.md."""


class _Row(NamedTuple):
    """Line of a label file."""

    box: list[int]
    distance_m: float
    kind: str
    tags: frozenset[str]


def read_boxes(path: Path) -> dict[int, FrameBoxes]:
    """Read the boxes of a recording's frames, by the frames' numbers.

    Raises:
        InputError: A line is not ``frame u_min v_min u_max v_max distance_m kind name [tags]``,
            where the tags are optional.
    """
    rows: dict[int, list[_Row]] = {}
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        if not line.strip() or line.startswith("#"):
            continue
        try:
            frame, *box, distance, kind, name = line.split(None, 7)
            u, v, right, bottom = map(int, box)
            if kind not in KINDS or not (0 <= u <= right and 0 <= v <= bottom):
                raise ValueError(kind)
            metres = float(distance) if kind == "obstacle" else np.nan
        except ValueError as error:
            raise InputError(f"line {number} is not a label: {line!r}", path=str(path)) from error
        row = _Row([u, v, right, bottom], metres, kind, _tags(name))
        rows.setdefault(int(frame), []).append(row)
    return {frame: _frame_boxes(mine) for frame, mine in rows.items()}


def _tags(name: str) -> frozenset[str]:
    """Return the tags after a name: ``low`` and ``cut`` of ``board [low,cut]``."""
    tags = re.search(r"\[([a-z, ]+)\]\s*$", name)
    return frozenset(tag.strip() for tag in tags[1].split(",")) if tags else frozenset()


def _frame_boxes(rows: list[_Row]) -> FrameBoxes:
    obstacles = [row for row in rows if row.kind == "obstacle"]
    boxes, ignored = (
        np.array([row.box for row in rows if row.kind == kind], np.int64).reshape(-1, 4)
        for kind in KINDS
    )
    distance = np.array([row.distance_m for row in obstacles], np.float64)
    return FrameBoxes(boxes, distance, ignored, tuple(row.tags for row in obstacles))


def read_names(path: Path) -> dict[int, list[str]]:
    """Return the names of the obstacles by frame, in the order of their boxes."""
    names: dict[int, list[str]] = {}
    for line in path.read_text(encoding="utf-8").splitlines():
        if line.strip() and not line.startswith("#"):
            frame, *_, kind, name = line.split(None, 7)
            names.setdefault(int(frame), []).extend([name] * (kind == "obstacle"))
    return names
