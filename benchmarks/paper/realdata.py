"""Pictures of every frame of real recordings, as contact sheets."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from benchmarks.paper.lab import Lab
from benchmarks.paper.pictures import encode, frame_picture, grid, scaled
from benchmarks.paper.section import Section
from benchmarks.paper.timing import split_batch
from jaxdet.config import Config
from jaxdet.engine import decide_planes
from jaxdet.errors import InputError, JaxdetError
from jaxdet.floor.plane import repeat_plane
from jaxdet.io import open_log
from jaxdet.pipeline import detect, estimate_plane
from jaxdet.results.rows import to_host
from jaxdet.types import Calibration, Frames, Intrinsics

SHEET = (3, 5)
"""Numbers of columns and rows of a sheet."""
WIDTH = 620
CAMERA_FILE = "cam_params_realsense.json"


class Recording(NamedTuple):
    """Frames of a folder or a log, with the prior of their floor."""

    name: str
    frames: Frames
    numbers: tuple[str, ...]
    """Name of each frame."""


def run(lab: Lab, place: Path, number: int = 0) -> Section:
    """Draw contact sheets of all recordings in a folder: logs, and folders of PNG pairs."""
    section = Section(f"recordings{number}", f"Real recordings: {place.name}")
    section.say(
        "Pictures only, without labels. The floor is estimated in each frame. The prior is one "
        "plane per recording of a mounted camera; images of a hand-held camera have none."
    )
    try:
        recordings = list(find(place, lab.config))
    except JaxdetError as error:
        section.say(f"Not read: {error}")
        recordings = []
    for recording in recordings:
        add(section, recording, lab.config)
    return section


def find(place: Path, config: Config) -> Iterator[Recording]:
    """Yield the recordings in a folder.

    Raises:
        InputError: The folder contains no recordings.
    """
    data = place / "data" if (place / "data").is_dir() else place
    if (data / CAMERA_FILE).is_file():
        yield _stills(data, place.name)
        return
    logs = sorted(place.glob("*.mcap"))
    if not logs:
        problem = "contains neither a log nor a camera file"
        raise InputError(problem, path=str(place), remedy="pass the folder of the recordings")
    for path in logs:
        with open_log(str(path)) as log:
            frames = log.read(range(log.num_frames), color=True).frames
            planes = decide_planes(log, config, "reference").of(frames.stamp_ns)
            numbers = tuple(map(str, range(log.num_frames)))
            yield Recording(path.stem, frames._replace(plane=planes), numbers)
            if (data / "rgb").is_dir():
                yield _pairs(data, place.name, log.calibration, config)
                return


def _stills(data: Path, name: str) -> Recording:
    """Return the aligned stills of a hand-held camera, without a prior of the floor."""
    about = json.loads((data / CAMERA_FILE).read_text(encoding="utf-8"))
    K = np.reshape(about["intrinsic_matrix"], (3, 3)).T.tolist()
    size = about["width"], about["height"]
    camera = Intrinsics(*size, K[0][0], K[1][1], K[0][2], K[1][2])
    frames, names = _read(data / "color", data / "depth", Calibration(camera))
    return Recording(name, frames, names)


def _pairs(data: Path, name: str, calibration: Calibration, config: Config) -> Recording:
    """Return the PNG pairs of a mounted camera, with one floor and the calibration of its log."""
    frames, names = _read(data / "rgb", data / "depth", calibration)
    plane = estimate_plane(frames, config, backend="reference").plane
    return Recording(f"{name} pairs", frames._replace(plane=repeat_plane(plane, len(names))), names)


def _read(color: Path, depth: Path, calibration: Calibration) -> tuple[Frames, tuple[str, ...]]:
    """Read the PNG pairs with equal names, in the order of their numbers."""
    paths = sorted(color.glob("*.png"), key=lambda p: (len(p.stem), p.stem))
    paths = [path for path in paths if (depth / path.name).is_file()]
    images = [cv2.imread(str(path), cv2.IMREAD_COLOR) for path in paths]
    depths = [cv2.imread(str(depth / path.name), cv2.IMREAD_UNCHANGED) for path in paths]
    count, zero = len(paths), np.zeros(len(paths), np.int64)
    colors = np.stack([np.asarray(image)[..., ::-1] for image in images])
    frames = Frames(
        np.stack([np.asarray(image).astype(np.uint16) for image in depths]),
        calibration,
        np.arange(count),
        zero,
        np.ones(count, bool),
        np.ascontiguousarray(colors),
        zero,
    )
    return frames, tuple(path.stem for path in paths)


def _one(frames: Frames, b: int) -> Frames:
    return split_batch(frames)[b]._replace(T_world_camera=None)


def add(section: Section, recording: Recording, config: Config) -> None:
    """Add a recording's sheets and its mean number of obstacles to a section."""
    pictures: list[np.ndarray] = []
    counts: list[int] = []
    for b, number in enumerate(recording.numbers):
        if not recording.frames.valid[b]:
            continue
        one = _one(recording.frames, b)
        found = to_host(detect(one, config, backend="reference", with_cells=True))
        counts.append(int(found.num_obstacles[0]))
        title = f"{recording.name} {number}"
        pictures.append(scaled(frame_picture(one, found, config, title), WIDTH))
    columns, rows = SHEET
    step = columns * rows
    text = f"{recording.name}: {len(pictures)} frames, {np.mean(counts or [0]):.1f} obstacles each."
    section.say(text)
    section.add(f"{recording.name}.obstacles", float(np.mean(counts or [0])), "", "info")
    for first in range(0, len(pictures), step):
        sheet = encode(grid(pictures[first : first + step], columns))
        name = f"{recording.name.replace(' ', '_')}_{first // step:02d}"
        section.picture(name, sheet, f"{recording.name}, from frame {first}.")
