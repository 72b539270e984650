"""Folders of colour and depth images as logs, in the layouts of common data sets and of Open3D.

The basic layout is that of TUM's RGB-D benchmark and of Open3D: a folder of colour images (``rgb
color colour``: PNG, JPEG) and one of depth images (``depth``: 16-bit PNG, aligned to colour).
Timestamps [s] and names are in ``rgb.txt`` and ``depth.txt``. Without these files, names with a
decimal point are timestamps, and the last number in other names is a frame number at
:data:`RATE_HZ`. ``groundtruth.txt`` has the camera's poses (timestamp, tx ty tz, qx qy qz qw), and
a JSON file the camera matrix: ``intrinsic_matrix`` (nine numbers, column-major), ``width``,
``height`` and optionally ``depth_scale`` (depth units per metre). Other layouts:

- ScanNet has the camera matrices of both images in ``intrinsic``, and poses in ``pose``;
- 7-Scenes has all files in one folder: ``frame-000000.color.png``, ``.depth.png``, ``.pose.txt``;
- Redwood has ``image`` or ``rgb``, and microseconds in the names, ``NUMBER-TIME.png``;
- SUN3D and SUN RGB-D have the camera matrix in ``intrinsics.txt``, and depth whose bits are rotated
  left by three;
- recordings of an iPhone's LiDAR have confidences, see :mod:`jaxdet.io.phone_folder`.

Sources: "File Formats" of the TUM benchmark; Open3D's ``PinholeCameraIntrinsic`` and
``RGBDVideoMetadata``; ScanNet's ``SensReader``; SUN3D's ``SUN3Dsfm``; the web pages of 7-Scenes and
Redwood.
"""

import json
import os
import re
import struct
from collections.abc import Iterable, Mapping, Sequence
from decimal import Decimal, InvalidOperation
from io import BytesIO, RawIOBase
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxdet.errors import FrameError, InputError
from jaxdet.io.chunks import PAYLOAD_OFFSET, DamageError
from jaxdet.io.compressed import ROTATED, compressed_size, with_confidence
from jaxdet.io.container import FileState
from jaxdet.io.declarations import ChannelInfo
from jaxdet.io.definition import schema_text
from jaxdet.io.file_index import FileIndex, FileIntegrity, file_index
from jaxdet.io.message_fields import MAX_ROS2_STAMP_S
from jaxdet.io.message_file import (
    POSITION_BITS,
    MessageFile,
    MessageRow,
    indexed_messages,
    position_of,
)
from jaxdet.io.messages import CompressedImageMessage
from jaxdet.io.phone_folder import ODOMETRY, PhoneRecording, read_phone
from jaxdet.io.walk import Walk
from jaxdet.io.writer_cdr import camera_info, encode_cdr, header, pose_of
from jaxdet.types import Intrinsics, is_rigid

RATE_HZ = 30
COLOR_NAMES = ("rgb", "color", "colour", "image")
FLAT = ".color", ".depth"
"""Ends of the file names, without suffix, if colour and depth are in one folder, as in 7-Scenes."""
DEPTH_NAMES = ("depth",)
COLOR_SUFFIXES = (".png", ".jpg", ".jpeg")
DEPTH_SUFFIXES = (".png",)
SUN3D_MATRIX = "intrinsics.txt"
"""File with the camera matrix (three rows) in folders of SUN3D and SUN RGB-D."""
CONFIDENCE = "confidence"
"""Folder with a confidence PNG per depth image, with the same name."""
BESIDE = "._"
"""Prefix of the files that macOS adds on disks of other systems and in archives."""
LISTED_COLOR, LISTED_DEPTH = "rgb.txt", "depth.txt"
_SECOND = 1_000_000_000
_FIRST_S = 1
"""Timestamp of frame 0 if frames only have numbers [s], as a timestamp of 0 counts as missing."""
_MAX_TEXT_BYTES = 64 << 20
_WITH_TIME = re.compile(r"\d{7}-(\d{12})")
"""Frame number and time [us]."""
_NUMBER = re.compile(r"(\d+)\D*$")
_FRAME = "camera_color_optical_frame"
_TYPES = {
    "/camera/color/image": "sensor_msgs/CompressedImage",
    "/camera/depth_registered/image": "sensor_msgs/CompressedImage",
    "/camera/color/camera_info": "sensor_msgs/CameraInfo",
    "/camera/depth_registered/option/Depth Units/value": "std_msgs/Float32",
    "/tf": "tf2_msgs/TFMessage",
    "/camera/depth_registered/camera_info": "sensor_msgs/CameraInfo",
}
_COLOR, _DEPTH, _INFO, _UNIT, _TF, _DEPTH_INFO = range(len(_TYPES))


