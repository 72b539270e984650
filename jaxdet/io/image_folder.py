"""Folders of colour and depth images as logs, in the layouts of :mod:`jaxdet.io.folders`."""

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from jaxdet.errors import InputError
from jaxdet.io.chunks import DamageError
from jaxdet.io.container import FileState
from jaxdet.io.declarations import ChannelInfo
from jaxdet.io.definition import schema_text
from jaxdet.io.file_index import FileIndex, FileIntegrity, file_index
from jaxdet.io.folders.basic import RATE_HZ
from jaxdet.io.folders.layouts import read_recording
from jaxdet.io.folders.messages import TOPICS, encode_recording
from jaxdet.io.message_file import POSITION_BITS, MessageFile, MessageRow, indexed_messages


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
        rows = [self.row(number) for number in range(len(self._messages))]
        channel, log_ns, size = np.array(rows, np.int64).reshape(-1, 3).T
        messages = indexed_messages(np.arange(len(channel)), channel, log_ns, size)
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
        path = self._messages[position >> POSITION_BITS].path
        return "" if path is None else os.path.relpath(path, self.path)

    def read_payload(self, number: int, start: int, parts: Sequence[memoryview]) -> None:
        """Fill writable byte views one after the other with a message's data from ``start`` on.

        Raises:
            DamageError: The data end earlier, or can't be read.
        """
        message = self._messages[number]
        for part in parts:
            left, begin = part, start
            for source, size in ((message.head, len(message.head)), *message.files):
                piece = left[: max(0, size - begin)]
                if len(left) and (len(piece) or not size):
                    self._read(source, begin, piece)
                left, begin = left[len(piece) :], max(0, begin - size)
            if len(left):
                raise DamageError("message ends early")
            start += len(part)

    def _read(self, source: bytes | Path, start: int, piece: memoryview) -> None:
        """Fill a byte view with bytes, or the contents of a file, from ``start`` on.

        Raises:
            DamageError: The file is missing, ends early, or can't be read.
        """
        if isinstance(source, bytes):
            piece[:] = source[start : start + len(piece)]
            return
        name = os.path.relpath(source, self.path)
        try:
            with source.open("rb", buffering=0) as file:
                file.seek(start)
                if not len(piece) or file.readinto(piece) != len(piece):
                    raise DamageError(f"{name} ends early")
        except OSError as error:
            raise DamageError(f"{name} can't be read ({error.strerror})") from error


def _state(folder: Path) -> FileState:
    """Return the state of a folder, with the latest modification of it and its subfolders."""
    about = os.stat(folder)
    parts = [os.stat(part) for part in sorted(folder.iterdir()) if part.is_dir()]
    latest = max(item.st_mtime_ns for item in (about, *parts))
    return FileState(about.st_dev, about.st_ino, about.st_size, latest)
