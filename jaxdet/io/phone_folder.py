"""Folders of iPhone recordings: calibration, timestamps and poses of Stray Scanner and Record3D.

Stray Scanner writes depth (16-bit PNG in millimetres) and ``confidence`` (0, 1, 2), one file per
frame; ``camera_matrix.csv`` for the colour video with 1920x1440 pixels; and ``odometry.csv`` with
timestamp, frame, position and quaternion of the optical frame. Its colour is a video, which is not
supported.

Record3D's export has ``metadata.json`` with ``K`` (column-major) for images of ``w`` x ``h``
pixels, ``frameTimestamps`` or ``fps``, and ``poses`` (quaternion, position) of ARKit's camera,
whose y axis is up and whose z axis is backward. Its depth is OpenEXR, which is not supported, or
PNG converted from that.

The y axis of ARKit's world is up; here the z axis is up. Sources: "Data Specification" in Stray
Scanner's documentation and its ``OdometryEncoder``; Record3D's web page on its formats.
"""

import csv
import json
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxdet.errors import InputError
from jaxdet.io.message_fields import MAX_ROS2_STAMP_S
from jaxdet.io.motion import motion_matrix
from jaxdet.types import Intrinsics

ODOMETRY, MATRIX, METADATA = "odometry.csv", "camera_matrix.csv", "metadata.json"
_VIDEO_SIZE = 1920, 1440
"""Image size of Stray Scanner's camera matrix [pixel]."""
_MAX_BYTES = 64 << 20
_Z_UP = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
"""Transform from ARKit's world to a world with z up."""
_ARKIT_OPTICAL = np.diag([1.0, -1, -1, 1])
"""Transform from the optical frame to ARKit's camera frame."""


class PhoneRecording(NamedTuple):
    """Metadata of an iPhone recording; frame numbers are those in the file names."""

    stamps_ns: dict[int, int]
    """Timestamps by frame number [ns]."""
    poses: dict[int, np.ndarray]
    """Poses ``T_world_camera`` of the optical frame by frame number, ``(4, 4)`` float64; z is up.
    """
    K: np.ndarray
    """Camera matrix ``(3, 3)`` float64 for images of ``size``."""
    size: tuple[int, int]
    """Image width and height [pixel]."""

    def camera(self, size: tuple[int, int]) -> Intrinsics:
        """Return the camera for images of another size with the same field of view."""
        x, y = (mine / own for mine, own in zip(size, self.size, strict=True))
        K = self.K
        return Intrinsics(*size, K[0, 0] * x, K[1, 1] * y, K[0, 2] * x, K[1, 2] * y)


def read_phone(folder: Path) -> PhoneRecording | None:
    """Read the metadata of a folder; None if it is not from an iPhone.

    Raises:
        InputError: A file is damaged.
    """
    try:
        if (folder / ODOMETRY).is_file() and (folder / MATRIX).is_file():
            return _stray(folder)
        if (folder / METADATA).is_file():
            return _record3d(folder)
    except (ArithmeticError, csv.Error, KeyError, TypeError, ValueError, RecursionError) as error:
        problem = f"the recording's data can't be read ({type(error).__name__}: {error})"
        raise InputError(problem, path=str(folder), remedy="export it again") from error
    return None


def _stray(folder: Path) -> PhoneRecording:
    rows = list(csv.reader(_text(folder / ODOMETRY).splitlines()[1:], skipinitialspace=True))
    values = np.array([row[:9] for row in rows if row], np.float64).reshape(-1, 9)
    matrix = np.array([*csv.reader(_text(folder / MATRIX).splitlines())], np.float64)
    poses = motion_matrix(values[:, 2:5], values[:, 5:9])
    numbers = values[:, 1].astype(np.int64).tolist()
    return _recording(numbers, values[:, 0], poses, matrix.reshape(3, 3), _VIDEO_SIZE)


def _record3d(folder: Path) -> PhoneRecording | None:
    about = json.loads(_text(folder / METADATA))
    if not isinstance(about, dict) or not {"K", "w", "h"} <= about.keys():
        return None
    values = np.array(about.get("poses", []), np.float64).reshape(-1, 7)
    times = about.get("frameTimestamps")
    if times is None:
        times = np.arange(len(values)) / float(about["fps"])
    poses = motion_matrix(values[:, 4:], values[:, :4]) @ _ARKIT_OPTICAL
    matrix = np.array(about["K"], np.float64).reshape(3, 3).T
    numbers = range(len(values))
    return _recording(numbers, np.array(times), poses, matrix, (int(about["w"]), int(about["h"])))


def _recording(
    numbers: Sequence[int],
    times_s: np.ndarray,
    poses: np.ndarray,
    K: np.ndarray,
    size: tuple[int, int],
) -> PhoneRecording:
    """Check and assemble the metadata."""
    known = [bool(np.isfinite(T).all()) for T in poses]
    in_range = (times_s >= 0) & (times_s < MAX_ROS2_STAMP_S)
    if not (np.isfinite(K).all() and min(size) > 0 and K[0, 0] > 0 and K[1, 1] > 0):
        raise ValueError("the camera matrix is invalid")
    if not in_range.all():
        raise ValueError("a timestamp is out of range")
    # A timestamp of zero would mean that there is none.
    stamps = np.round(times_s * 1e9).astype(np.int64) + (1_000_000_000 if not times_s.all() else 0)
    world = _Z_UP @ poses
    return PhoneRecording(
        dict(zip(numbers, stamps.tolist(), strict=True)),
        {number: T for number, T, good in zip(numbers, world, known, strict=True) if good},
        K,
        size,
    )


def _text(path: Path) -> str:
    if path.stat().st_size > _MAX_BYTES:
        raise ValueError(f"{path.name} is too large")
    return path.read_text("utf-8", "replace")
