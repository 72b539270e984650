"""Labelled real recordings: where they are, and what is known of their frames."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from benchmarks.scores.boxes import FrameLabels, labels_of_boxes, labels_of_image
from jaxdet.errors import InputError
from jaxdet.types import Calibration

BESIDE = Path(__file__).parents[3] / "shared" / "data"
"""Where recordings are looked for unless folders are named."""
BOXES = Path(__file__).with_name("labels")
"""Boxes labelled for this project, a text file a recording."""
KINDS = ("obstacle", "ignore")


ROOMS = {
    room["name"]: bool(room["untouched"])
    for room in json.loads((BOXES / "rooms.json").read_text(encoding="utf-8"))
}
"""Recordings that scripts/rooms_to_mcap makes of public repositories: whether nothing was chosen or
mended by what is found in them."""


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

    def holds_out(self, frame: int) -> bool:
        """Whether the frame of this number is held out."""
        return self.held_out > 0 and frame % self.held_out == self.held_out - 1


RECORDINGS = (
    Recording("mosd", "labelled/mosd.mcap", 0.5, "labelled/mosd_labels", 300, held_out=3),
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
    *(
        Recording(
            f"rooms_{name}",
            f"rooms/{name}.mcap",
            0.5,
            learnt=False,
            group="rooms.untouched" if untouched else "rooms.looked_at",
        )
        for name, untouched in ROOMS.items()
    ),
)


def find_recordings(places: Sequence[Path]) -> list[tuple[Recording, Path]]:
    """The labelled recordings that are there, with their folder.

    Args:
        places: Folders of recordings, or recordings' own folders.
    """
    folders = [folder for place in places for folder in (place, place.parent)]
    found = []
    for recording in RECORDINGS:
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
    boxes = read_boxes(BOXES / f"{recording.name}.txt").get(frame)
    return labels_of_boxes(*boxes, camera.width, camera.height) if boxes else None


def read_boxes(path: Path) -> dict[int, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Boxes of a recording's frames, by their number.

    Returns:
        The obstacles' boxes ``(T, 4)`` int64, their distances ``(T,)`` float64 [m] and the
        ignored regions ``(I, 4)`` int64.

    Raises:
        InputError: A line is not ``frame u_min v_min u_max v_max distance_m kind name``.
    """
    rows: dict[int, list[tuple[list[int], float, str]]] = {}
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        if not line.strip() or line.startswith("#"):
            continue
        try:
            frame, *box, distance, kind, _ = line.split(None, 7)
            u, v, right, bottom = map(int, box)
            if kind not in KINDS or not (0 <= u <= right and 0 <= v <= bottom):
                raise ValueError(kind)
            metres = float(distance) if kind == "obstacle" else np.nan
        except ValueError as error:
            raise InputError(f"line {number} is no label: {line!r}", path=str(path)) from error
        rows.setdefault(int(frame), []).append(([u, v, right, bottom], metres, kind))
    return {frame: _arrays(mine) for frame, mine in rows.items()}


def _arrays(
    rows: list[tuple[list[int], float, str]],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    boxes, ignored = (
        np.array([box for box, _, one in rows if one == kind], np.int64).reshape(-1, 4)
        for kind in KINDS
    )
    distance = np.array([metres for _, metres, kind in rows if kind == "obstacle"], np.float64)
    return boxes, distance, ignored


def read_names(path: Path) -> dict[int, list[str]]:
    """Return the names of the obstacles of a recording's frames, in the order of their boxes."""
    names: dict[int, list[str]] = {}
    for line in path.read_text(encoding="utf-8").splitlines():
        if line.strip() and not line.startswith("#"):
            frame, *_, kind, name = line.split(None, 7)
            names.setdefault(int(frame), []).extend([name] * (kind == "obstacle"))
    return names
