"""Folders of colour and depth images as logs of ROS 2 messages (CDR).

The layouts of the folders are in :mod:`jaxdet.io.folders`.
"""

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxdet.errors import InputError
from jaxdet.io.chunks import DamageError
from jaxdet.io.compressed import ROTATED, with_confidence
from jaxdet.io.container import FileState, MessageFile, MessageRow, Source, unreadable
from jaxdet.io.declarations import ChannelInfo
from jaxdet.io.definition import schema_text
from jaxdet.io.file_index import FileIndex, FileIntegrity, file_index
from jaxdet.io.folders.layouts import read_recording
from jaxdet.io.folders.recording import CONFIDENCE, DEPTH, Pose, Recording
from jaxdet.io.writer_cdr import camera_info, encode_cdr, header, xyz

_TOPICS = {
    "/camera/color/image": "sensor_msgs/CompressedImage",
    "/camera/depth_registered/image": "sensor_msgs/CompressedImage",
    "/camera/color/camera_info": "sensor_msgs/CameraInfo",
    "/camera/depth_registered/option/Depth Units/value": "std_msgs/Float32",
    "/tf": "tf2_msgs/TFMessage",
    "/camera/depth_registered/camera_info": "sensor_msgs/CameraInfo",
}
"""Types by topic; the channel of a topic is its number in this order."""
_TYPES = tuple(_TOPICS.values())
_COLOR, _DEPTH, _INFO, _UNIT, _TF, _DEPTH_INFO = range(len(_TOPICS))
_FRAME = "camera_color_optical_frame"


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
    """A folder of colour and depth images."""

    def __init__(self, path: Path, max_bytes: int, source: Source | None = None) -> None:
        self.path, self.max_bytes = path, max_bytes
        try:
            self.state = (source and source.state) or _state(path)
            self.source = Source(path, state=self.state)
            self.check_unchanged()
            recording = read_recording(path)
            self._messages = _encode(path, recording)
        except OSError as error:
            raise unreadable(error, path) from error
        self.note = recording.note
        self.size = sum(item.size for item in self._messages)

    def read_index(self) -> FileIndex:
        """Build the index of the messages from the names and sizes of the files."""
        rows = [(item.channel, item.log_ns, n, 0) for n, item in enumerate(self._messages)]
        messages = np.array(rows, np.int64).reshape(-1, 4).T
        used = {item.channel for item in self._messages}
        infos = {
            number: ChannelInfo(topic, "cdr", name, "ros2msg", schema_text(name).encode())
            for number, (topic, name) in enumerate(_TOPICS.items())
            if number in used
        }
        return file_index(infos, messages, FileIntegrity(self.path, by_index=True))

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
            problem = "the folder was changed while it was read"
            remedy = "run again once it is complete"
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
        path = self._messages[position].path
        return "" if path is None else os.path.relpath(path, self.path)

    def payload(self, number: int, most: int) -> bytes:
        """Return the first bytes of a message, see :meth:`MessageFile.payload`."""
        message = self._messages[number]
        found = message.head
        for path, size in message.files:
            if len(found) < most:
                found += self._read(path, min(size, most - len(found)))
        return found[:most]

    def _read(self, path: Path, size: int) -> bytes:
        """Return the contents of a file that had this size when the folder was opened.

        Raises:
            DamageError: The file is missing, ends early, or can't be read.
        """
        name = os.path.relpath(path, self.path)
        try:
            with path.open("rb", buffering=0) as file:
                found = file.read(size)
        except OSError as error:
            raise DamageError(f"{name} can't be read ({error.strerror})") from error
        if not size or len(found) != size:
            raise DamageError(f"{name} ends early")
        return found


def _state(folder: Path) -> FileState:
    """Return the state of a folder, with the latest change of the folder or its subfolders."""
    about = os.stat(folder)
    with os.scandir(folder) as entries:
        parts = [os.stat(part) for part in entries if part.is_dir()]
    latest = max(item.st_mtime_ns for item in (about, *parts))
    return FileState(about.st_dev, about.st_ino, about.st_size, latest)


def _encode(folder: Path, recording: Recording) -> list[_Message]:
    """Return the messages of a folder in order of time.

    Raises:
        OSError: A file can't be read.
    """
    found = [_image(_COLOR, "png", image.stamp_ns, image.path) for image in recording.color]
    confidences = CONFIDENCE.by_frame(folder)
    for stamp_ns, path in recording.depth:
        missing = folder / "confidence" / path.name
        masks = [confidences.get(DEPTH.frame_key(path), missing)] if confidences else []
        form = "16UC1; png" + (with_confidence(_size(path)) if masks else "")
        form += ROTATED if recording.is_rotated else ""
        found.append(_image(_DEPTH, form, stamp_ns, path, *masks))
    first_ns = min((message.log_ns for message in found), default=0)
    found += _cameras(recording, first_ns)
    found += [_transform(pose) for pose in recording.poses]
    return sorted(found, key=lambda message: message[:2])


def _image(channel: int, form: str, stamp_ns: int, *paths: Path) -> _Message:
    """Return the message with the contents of files as data, and with ``form`` as ``format``."""
    files = tuple((path, _size(path)) for path in paths)
    about = {"header": header(stamp_ns, _FRAME), "format": form, "data": b""}
    head = encode_cdr(_TYPES[channel], about)
    head = head[:-4] + sum(size for _, size in files).to_bytes(4, "little")
    return _Message(stamp_ns, channel, head, files)


def _size(path: Path) -> int:
    return path.stat().st_size if path.is_file() else 0


def _cameras(recording: Recording, log_ns: int) -> Iterator[_Message]:
    """Yield the messages of calibration and depth unit."""
    color, depth, unit_m = recording.cameras
    for channel, camera in ((_INFO, color), (_DEPTH_INFO, depth)):
        if camera is not None:
            yield _message(log_ns, channel, camera_info(log_ns, _FRAME, camera))
    if unit_m is not None:
        yield _message(log_ns, _UNIT, {"data": unit_m})


def _transform(pose: Pose) -> _Message:
    rotation = dict(zip("xyzw", pose.quaternion, strict=True))
    transform = {
        "header": header(pose.stamp_ns, "map"),
        "child_frame_id": _FRAME,
        "transform": {"translation": xyz(pose.translation), "rotation": rotation},
    }
    return _message(pose.stamp_ns, _TF, {"transforms": [transform]})


def _message(log_ns: int, channel: int, content: Mapping[str, Any]) -> _Message:
    return _Message(log_ns, channel, encode_cdr(_TYPES[channel], content))
