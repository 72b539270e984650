"""The records of an MCAP file with the chunks ahead being decompressed on threads."""

from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import NamedTuple

from mcap.opcode import Opcode

from jaxdet.io.container import LogFile

AHEAD_BYTES = 64 << 20
"""Of decompressed chunks."""
AHEAD_RECORDS = 256


class FileRecord(NamedTuple):
    """A record of a file's data section."""

    opcode: int
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
