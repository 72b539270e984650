"""Index of a file from a scan of the complete file, if its own index is missing or wrong.

The scan collects intact messages and counts losses. Its result is a
:class:`jaxdet.io.file_index.FileIndex` like that from the file's own index; no message is decoded.
"""

from array import array
from collections import Counter
from typing import Any

import numpy as np

from jaxdet.io.container import LogFile
from jaxdet.io.declarations import ChannelInfo
from jaxdet.io.file_index import FileIndex, FileIntegrity, file_index


class Walk:
    """State of a scan of a file.

    Args:
        file: File.
    """

    def __init__(self, file: LogFile) -> None:
        self._file = file
        self.lost: Counter[str] = Counter()
        """Number of unusable parts by reason."""
        self.lost_bytes = self.last_ns = 0
        self.read: Counter[int] = Counter()
        """Number of messages by channel."""
        self._infos: dict[int, ChannelInfo] = {}
        self._messages = tuple(array("q") for _ in range(5))

    def add(
        self, number: int, info: ChannelInfo, log_ns: int, position: int, length: int, offset: int
    ) -> None:
        """Add a message.

        Args:
            number: Id of the channel.
            info: Channel.
            log_ns: Log time [ns].
            position: Position of the message's chunk [byte].
            length: Length of the chunk's content [byte].
            offset: Offset of the message's record in the decompressed chunk [byte].

        Raises:
            InputError: The file has an impossible number of messages.
        """
        self.read[number] += 1
        self._infos.setdefault(number, info)
        values = number, log_ns, position, length, offset
        for column, value in zip(self._messages, values, strict=True):
            column.append(value)
        self._file.check_messages(len(self._messages[0]))
        self.last_ns = max(self.last_ns, log_ns)

    def lose(self, reason: str, size: int) -> None:
        """Count an unusable part."""
        self.lost[reason] += 1
        self.lost_bytes += size

    def index(self, **more: Any) -> FileIndex:
        """Return the index of the messages found, with the losses.

        Args:
            more: Further fields of :class:`FileIntegrity`, depending on the format.

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