class _Message(NamedTuple):
    """A message, consisting of bytes followed by the contents of files."""

    log_ns: int
    channel: int
    head: bytes
    files: tuple[tuple[Path, int], ...] = ()
    """Path and size of an image and, for depth, optionally of its confidences; the size of a
    missing file is 0."""

    @property
    def size(self) -> int:
        """Total size [byte]."""
        return len(self.head) + sum(size for _, size in self.files)

    @property
    def path(self) -> Path | None:
        """Path of the image; None for other messages."""
        return self.files[0][0] if self.files else None


class ImageFolder(MessageFile):
    """A folder of colour and depth images.

    Attributes:
        infos: Channels by id.
    """

    magic = b""
    kind = "a folder of images"

    def __init__(self, path: Path, max_bytes: int, state: FileState | None = None) -> None:
        self.path, self.named, self.max_bytes = path, path, max_bytes
        try:
            self.state = state or _state(path)
            self.check_unchanged()
            self._messages = _messages(path)
        except OSError as error:
            problem = f"can't be read ({error.strerror})"
            raise InputError(problem, path=str(path), remedy="check the folder") from error
        self.size = sum(item.size for item in self._messages)
        self.infos = {
            number: ChannelInfo(topic, "cdr", name, "ros2msg", schema_text(name).encode())
            for number, (topic, name) in enumerate(_TYPES.items())
        }

    def read_index(self) -> FileIndex:
        """Build the index of the messages from the names and sizes of the files."""
        channel, log_ns, size = np.array(self._rows(), np.int64).reshape(-1, 3).T
        messages = indexed_messages(np.arange(len(channel)), channel, log_ns, size)
        return file_index(self.infos, messages, FileIntegrity(self.path, by_index=True))

    def rebuild_index(self) -> FileIndex:
        """Build the index while reading all files; an unreadable image remains a frame.

        Raises:
            InputError: The folder was changed meanwhile.
        """
        walk, rows = Walk(self), self._rows()
        for number, row in enumerate(rows):
            position, info = position_of(number), self.infos[row.channel]
            try:
                self.chunk(position)
            except DamageError as error:
                walk.lose(str(error), 0)
            walk.add(row.channel, info, row.log_ns, position, row.size + PAYLOAD_OFFSET, 0)
        return walk.index(declared_messages=len(rows))

    def _rows(self) -> list[MessageRow]:
        """Return channel, log time and size of the messages, in order of time."""
        return [self.row(number) for number in range(len(self._messages))]

    def close(self) -> None:
        """Do nothing, since image files are opened only while they are read."""

    def check_unchanged(self) -> None:
        """Check that no image was added, removed or renamed since the folder was opened.

        Raises:
            InputError: The folder has changed, or no longer exists.
        """
        try:
            now = _state(self.path)
        except OSError:
            now = None
        if now != self.state:
            problem, remedy = (
                "the folder was changed while it was read",
                "run again once it is complete",
            )
            raise InputError(problem, path=str(self.path), remedy=remedy)

    def row(self, number: int) -> MessageRow:
        """Return channel, log time and size of a message.

        Raises:
            DamageError: The message does not exist.
        """
        if not 0 <= number < len(self._messages):
            raise DamageError("no message at the expected position")
        item = self._messages[number]
        return MessageRow(item.channel, item.log_ns, item.size)

    def name_of(self, position: int) -> str:
        """Return the path of an image relative to the folder; empty for other messages."""
        path = self._messages[position >> POSITION_BITS].path
        return "" if path is None else os.path.relpath(path, self.path)

    def read_payload(self, number: int, start: int, parts: Sequence[memoryview]) -> None:
        """Fill writable byte views one after the other with a message's data from ``start`` on.

        Raises:
            DamageError: The data end earlier, or can't be read.
        """
        item, left = self._messages[number], list(parts)
        head = BytesIO(item.head)
        head.seek(start)
        left = _fill(head, len(item.head) - start, left)
        start = max(0, start - len(item.head))
        for path, size in item.files:
            if left and (start < size or not size):
                left = self._read_file(path, start, size, left)
            start = max(0, start - size)
        if left:
            raise DamageError("message ends early")

    def _read_file(
        self, path: Path, start: int, size: int, parts: list[memoryview]
    ) -> list[memoryview]:
        """Fill views with the contents of a file from ``start`` on; return the unfilled rest.

        Raises:
            DamageError: The file is missing, ends early, or can't be read.
        """
        name = os.path.relpath(path, self.path)
        try:
            with path.open("rb", buffering=0) as file:
                file.seek(start)
                left = _fill(file, size - start, parts)
        except OSError as error:
            raise DamageError(f"{name} can't be read ({error.strerror})") from error
        except EOFError as error:
            raise DamageError(f"{name} ends early") from error
        if not size:
            raise DamageError(f"{name} ends early")
        return left


