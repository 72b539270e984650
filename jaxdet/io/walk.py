"""The index of a file by a walk over all of it, for files whose own index is missing or wrong.

The walk takes in what is whole and counts what is lost. Its result is the same
:class:`jaxdet.io.file_index.FileIndex` that the file's own index gives; no message is decoded.
Chunks ahead are decompressed on threads; all is taken in by the caller's, in order.
"""

from array import array
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
from mcap.opcode import Opcode

from jaxdet.io.chunks import DamageError
from jaxdet.io.container import LogFile
from jaxdet.io.declarations import ChannelInfo
from jaxdet.io.file_index import FileIndex, file_index
from jaxdet.io.integrity import FileIntegrity

AHEAD_BYTES = 64 << 20
"""Of decompressed chunks."""
AHEAD_RECORDS = 256
TORN = 0
"""Opcode, which no record has."""


class FileRecord(NamedTuple):
    """A record of a file's data section."""

    opcode: int
    """``TORN``: what can't be walked over."""
    position: int
    """Where its content begins in the file."""
    length: int
    """Of its content, by its own word."""


class Ahead(NamedTuple):
    """A record that is to be taken in."""

    record: FileRecord
    chunk: Future[bytes | memoryview] | None = None
    """What a chunk will be decompressed."""
    size: int = 0
    """Of that."""


class Walk:
    """The state of a walk over a file.

    Args:
        file: The file.
    """

    def __init__(self, file: LogFile) -> None:
        self._file = file
        self.lost: Counter[str] = Counter()
        """What could not be used, by reason."""
        self.lost_bytes = self.last_ns = 0
        self.read: Counter[int] = Counter()
        """Messages, by the number of their channel."""
        self._infos: dict[int, ChannelInfo] = {}
        self._messages = tuple(array("q") for _ in range(5))

    def over(
        self,
        records: Iterable[FileRecord],
        take: Callable[[FileRecord, Future[bytes | memoryview] | None], None],
        pool: ThreadPoolExecutor,
    ) -> None:
        """Takes in records, chunks decompressed; those that are damaged are lost.

        Args:
            records: Of the file, in order.
            take: Takes in one; raises a DamageError where it can't be used.
            pool: Decompresses chunks, up to 64 MiB of them ahead (or one chunk, if larger).

        Raises:
            InputError: The file holds more messages than it has room for.
        """
        for item in ahead(self._file, records, pool):
            try:
                if item.record.opcode == TORN:
                    raise DamageError("damaged or torn record")
                take(item.record, item.chunk)
            except DamageError as error:
                self.lose(str(error), item.record.length)
            del item  # and its chunk, before the next is decompressed

    def add(
        self, number: int, info: ChannelInfo, log_ns: int, position: int, length: int, offset: int
    ) -> None:
        """Adds a message of the channel with this number.

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
        """Counts something that can't be used."""
        self.lost[reason] += 1
        self.lost_bytes += size

    def index(self, **more: Any) -> FileIndex:
        """The index of the messages found, with what was lost.

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


def ahead(
    file: LogFile, records: Iterable[FileRecord], pool: ThreadPoolExecutor
) -> Iterator[Ahead]:
    """The records in order; up to 64 MiB of chunks (or one chunk, if larger) are ahead.

    Args:
        file: The file.
        records: Its records.
        pool: Decompresses.
    """
    waiting: deque[Ahead] = deque()
    size_ahead, most = 0, min(AHEAD_BYTES, file.memory.chunk)
    for record in records:
        is_chunk = record.opcode == Opcode.CHUNK
        size = file.chunk_bytes(record.position) if is_chunk else 0
        while waiting and (size_ahead + size > most or len(waiting) >= AHEAD_RECORDS):
            size_ahead -= waiting[0].size
            yield waiting.popleft()
        if is_chunk:
            waiting.append(Ahead(record, pool.submit(file.chunk, record.position), size))
            size_ahead += size
        elif waiting:
            waiting.append(Ahead(record))
        else:
            yield Ahead(record)
    while waiting:
        yield waiting.popleft()
