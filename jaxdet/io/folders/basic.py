"""Basic layout of folders of images: TUM's RGB-D benchmark, Open3D, Redwood.

A folder has a subfolder of colour images (``rgb color colour image``: PNG, JPEG) and one of depth
images (``depth``: 16-bit PNG, aligned to colour). Optional files:

- ``rgb.txt`` and ``depth.txt``, named after the subfolders, list timestamps [s] and names. Without
  them, names with a decimal point are timestamps, ``NUMBER-TIME.png`` has microseconds (Redwood),
  and the last number in other names that differs between all of them is a frame number, with
  :data:`RATE_HZ` frames per second.
- ``groundtruth.txt`` has the camera's poses (timestamp, tx ty tz, qx qy qz qw). A matrix per frame
  can be in ``pose/NAME.txt``.
- A JSON file has the camera matrix: ``intrinsic_matrix`` (nine numbers, column-major), ``width``,
  ``height`` and optionally ``depth_scale`` (depth units per metre).

Sources: "File Formats" of the TUM benchmark; Open3D's ``PinholeCameraIntrinsic`` and
``RGBDVideoMetadata``; Redwood's web page.
"""

import json
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxdet.errors import InputError, printable
from jaxdet.io.folders.recording import (
    COLOR,
    DEPTH,
    POSES,
    SECOND,
    Cameras,
    Image,
    ImageFiles,
    Pose,
    Recording,
    entry,
    nanoseconds,
    read_matrix,
    read_table,
)
from jaxdet.types import Intrinsics, is_rigid

RATE_HZ = 30
LISTED_DEPTH = "depth.txt"
_FIRST_NS = SECOND
"""Timestamp of frame 0 if frames only have numbers, as a timestamp of 0 counts as missing [ns]."""
_MAX_JSON_BYTES = 1 << 20
_MAX_FLOAT32 = float(np.finfo(np.float32).max)
_WITH_TIME = re.compile(r"\d{7}-(\d{12})")
"""Frame number and time [us]."""
_MAX_DIGITS = 9
"""Maximum number of digits of a frame number."""


def read_cameras(folder: Path, *_unused: Sequence[Image]) -> Cameras:
    """Read camera and depth unit from the JSON file with a camera matrix, if there is one."""
    files = [path for path in sorted(folder.iterdir()) if path.suffix.lower() == ".json"]
    found = [(path, about) for path in files if (about := _camera(path))]
    if not found:
        return Cameras()
    if len(found) > 1:
        names = ", ".join(path.name for path, _ in found)
        raise InputError(f"several calibrations: {names}", path=str(folder), remedy="keep one")
    path, about = found[0]
    try:
        fx, _, lower, _, fy, row, cx, cy, one = (float(item) for item in about["intrinsic_matrix"])
        if (lower, row, one) != (0, 0, 1):
            raise ValueError("not column-major")
        width, height = int(about["width"]), int(about["height"])
        unit_m = 1 / float(about.get("depth_scale", 1000))
        if not 0 <= min(width, height) <= max(width, height) < 1 << 32:
            raise ValueError("width or height is out of range")
        if abs(unit_m) > _MAX_FLOAT32:
            raise ValueError("depth_scale is out of range")
    except (ArithmeticError, KeyError, TypeError, ValueError) as error:
        problem = f"the calibration can't be read ({type(error).__name__}: {error})"
        remedy = "it must have intrinsic_matrix (nine numbers, column-major), width and height"
        raise InputError(problem, path=str(path), remedy=remedy) from error
    return Cameras(Intrinsics(width, height, fx, fy, cx, cy), depth_unit_m=unit_m)


def read(
    folder: Path,
    color: ImageFiles = COLOR,
    depth: ImageFiles = DEPTH,
    cameras: Callable[[Path, Sequence[Image], Sequence[Image]], Cameras] = read_cameras,
    poses: ImageFiles = POSES,
) -> Recording:
    """Read a folder; ``cameras`` reads its calibration from the folder and its images.

    Raises:
        InputError: A file, or the name of an image, is not as expected.
    """
    colors, has_color_stamps = _images(folder, color)
    depths, has_depth_stamps = _images(folder, depth)
    found = _listed_poses(folder) + _poses_of_frames(depths, depth, poses.by_frame(folder))
    note = ""
    if not (has_color_stamps and has_depth_stamps):
        note = f"it has no timestamps; {RATE_HZ} frames per second are assumed"
    return Recording(colors, depths, cameras(folder, colors, depths), found, note)