def _fill(file: RawIOBase | BytesIO, size: int, parts: list[memoryview]) -> list[memoryview]:
    """Fill views with the next bytes of a file, at most ``size``; return the unfilled rest.

    Raises:
        EOFError: The file has fewer bytes.
    """
    left = []
    for part in parts:
        piece = part[: max(0, size)]
        if len(piece) and file.readinto(piece) != len(piece):
            raise EOFError
        size -= len(piece)
        left += [part[len(piece) :]] if len(piece) < len(part) else []
    return left


def image_folders(files: Iterable[Path]) -> list[Path]:
    """Return the folders that contain both colour and depth images, in order."""
    found: dict[Path, set[bool]] = {}
    for file in files:
        name, suffix = file.parent.name.lower(), file.suffix.lower()
        if name in DEPTH_NAMES and suffix in DEPTH_SUFFIXES:
            found.setdefault(file.parent.parent, set()).add(True)
        elif name in COLOR_NAMES and suffix in COLOR_SUFFIXES:
            found.setdefault(file.parent.parent, set()).add(False)
        elif file.name == ODOMETRY:  # file of Stray Scanner, whose colour is video
            found.setdefault(file.parent, set()).add(False)
        elif suffix in COLOR_SUFFIXES and Path(file.stem).suffix in FLAT:
            found.setdefault(file.parent, set()).add(Path(file.stem).suffix == FLAT[1])
    return sorted(folder for folder, kinds in found.items() if len(kinds) == 2)


def stamp_note(folder: Path) -> str:
    """Return a note if the images of a folder have no recorded timestamps, else an empty string.

    Nothing is reported for a folder that can't be opened, as opening it raises the error.
    """
    if (folder / LISTED_COLOR).exists() and (folder / LISTED_DEPTH).exists():
        return ""
    try:
        if read_phone(folder):
            return ""
        names = [path.stem for path in _images(folder, COLOR_NAMES, COLOR_SUFFIXES)]
    except (InputError, OSError):
        return ""
    if all("." in name or _WITH_TIME.fullmatch(name) for name in names) and names:
        return ""
    return f"{folder.name} has no timestamps; {RATE_HZ} frames per second are assumed"


def _messages(folder: Path) -> list[_Message]:
    """Return the messages of a folder in order of time."""
    phone = read_phone(folder)
    found = [
        *_image_messages(folder, _COLOR, LISTED_COLOR, COLOR_NAMES, COLOR_SUFFIXES, phone),
        *_image_messages(folder, _DEPTH, LISTED_DEPTH, DEPTH_NAMES, DEPTH_SUFFIXES, phone),
    ]
    first = min((item.log_ns for item in found), default=0)
    if phone:
        found += _of_phone(phone, found, first)
        return sorted(found, key=lambda item: item[:2])
    found += _calibration(folder, first)
    found += _poses(folder)
    found += _matrix_poses(folder, [item for item in found if item.channel == _DEPTH])
    return sorted(found, key=lambda item: item[:2])


