"""Labelled real recordings: where they are, and what is known of their frames."""

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

BESIDE = Path(__file__).parents[3] / "shared" / "data"
"""Where recordings are looked for unless folders are named."""
BOXES = stills.LABELS
"""Boxes labelled for this project, a text file a recording."""
KINDS = ("obstacle", "ignore")
TABLE = ("tabletop", "wheeled")
"""Presets that are compared where a table top is the ground."""


class Recording(NamedTuple):
    """A recording and its labels."""

    name: str
    place: str
    """The log, or the folder of stills, under the folder of recordings."""
    least_iou: float
    """Least overlap of a detection and its object."""
    images: str = ""
    """Folder of label images beside it; by default the boxes of :data:`BOXES` under its name."""
    least_pixels: int = 1
    """Objects of fewer pixels are not asked for (label images)."""
    least_height_m: float = 0.0
    """Lower objects are neither missed nor false (label images)."""
    learnt: bool = True
    """Frames that are not held out are learnt from where they show what is one thing."""
    group: str = ""
    """Recordings of a group are reported together."""
    held_out: int = 0
    """Frames whose number leaves this less 1 over when divided by it are held out; 0: none."""
    presets: tuple[str, ...] = ("wheeled", "paper")
    """Presets that are compared; pictures show the first."""

    def holds_out(self, frame: int) -> bool:
        """Whether the frame of this number is held out."""
        return self.held_out > 0 and frame % self.held_out == self.held_out - 1


def recordings_of(recipe: Path) -> Iterator[Recording]:
    """Yield the recordings that scripts/rooms_to_mcap makes of a recipe.

    Their group is the recipe's name, their ``split``, and their ``place`` if the recipe has it.
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
    *recordings_of(stills.ROOMS),
    *recordings_of(stills.PUBLIC),
)


def find_recordings(
    places: Sequence[Path], names: Sequence[str] = ()
) -> list[tuple[Recording, Path]]:
    """The labelled recordings that are there, with their folder.

    Args:
        places: Folders of recordings, or recordings' own folders.
        names: Beginnings of the names or groups of those to look for; by default all.
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
    """What is known of a frame, None where it has no label.

    Args:
        recording: Of :data:`RECORDINGS`.
        folder: Its folder.
        frame: The frame's number in the log.
        z_m: ``(H, W)`` float, its forward depth at the colour pixels [m], 0 = none.
        calibration: Of the log.
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
    """``(T, 4)`` int64, boxes of the obstacles [pixel]."""
    distance_m: np.ndarray
    """``(T,)`` float64 [m]."""
    ignored: np.ndarray
    """``(I, 4)`` int64, ignored regions [pixel]."""
    tags: tuple[frozenset[str], ...]
    """Tags of each obstacle, such as ``low`` (labels/RULE.md has them)."""


class _Row(NamedTuple):
    """A line of labels."""

    box: list[int]
    distance_m: float
    kind: str
    tags: frozenset[str]


def read_boxes(path: Path) -> dict[int, FrameBoxes]:
    """Boxes of a recording's frames, by their number.

    Raises:
        InputError: A line is not ``frame u_min v_min u_max v_max distance_m kind name [tags]``,
            where the tags may be left out.
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
            raise InputError(f"line {number} is no label: {line!r}", path=str(path)) from error
        row = _Row([u, v, right, bottom], metres, kind, _tags(name))
        rows.setdefault(int(frame), []).append(row)
    return {frame: _frame_boxes(mine) for frame, mine in rows.items()}


def _tags(name: str) -> frozenset[str]:
    """Tags behind a name: ``low`` and ``cut`` of ``board [low,cut]``."""
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
    """Return the names of the obstacles of a recording's frames, in the order of their boxes."""
    names: dict[int, list[str]] = {}
    for line in path.read_text(encoding="utf-8").splitlines():
        if line.strip() and not line.startswith("#"):
            frame, *_, kind, name = line.split(None, 7)
            names.setdefault(int(frame), []).extend([name] * (kind == "obstacle"))
    return names
