"""Layouts of iPhone recordings: Stray Scanner and Record3D.

Stray Scanner writes depth (16-bit PNG in millimetres) and ``confidence`` (0, 1, 2), one file per
frame; ``camera_matrix.csv`` for the colour video with 1920x1440 pixels; and ``odometry.csv`` with
timestamp, frame, position and quaternion of the optical frame. Its colour is a video, which is not
supported.

Record3D's export has ``metadata.json`` with ``K`` (column-major) for images of ``w`` x ``h``
pixels, ``frameTimestamps`` or ``fps``, and ``poses`` (quaternion, position) of ARKit's camera,
whose y axis is up and whose z axis is backward. Its OpenEXR depth must be converted to PNG.

The y axis of ARKit's world is up; here the z axis is up. Sources: "Data Specification" in Stray
Scanner's documentation and its ``OdometryEncoder``; Record3D's web page on its formats.
"""

import csv
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from jaxdet.errors import InputError, printable
from jaxdet.io.folders.recording import (
    COLOR,
    DEPTH,
    SECOND,
    Cameras,
    Image,
    ImageFiles,
    Pose,
    Recording,
    entry,
    image_size,
    read_text,
)
from jaxdet.io.message_fields import MAX_ROS2_STAMP_S
from jaxdet.io.motion import motion_matrix
from jaxdet.types import Intrinsics

ODOMETRY, MATRIX, METADATA = "odometry.csv", "camera_matrix.csv", "metadata.json"
_VIDEO_SIZE = 1920, 1440
"""Image size of Stray Scanner's camera matrix [pixel]."""
_MAX_STRETCH = 0.02
"""Maximum relative difference of two aspect ratios, as sizes are rounded to pixels."""
_Z_UP = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
"""Transform from ARKit's world to a world with z up."""
_ARKIT_OPTICAL = np.diag([1.0, -1, -1, 1])
"""Transform from the optical frame to ARKit's camera frame."""


def read_stray_scanner(folder: Path) -> Recording | None:
    """Read a folder of Stray Scanner.

    Raises:
        InputError: A file is damaged, or no depth image has a timestamp.
    """
    odometry, matrix = entry(folder, ODOMETRY), entry(folder, MATRIX)
    if not (odometry.is_file() and matrix.is_file()):
        return None
    with _damage_as_error(folder):
        lines = read_text(odometry).splitlines()[1:]
        rows = csv.reader(lines, skipinitialspace=True)
        values = np.array([row[:9] for row in rows if len(row) >= 9], np.float64).reshape(-1, 9)
        K = np.array([*csv.reader(read_text(matrix).splitlines())], np.float64)
        poses = motion_matrix(values[:, 2:5], values[:, 5:9])
        numbers = values[:, 1].astype(np.int64).tolist()
        return _recording(folder, numbers, values[:, 0], poses, K.reshape(3, 3), _VIDEO_SIZE)


def read_record3d(folder: Path) -> Recording | None:
    """Read a folder that Record3D exported.

    Raises:
        InputError: A file is damaged, or no depth image has a timestamp.
    """
    metadata = entry(folder, METADATA)
    if not metadata.is_file():
        return None
    with _damage_as_error(folder):
        about = json.loads(read_text(metadata))
        if not isinstance(about, dict) or not {"K", "w", "h"} <= about.keys():
            return None
        values = np.array(about.get("poses", []), np.float64).reshape(-1, 7)
        times = about.get("frameTimestamps")
        if times is None:
            count = max(len(values), *(len(files.paths(folder)) for files in (COLOR, DEPTH)))
            times = [number / float(about["fps"]) for number in range(count)]
        poses = motion_matrix(values[:, 4:], values[:, :4]) @ _ARKIT_OPTICAL
        K = np.array(about["K"], np.float64).reshape(3, 3).T
        size = int(about["w"]), int(about["h"])
        times_s = np.array(times, np.float64).reshape(len(times))
        return _recording(folder, range(len(times)), times_s, poses, K, size)


@contextmanager
def _damage_as_error(folder: Path) -> Iterator[None]:
    """Convert the errors of damaged metadata to ``InputError``; invalid poses become NaN."""
    try:
        with np.errstate(all="ignore"):
            yield
    except (ArithmeticError, csv.Error, KeyError, TypeError, ValueError, RecursionError) as error:
        problem = f"the recording's data can't be read ({type(error).__name__}: {error})"
        raise InputError(problem, path=str(folder), remedy="export it again") from error


def _recording(
    folder: Path,
    numbers: Sequence[int],
    times_s: np.ndarray,
    poses: np.ndarray,
    K: np.ndarray,
    size: tuple[int, int],
) -> Recording:
    """Check metadata, and combine them with the images.

    Args:
        folder: Folder of the recording.
        numbers: Frame numbers in the file names, ``N`` items.
        times_s: Timestamps ``(N,)`` float64 [s].
        poses: Poses of the optical frame in ARKit's world, ``(M, 4, 4)`` float64; NaN if unknown.
        K: Camera matrix ``(3, 3)`` float64 for images of ``size``.
        size: Image width and height [pixel].
    """
    if not (np.isfinite(K).all() and min(size) > 0 and K[0, 0] > 0 and K[1, 1] > 0):
        raise ValueError("the camera matrix is invalid")
    if not ((times_s >= 0) & (times_s < MAX_ROS2_STAMP_S)).all():
        raise ValueError("a timestamp is out of range")
    # A timestamp of zero would count as missing.
    stamps = np.round(times_s * 1e9).astype(np.int64) + (SECOND if not times_s.all() else 0)
    stamp_of = dict(zip(numbers, stamps.tolist(), strict=True))
    color, depth = (_images(files, folder, stamp_of) for files in (COLOR, DEPTH))
    if not depth:
        raise ValueError("no depth image has a timestamp")
    used = {image.path for image in depth}
    lost = [printable(path.name) for path in DEPTH.paths(folder) if path not in used]
    cameras = Cameras(_camera(K, size, color), _camera(K, size, depth))
    world = zip(stamps.tolist(), _Z_UP @ poses, strict=False)
    posed = [Pose.of_matrix(stamp_ns, T) for stamp_ns, T in world if np.isfinite(T).all()]
    note = f"{len(lost)} depth images without a timestamp are left out, for example "
    return Recording(color, depth, cameras, posed, note + lost[0] if lost else "")


def _images(files: ImageFiles, folder: Path, stamp_of: Mapping[int, int]) -> list[Image]:
    """Return the images with a timestamp."""
    found = []
    for path in files.paths(folder):
        name = files.frame_name(path)
        if name.isdecimal() and (number := int(name[-9:])) in stamp_of:
            found.append(Image(stamp_of[number], path))
    return found


def _camera(K: np.ndarray, size: tuple[int, int], images: Sequence[Image]) -> Intrinsics | None:
    """Return the intrinsics of images from ``K``, which is for images of ``size``."""
    if not (own := image_size(images)):
        return None
    x, y = own[0] / size[0], own[1] / size[1]
    if abs(x / y - 1) > _MAX_STRETCH:
        sizes = f"{size[0]}x{size[1]} pixels, but images have {own[0]}x{own[1]}"
        raise ValueError(f"the camera matrix is for {sizes}")
    return Intrinsics(*own, K[0, 0] * x, K[1, 1] * y, K[0, 2] * x, K[1, 2] * y)
