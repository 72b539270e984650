"""The index of a file by a walk over all of it, for files whose own index is missing or wrong.

The walk takes in what is whole and counts what is lost. Its result is the same
:class:`jaxdet.io.file_index.FileIndex` that the file's own index gives; no message is decoded.
"""

from array import array
from collections import Counter
from typing import Any

import numpy as np

from jaxdet.io.container import LogFile
from jaxdet.io.declarations import ChannelInfo
from jaxdet.io.file_index import FileIndex, FileIntegrity, file_index


class Walk:
    """The state of a walk over a file.

    Args:
        file: The file.
    """

    def __init__(self, file: LogFile) -> None:
        self._file = file
        self.lost: Counter[str] = Counter()
        """Number of parts that could not be used, by reason."""
        self.lost_bytes = self.last_ns = 0
        self.read: Counter[int] = Counter()
        """Number of messages by channel."""
        self._infos: dict[int, ChannelInfo] = {}
        self._messages = tuple(array("q") for _ in range(5))

    def add(
        self, number: int, info: ChannelInfo, log_ns: int, position: int, length: int, offset: int
    ) -> None:
        """Add a message of the channel with this number.

        Args:
            number: Of the channel.
            info: The channel.
            log_ns: Log time [ns].
            position: Of the message's chunk.
            length: Of the chunk's content.
            offset: Of the message's record in the decompressed chunk.

        Raises:
            InputError: The file holds more messages than it has room for.
        """
        self.read[number] += 1
        self._infos.setdefault(number, info)
        values = number, log_ns, position, length, offset
        for column, value in zip(self._messages, values, strict=True):
            column.append(value)
        self._file.check_messages(len(self._messages[0]))
        self.last_ns = max(self.last_ns, log_ns)

    def lose(self, reason: str, size: int) -> None:
        """Count something that can't be used."""
        self.lost[reason] += 1
        self.lost_bytes += size

    def index(self, **more: Any) -> FileIndex:
        """Return the index of the messages found, with what was lost.

        Args:
            more: What the format tells of the file's integrity; by default the file has no chunks,
                and nothing of which it speaks is missing.

        Raises:
            InputError: The file was changed meanwhile.
        """
        self._file.check_unchanged()
        integrity = FileIntegrity(
            path=self._file.path,
            messages=len(self._messages[0]),
            lost=dict(self.lost),
            lost_bytes=self.lost_bytes,
            last_log_time_ns=self.last_ns,
            **more,
        )
        messages = np.array(self._messages, np.int64).reshape(5, -1)
        return file_index(self._infos, messages, integrity)