def _of_phone(phone: PhoneRecording, images: Sequence[_Message], first: int) -> list[_Message]:
    """Return the calibrations of both images, with the size of their first image, and the poses."""
    found = []
    for kind, channel in ((_COLOR, _INFO), (_DEPTH, _DEPTH_INFO)):
        path = next((item.path for item in images if item.channel == kind), None)
        if path is not None:
            info = camera_info(first, _FRAME, phone.camera(_image_size(path)))
            found.append(_Message(first, channel, encode_cdr("sensor_msgs/CameraInfo", info)))
    known = {number: phone.stamps_ns[number] for number in phone.poses}
    return found + [_pose(stamp, phone.poses[number]) for number, stamp in known.items()]


def _image_messages(
    folder: Path,
    channel: int,
    listed: str,
    names: Sequence[str],
    suffixes: Sequence[str],
    phone: PhoneRecording | None,
) -> list[_Message]:
    if (folder / listed).exists():
        lines = _table(folder / listed, 2)
        images = [(_nanoseconds(stamp, folder / listed), folder / name) for stamp, name in lines]
    else:
        paths = _images(folder, names, suffixes)
        dots = bool(paths) and all("." in _frame_name(path) for path in paths)
        images = [(_stamp_of(path, dots, phone), path) for path in paths]
    has_mask = channel == _DEPTH and (folder / CONFIDENCE).is_dir()
    found = []
    for stamp_ns, path in images:
        paths = (path, folder / CONFIDENCE / path.name) if has_mask else (path,)
        files = tuple((one, one.stat().st_size if one.is_file() else 0) for one in paths)
        form = "16UC1; png" if channel == _DEPTH else "png"
        form += with_confidence(files[0][1]) if has_mask else ""
        form += ROTATED if channel == _DEPTH and (folder / SUN3D_MATRIX).is_file() else ""
        message = {"header": header(stamp_ns, _FRAME), "format": form, "data": b""}
        head = encode_cdr("sensor_msgs/CompressedImage", message)
        head = head[:-4] + sum(size for _, size in files).to_bytes(4, "little")
        found.append(_Message(stamp_ns, channel, head, files))
    return found


def _frame_name(path: Path) -> str:
    """Return the name of an image's frame, without suffix and image type."""
    stem = Path(path.stem)
    return stem.stem if stem.suffix in FLAT else path.stem


def _images(folder: Path, names: Sequence[str], suffixes: Sequence[str]) -> list[Path]:
    end = FLAT[names is DEPTH_NAMES]
    flat = sorted(
        path
        for path in folder.iterdir()
        if path.suffix.lower() in suffixes and Path(path.stem).suffix == end
    )
    if flat:
        return flat
    parts = sorted(part for part in folder.iterdir() if part.name.lower() in names)
    if len(parts) > 1:
        listed = ", ".join(part.name for part in parts)
        raise InputError(
            f"several folders of images: {listed}", path=str(folder), remedy="keep one"
        )
    files = (path for part in parts for path in part.iterdir())
    files = (path for path in files if not path.name.startswith(BESIDE))
    return sorted(path for path in files if path.suffix.lower() in suffixes)


def _stamp_of(path: Path, is_stamp: bool, phone: PhoneRecording | None) -> int:
    """Return the timestamp in the name of an image [ns]."""
    name = _frame_name(path)
    if phone:
        if not name.isdecimal() or int(name[-9:]) not in phone.stamps_ns:
            problem = "the recording has no timestamp of this frame"
            raise InputError(problem, path=str(path), remedy="remove the image")
        return phone.stamps_ns[int(name[-9:])]
    if is_stamp:
        return _nanoseconds(name, path)
    if timed := _WITH_TIME.fullmatch(name):
        return _FIRST_S * _SECOND + int(timed[1]) * 1000
    match = _NUMBER.search(name)
    if match is None or len(match[1]) > 9:
        problem = "the name has neither a timestamp in seconds nor a frame number"
        raise InputError(problem, path=str(path), remedy="number the images, or write rgb.txt")
    return _FIRST_S * _SECOND + int(match[1]) * _SECOND // RATE_HZ


