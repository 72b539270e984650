"""Index of a file from its contents, if its own index is missing or wrong.

Intact messages are collected and losses are counted; no message is decoded.
"""

from array import array
from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxdet.io.container import LogFile
from jaxdet.io.declarations import ChannelInfo
from jaxdet.io.file_index import FileIndex, FileIntegrity, file_index


class Walk:
    """Messages and losses found in a file.

    Args:
        file: File.
    """

    def __init__(self, file: LogFile) -> None:
        self._file = file
        self.lost: Counter[str] = Counter()
        """Number of unusable parts by reason."""
        self._lost_bytes = self._last_ns = 0
        self.read: Counter[int] = Counter()
        """Number of messages by channel."""
        self._messages = tuple(array("q") for _ in range(5))

    def add(self, channel: int, log_ns: int, position: int, length: int, offset: int) -> None:
        """Add a message, see :class:`jaxdet.io.file_index.IndexedMessages`.

        Raises:
            InputError: The file has an impossible number of messages.
        """
        self.read[channel] += 1
        values = channel, log_ns, position, length, offset
        for column, value in zip(self._messages, values, strict=True):
            column.append(value)
        self._file.check_messages(len(self._messages[0]))
        self._last_ns = max(self._last_ns, log_ns)

    def lose(self, reason: str, size: int) -> None:
        """Count an unusable part."""
        self.lost[reason] += 1
        self._lost_bytes += size

    def index(self, infos: Mapping[int, ChannelInfo], **more: Any) -> FileIndex:
        """Return the index of the messages found, with the losses.

        Args:
            infos: Channels of the file by id.
            more: Further fields of :class:`FileIntegrity`, depending on the format.

        Raises:
            InputError: The file was changed meanwhile.
        """
        self._file.check_unchanged()
        integrity = FileIntegrity(
            path=self._file.path,
            messages=len(self._messages[0]),
            lost=dict(self.lost),
            lost_bytes=self._lost_bytes,
            last_log_time_ns=self._last_ns,
            **more,
        )
        messages = np.array(self._messages, np.int64).reshape(5, -1)
        used = {number: infos[number] for number in self.read}
        return file_index(used, messages, integrity)
