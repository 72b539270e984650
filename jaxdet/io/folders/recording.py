"""Contents of a folder of images in one form, and the text files from which layouts read it."""

import os
from collections.abc import Sequence
from decimal import Decimal, InvalidOperation
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxdet.errors import FrameError, InputError
from jaxdet.io.compressed import compressed_size
from jaxdet.io.message_fields import MAX_ROS2_STAMP_S
from jaxdet.io.messages import CompressedImageMessage
from jaxdet.io.motion import quaternions
from jaxdet.types import Intrinsics

SECOND = 1_000_000_000
"""One second [ns]."""
_MAX_TEXT_BYTES = 64 << 20
APPLE_DOUBLE = "._"
"""Prefix of the files that macOS adds on disks of other systems and in archives."""


class ImageFiles(NamedTuple):
    """Rule for the names of files with one kind of data per frame; case is ignored."""

    folders: tuple[str, ...]
    """Possible names of the subfolder with the files; empty if they are in the folder itself."""
    endings: tuple[str, ...]
    """Ends of the file names. The first one that matches is not part of the frame's name."""

    def folder_of(self, file: Path) -> Path | None:
        """Return the folder of the recording with this image; None if it is not an image."""
        if not file.name.lower().endswith(self.endings):
            return None
        if not self.folders:
            return file.parent
        return file.parent.parent if file.parent.name.lower() in self.folders else None

    def paths(self, folder: Path) -> list[Path]:
        """Return the files of a recording in order of name.

        Raises:
            InputError: Several subfolders have files.
        """
        parts = [folder]
        if self.folders:
            names = [name for name in os.listdir(folder) if name.lower() in self.folders]
            parts = [folder / name for name in sorted(names) if (folder / name).is_dir()]
        if len(parts) > 1:
            problem = f"several folders of images: {', '.join(part.name for part in parts)}"
            raise InputError(problem, path=str(folder), remedy="keep one")
        return [
            part / name
            for part in parts
            for name in sorted(os.listdir(part))
            if name.lower().endswith(self.endings) and not name.startswith(APPLE_DOUBLE)
        ]

    def frame_name(self, image: Path) -> str:
        """Return the name of an image's frame, without the ending."""
        name = image.name.lower()
        end = next((end for end in self.endings if name.endswith(end)), image.suffix)
        return image.name[: len(name) - len(end)]

    def frame_key(self, image: Path) -> str:
        """Return the name of an image's frame without leading zeros, which not all files have."""
        return self.frame_name(image).lower().lstrip("0")

    def by_frame(self, folder: Path) -> dict[str, Path]:
        """Return the files of a recording by :meth:`frame_key`.

        Raises:
            InputError: Several subfolders have files.
        """
        return {self.frame_key(path): path for path in self.paths(folder)}


COLOR = ImageFiles(
    ("rgb", "color", "colour", "image"),
    (".color.png", ".color.jpg", ".color.jpeg", ".png", ".jpg", ".jpeg"),
)
DEPTH = ImageFiles(("depth",), (".depth.png", ".png"))
CONFIDENCE = ImageFiles(("confidence",), (".png",))
POSES = ImageFiles(("pose",), (".pose.txt", ".txt"))


class Image(NamedTuple):
    """An image of a recording."""

    stamp_ns: int
    """Timestamp [ns]."""
    path: Path
    """File, which may be missing."""


class Pose(NamedTuple):
    """Pose of the camera's optical frame in the world at a time."""

    stamp_ns: int
    translation: Sequence[float]
    """Translation x y z [m]."""
    quaternion: Sequence[float]
    """Unit quaternion x y z w."""

    @classmethod
    def of_matrix(cls, stamp_ns: int, T: np.ndarray) -> "Pose":
        """Return the pose of a rigid transform ``T_world_camera``, ``(4, 4)`` float64."""
        return cls(stamp_ns, T[:3, 3].tolist(), quaternions(T[:3, :3]).tolist())


class Cameras(NamedTuple):
    """Calibration of a recording; None for each part that the recording lacks."""

    color: Intrinsics | None = None
    depth: Intrinsics | None = None
    """Intrinsics of the depth images if they are not aligned to colour."""
    depth_unit_m: float | None = None


class Recording(NamedTuple):
    """Contents of a folder of images."""

    color: Sequence[Image]
    depth: Sequence[Image]
    cameras: Cameras
    poses: Sequence[Pose]
    note: str = ""
    """Warning about missing timestamps; empty if there is none."""
    is_rotated: bool = False
    """Whether the bits of depth are rotated left by three."""


def image_size(images: Sequence[Image]) -> tuple[int, int] | None:
    """Return width and height of the first existing image from its header; None without images.

    Raises:
        InputError: The image is damaged.
    """
    path = next((image.path for image in images if image.path.is_file()), None)
    if path is None:
        return None
    try:
        return compressed_size(CompressedImageMessage(0, "", "", path.read_bytes()[: 1 << 20]))
    except FrameError as error:
        raise InputError(error.problem, path=str(path), remedy="remove it") from error


def entry(folder: Path, name: str) -> Path:
    """Return the path of a file by its name in lower case, ignoring case; it may not exist."""
    return folder / next((own for own in os.listdir(folder) if own.lower() == name), name)


def read_text(path: Path) -> str:
    """Read a text file, with or without a byte order mark; invalid bytes are replaced.

    Raises:
        InputError: The file has more than 64 MiB.
    """
    if path.stat().st_size > _MAX_TEXT_BYTES:
        raise InputError("the file is too large", path=str(path), remedy="split the recording")
    return path.read_text("utf-8-sig", "replace")


def read_table(path: Path, columns: int) -> list[list[str]]:
    """Return the first ``columns`` words of each line; comments start with ``#``.

    Raises:
        InputError: A line has fewer columns.
    """
    rows = _words(path)
    for words in rows:
        if len(words) < columns:
            problem = f"expected lines of {columns} columns, got {len(words)}"
            raise InputError(problem, path=str(path), remedy="correct it")
    return [words[:columns] for words in rows]


def read_matrix(path: Path, rows: int) -> np.ndarray:
    """Read a square matrix ``(rows, rows)`` float64, whose rows may be on one line.

    Raises:
        InputError: The file does not contain such a matrix.
    """
    try:
        return np.array([*chain.from_iterable(_words(path))], np.float64).reshape(rows, rows)
    except ValueError as error:
        problem = f"expected {rows} rows of {rows} numbers"
        raise InputError(problem, path=str(path), remedy="correct it") from error


def _words(path: Path) -> list[list[str]]:
    """Return the words of each line that is not empty, without comments."""
    lines = read_text(path).replace(",", " ").splitlines()
    return [words for line in lines if (words := line.partition("#")[0].split())]


def nanoseconds(text: str, path: Path) -> int:
    """Convert a timestamp in seconds to nanoseconds, exactly.

    Raises:
        InputError: The text is not a timestamp of ROS 2; the error names ``path``.
    """
    problem = f"timestamp {text[:40]!a} is out of range"
    try:
        found = Decimal(text)
        if 0 <= found < MAX_ROS2_STAMP_S:
            return int(found * SECOND)
    except InvalidOperation:  # not a number, or NaN
        problem = f"expected a timestamp in seconds, got {text[:40]!a}"
    raise InputError(problem, path=str(path), remedy="correct it")
