"""What every walk over a whole file does: it gives what is whole, and counts what is lost.

Chunks ahead are decompressed on threads; all is taken in by the caller's, in order.
"""

from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, NamedTuple

from mcap.opcode import Opcode

from jaxdet.io.chunks import DamageError
from jaxdet.io.container import Location, LogFile
from jaxdet.io.declarations import ChannelInfo
from jaxdet.io.integrity import FileIntegrity

Handler = Callable[[ChannelInfo, int, memoryview, Location], None]
"""Gets channel, log time [ns], payload and location of each message."""
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
        handler: Called for each message that is whole, in the order in which they are found.
    """

    def __init__(self, file: LogFile, handler: Handler) -> None:
        self._file, self._handler = file, handler
        self.lost: Counter[str] = Counter()
        """What could not be used, by reason."""
        self.lost_bytes = self.messages = self.last_ns = 0
        self.read: Counter[int] = Counter()
        """Messages, by the number of their channel."""

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

    def give(
        self, number: int, info: ChannelInfo, log_ns: int, payload: memoryview, where: Location
    ) -> None:
        """Gives a message of the channel with this number to the handler.

        Raises:
            InputError: The file holds more messages than it has room for.
        """
        self.messages += 1
        self.read[number] += 1
        self._file.check_messages(self.messages)
        self.last_ns = max(self.last_ns, log_ns)
        self._handler(info, log_ns, payload, where)

    def lose(self, reason: str, size: int) -> None:
        """Counts something that can't be used."""
        self.lost[reason] += 1
        self.lost_bytes += size

    def integrity(self, **more: Any) -> FileIntegrity:
        """What was found and lost.

        Args:
            more: What the format tells beside that; by default the file has no chunks, and nothing
                of which it speaks is missing.

        Raises:
            InputError: The file was changed meanwhile.
        """
        self._file.check_unchanged()
        return FileIntegrity(
            path=self._file.path,
            messages=self.messages,
            lost=dict(self.lost),
            lost_bytes=self.lost_bytes,
            last_log_time_ns=self.last_ns,
            **more,
        )


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