def _calibration(folder: Path, log_ns: int) -> list[_Message]:
    """Return calibration and depth unit of the camera, from a JSON file or ScanNet's folder."""
    if (folder / SUN3D_MATRIX).is_file():
        files = {_INFO: (folder / SUN3D_MATRIX, COLOR_NAMES, COLOR_SUFFIXES)}
        return _matrix_calibrations(folder, log_ns, files, 3)
    if (part := folder / "intrinsic").is_dir():
        color = part / "intrinsic_color.txt", COLOR_NAMES, COLOR_SUFFIXES
        depth = part / "intrinsic_depth.txt", DEPTH_NAMES, DEPTH_SUFFIXES
        return _matrix_calibrations(folder, log_ns, {_INFO: color, _DEPTH_INFO: depth}, 4)
    found = [(path, value) for path in sorted(folder.glob("*.json")) if (value := _camera(path))]
    if not found:
        return []
    if len(found) > 1:
        names = ", ".join(path.name for path, _ in found)
        raise InputError(f"several calibrations: {names}", path=str(folder), remedy="keep one")
    path, camera = found[0]
    try:
        fx, _, lower, _, fy, row, cx, cy, one = (float(item) for item in camera["intrinsic_matrix"])
        if (lower, row, one) != (0, 0, 1):
            raise ValueError("not column-major")
        width, height = int(camera["width"]), int(camera["height"])
        scale = float(camera.get("depth_scale", 1000))
        info = camera_info(log_ns, _FRAME, Intrinsics(width, height, fx, fy, cx, cy))
        unit = encode_cdr("std_msgs/Float32", {"data": 1 / scale})
        head = encode_cdr("sensor_msgs/CameraInfo", info)
    except (ArithmeticError, KeyError, TypeError, ValueError, struct.error) as error:
        problem = f"the calibration can't be read ({type(error).__name__}: {error})"
        remedy = "it must have intrinsic_matrix (nine numbers, column-major), width and height"
        raise InputError(problem, path=str(path), remedy=remedy) from error
    return [_Message(log_ns, _INFO, head), _Message(log_ns, _UNIT, unit)]


def _matrix_calibrations(
    folder: Path,
    log_ns: int,
    files: Mapping[int, tuple[Path, Sequence[str], Sequence[str]]],
    rows: int,
) -> list[_Message]:
    """Return calibrations from files with a matrix, each with the size of its first image.

    Args:
        folder: Folder of images.
        log_ns: Log time of the messages [ns].
        files: File of the matrix, and names and suffixes of the images, by channel.
        rows: Number of rows and columns of the matrices.
    """
    found = []
    for channel, (path, names, suffixes) in files.items():
        images = _images(folder, names, suffixes)
        if not path.is_file() or not images:
            continue
        K, (width, height) = _matrix(path, rows), _image_size(images[0])
        camera = Intrinsics(width, height, K[0, 0], K[1, 1], K[0, 2], K[1, 2])
        head = encode_cdr("sensor_msgs/CameraInfo", camera_info(log_ns, _FRAME, camera))
        found.append(_Message(log_ns, channel, head))
    return found


def _image_size(path: Path) -> tuple[int, int]:
    """Return width and height of an image from its header.

    Raises:
        InputError: The image is damaged.
    """
    message = CompressedImageMessage(0, "", "", path.read_bytes()[: 1 << 20])
    try:
        return compressed_size(message)
    except FrameError as error:
        raise InputError(error.problem, path=str(path), remedy="remove it") from error


