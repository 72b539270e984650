"""Folders of colour and depth images as logs, in the layouts of :mod:`jaxdet.io.folders`."""

import os
from pathlib import Path

import numpy as np

from jaxdet.errors import InputError
from jaxdet.io.chunks import DamageError
from jaxdet.io.container import FileState, MessageFile, MessageRow
from jaxdet.io.declarations import ChannelInfo
from jaxdet.io.definition import schema_text
from jaxdet.io.file_index import FileIndex, FileIntegrity, file_index
from jaxdet.io.folders.basic import RATE_HZ
from jaxdet.io.folders.layouts import read_recording
from jaxdet.io.folders.messages import TOPICS, encode_recording


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
            recording = read_recording(path)
            self._messages = encode_recording(path, recording)
        except OSError as error:
            problem = f"can't be read ({error.strerror})"
            raise InputError(problem, path=str(path), remedy="check the folder") from error
        if not recording.has_stamps:
            name = path.absolute().name
            self.note = f"{name} has no timestamps; {RATE_HZ} frames per second are assumed"
        self.size = sum(item.size for item in self._messages)
        self.infos = {
            number: ChannelInfo(topic, "cdr", name, "ros2msg", schema_text(name).encode())
            for number, (topic, name) in enumerate(TOPICS.items())
        }

    def read_index(self) -> FileIndex:
        """Build the index of the messages from the names and sizes of the files."""
        rows = [(item.channel, item.log_ns, n, 0) for n, item in enumerate(self._messages)]
        messages = np.array(rows, np.int64).reshape(-1, 4).T
        return file_index(self.infos, messages, FileIntegrity(self.path, by_index=True))

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
    """Return the state of a folder, with the latest modification of it and its subfolders."""
    about = os.stat(folder)
    parts = [os.stat(part) for part in sorted(folder.iterdir()) if part.is_dir()]
    latest = max(item.st_mtime_ns for item in (about, *parts))
    return FileState(about.st_dev, about.st_ino, about.st_size, latest)