def _images(folder: Path, files: ImageFiles) -> tuple[list[Image], bool]:
    """Return images, and whether their timestamps were recorded."""
    paths = files.paths(folder)
    lists = (entry(folder, f"{name}.txt") for name in files.folders)
    path = next((path for path in lists if path.is_file()), None)
    if path and paths:
        rows = read_table(path, 2)
        listed = [Image(nanoseconds(stamp, path), folder / name) for stamp, name in rows]
        if not any(image.path.is_file() for image in listed):
            example = f", for example {printable(rows[0][1])!r}" if rows else ""
            problem = f"none of the {len(rows)} images in this list exists{example}"
            raise InputError(problem, path=str(path), remedy="correct or remove the list")
        return listed, True
    images = {path: files.frame_name(path) for path in paths}
    if all("." in name for name in images.values()):
        return [Image(nanoseconds(name, path), path) for path, name in images.items()], True
    timed = [match for name in images.values() if (match := _WITH_TIME.fullmatch(name))]
    has_times = len(timed) == len(images)
    after_ns = [int(match[1]) * 1000 for match in timed]
    if not has_times:
        after_ns = [number * SECOND // RATE_HZ for number in _frame_numbers(images)]
    stamps = [_FIRST_NS + ns for ns in after_ns]
    return list(map(Image, stamps, paths)), has_times


def _frame_numbers(names: Mapping[Path, str]) -> list[int]:
    """Return the frame numbers in the names of images: the last number that is never the same.

    Raises:
        InputError: A name has no number, or two have the same number.
    """
    found = {path: re.findall(r"\d+", name)[::-1] for path, name in names.items()}
    columns = zip(*found.values(), strict=False)
    columns = [[*map(int, column)] for column in columns if max(map(len, column)) <= _MAX_DIGITS]
    if not columns:
        path = min(found, key=lambda path: len(found[path]))
        problem = "the name has neither a timestamp in seconds nor a frame number"
        raise InputError(problem, path=str(path), remedy="number the images, or write rgb.txt")
    for numbers in columns:
        if len({*numbers}) == len(numbers):
            return numbers
    [(number, count)] = Counter(columns[0]).most_common(1)
    problem, folder = f"{count} images have the frame number {number}", next(iter(names)).parent
    raise InputError(problem, path=str(folder), remedy="remove all but one, or number the images")


def _camera(path: Path) -> dict[str, Any] | None:
    """Return the contents of a JSON file with a camera matrix; None for other files."""
    if path.stat().st_size > _MAX_JSON_BYTES:
        return None
    try:
        found = json.loads(path.read_bytes())
    except (ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) and "intrinsic_matrix" in found else None


def _listed_poses(folder: Path) -> list[Pose]:
    """Read the poses in ``groundtruth.txt``."""
    path = entry(folder, "groundtruth.txt")
    if not path.exists():
        return []
    found = []
    for stamp, *words in read_table(path, 8):
        stamp_ns = nanoseconds(stamp, path)
        try:
            numbers = [float(word) for word in words]
        except ValueError as error:
            problem = "a pose is not numeric"
            raise InputError(problem, path=str(path), remedy="correct it") from error
        found.append(Pose(stamp_ns, numbers[:3], numbers[3:]))
    return found


def _poses_of_frames(
    images: Sequence[Image], files: ImageFiles, poses: Mapping[str, Path]
) -> list[Pose]:
    """Read the poses of depth images from the files ``poses``; invalid poses are left out."""
    found = []
    for stamp_ns, image in images:
        path = poses.get(files.frame_key(image))
        if path is not None and is_rigid(T := read_matrix(path, 4)):
            found.append(Pose.of_matrix(stamp_ns, T))
    return found