def _matrix(path: Path, rows: int) -> np.ndarray:
    """Read a square matrix from a text file."""
    try:
        return np.array(_table(path, rows), np.float64).reshape(rows, rows)
    except ValueError as error:
        problem = f"expected {rows} rows of {rows} numbers"
        raise InputError(problem, path=str(path), remedy="correct it") from error


def _matrix_poses(folder: Path, images: Sequence[_Message]) -> list[_Message]:
    """Return the valid poses of ScanNet and 7-Scenes, from one file per depth image."""
    found = []
    for item in images:
        if item.path is None:
            continue
        name = _frame_name(item.path)
        near = [folder / "pose" / f"{name}.txt", item.path.with_name(f"{name}.pose.txt")]
        path = next((one for one in near if one.is_file()), None)
        T = _matrix(path, 4) if path else np.full((4, 4), np.nan)
        if is_rigid(T):
            found.append(_pose(item.log_ns, T))
    return found


def _pose(stamp_ns: int, T: np.ndarray) -> _Message:
    pose = pose_of(T)
    return _transform(stamp_ns, {"translation": pose["position"], "rotation": pose["orientation"]})


def _transform(stamp_ns: int, motion: dict[str, Any]) -> _Message:
    head = header(stamp_ns, "map")
    item = {"header": head, "child_frame_id": _FRAME, "transform": motion}
    data = encode_cdr("tf2_msgs/TFMessage", {"transforms": [item]})
    return _Message(stamp_ns, _TF, data)


def _camera(path: Path) -> dict[str, Any] | None:
    """Return the camera in a JSON file; None if the file is about something else."""
    if path.stat().st_size > 1 << 20:
        return None
    try:
        found = json.loads(path.read_bytes())
    except (ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) and "intrinsic_matrix" in found else None


def _poses(folder: Path) -> list[_Message]:
    """Return the poses of the camera in the world."""
    path, found = folder / "groundtruth.txt", []
    if not path.exists():
        return []
    for stamp, *numbers in _table(path, 8):
        stamp_ns = _nanoseconds(stamp, path)
        try:
            tx, ty, tz, qx, qy, qz, qw = map(float, numbers)
        except ValueError as error:
            raise InputError(
                "a pose is not numeric", path=str(path), remedy="correct it"
            ) from error
        motion = {
            "translation": {"x": tx, "y": ty, "z": tz},
            "rotation": {"x": qx, "y": qy, "z": qz, "w": qw},
        }
        found.append(_transform(stamp_ns, motion))
    return found


def _table(path: Path, columns: int) -> list[list[str]]:
    """Return the lines of a text file, split into words; comments start with ``#``."""
    if path.stat().st_size > _MAX_TEXT_BYTES:
        raise InputError("the file is too large", path=str(path), remedy="split the recording")
    lines = path.read_text("utf-8", "replace").replace(",", " ").splitlines()
    rows = [words for line in lines if (words := line.partition("#")[0].split())]
    for words in rows:
        if len(words) < columns:
            problem = f"expected lines of {columns} columns, got {len(words)}"
            raise InputError(problem, path=str(path), remedy="correct it")
    return [words[:columns] for words in rows]


def _nanoseconds(text: str, path: Path) -> int:
    """Convert a timestamp in seconds to nanoseconds, exactly."""
    try:
        found = Decimal(text)
        in_range = 0 <= found < MAX_ROS2_STAMP_S
    except InvalidOperation as error:  # not a number, or NaN
        problem = f"expected a timestamp in seconds, got {text[:40]!a}"
        raise InputError(problem, path=str(path), remedy="correct it") from error
    if not in_range:
        problem = f"timestamp {text[:40]!a} is out of range"
        raise InputError(problem, path=str(path), remedy="correct it")
    return int(found * _SECOND)


def _state(folder: Path) -> FileState:
    """Return the state of a folder, with the latest modification of it and its subfolders."""
    about = os.stat(folder)
    parts = [os.stat(part) for part in sorted(folder.iterdir()) if part.is_dir()]
    latest = max(item.st_mtime_ns for item in (about, *parts))
    return FileState(about.st_dev, about.st_ino, about.st_size, latest)
