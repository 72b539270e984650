"""Index of an MCAP file from a scan of the complete file, tolerant of damage.

The file is read from the first record to the last, in whole chunks; following chunks are
decompressed in threads ahead of time. Damaged parts are dropped and counted, and their neighbours
are used: a chunk with a wrong CRC, a message longer than its chunk, a truncated end. The summary is
optional. If the length of a record is damaged, the scan continues at the next chunk listed in the
summary. Chunks and messages that the summary or the message indexes list, but the scan did not
find, are reported as lost.
"""

import struct
from bisect import bisect_right
from collections import Counter, deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from mcap.opcode import Opcode

from jaxdet.cores import cores
from jaxdet.io.chunks import (
    MAGIC,
    MAX_TIME_NS,
    MESSAGE_HEAD,
    RECORD_HEAD,
    ChunkHead,
    DamageError,
    chunk_records,
)
from jaxdet.io.container import LogFile
from jaxdet.io.declarations import ChannelInfo, Declarations
from jaxdet.io.file_index import FileIndex
from jaxdet.io.limits import MAX_ODD_RECORDS
from jaxdet.io.mcap_index import Summary, read_summary
from jaxdet.io.walk import Walk

_INDEX_HEAD = struct.Struct("<HI")
"""Channel and size of the entries of a message index."""
_ENTRY_BYTES = 16
_ODD_BYTES = 64
"""Size below which records of unknown types count as odd, see ``MAX_ODD_RECORDS``."""


AHEAD_BYTES = 64 << 20
"""Maximum total size of chunks decompressed ahead of time."""
AHEAD_RECORDS = 256
TORN = 0
"""Opcode for parts of the file that are not records."""


class FileRecord(NamedTuple):
    """A record in the data section of a file."""

    opcode: int
    """Opcode, or ``TORN`` for a part that can't be parsed."""
    position: int
    """Position of the content in the file [byte]."""
    length: int
    """Declared length of the content [byte]."""


class Ahead(NamedTuple):
    """A record that is ready to be processed."""

    record: FileRecord
    chunk: Future[bytes | memoryview] | None = None
    """Future of the decompressed chunk."""
    size: int = 0
    """Size of the decompressed chunk [byte]."""


def rebuild_mcap_index(file: LogFile) -> FileIndex:
    """Build an index of all readable messages, with statistics of what was lost.

    Raises:
        InputError: The file was changed meanwhile, or has an impossible number of messages.
    """
    scan = _Scan(file)
    with ThreadPoolExecutor(cores(), "jaxdet-open") as pool:
        for item in ahead(file, scan.records(), pool):
            try:
                scan.take(*item[:2])
            except DamageError as error:
                scan.walk.lose(str(error), item.record.length)
            del item  # free its chunk before the next is decompressed
    return scan.index()


def ahead(
    file: LogFile, records: Iterable[FileRecord], pool: ThreadPoolExecutor
) -> Iterator[Ahead]:
    """Yield the records in order, with chunks decompressed ahead.

    At most 64 MiB of chunks, or one larger chunk, are decompressed at a time.

    Args:
        file: File.
        records: Records of the file.
        pool: Thread pool for decompression.
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


class _Scan:
    """State of a scan."""

    def __init__(self, file: LogFile) -> None:
        self.file, self.walk = file, Walk(file)
        self.summary: Summary | None = None
        self.summary_problem = ""
        try:
            self.summary = read_summary(file)
        except DamageError as error:
            self.summary_problem = str(error)
        self.declared = Declarations()
        self.infos: dict[int, ChannelInfo] = {}
        self.ended = False
        self.chunks = self.chunks_with_crc = 0
        self.lost_spans: list[tuple[int, int]] = []
        self.indexed: Counter[int] = Counter()
        """Number of messages in message indexes, by channel."""
        self.torn: list[tuple[int, int]] = []
        """Parts of the file that were skipped."""
        self.seen: Counter[tuple[int, int, int, int]] = Counter()
        """Number of chunks found, by :func:`_chunk_key`, for the comparison with the summary."""

    def records(self) -> Iterator[FileRecord]:
        """Yield the records up to the end of the data; unparsable parts are ``TORN`` records."""
        file, position, odd = self.file, len(MAGIC), 0
        while True:
            start, content = position, position + RECORD_HEAD.size
            opcode, length = self._record_head(position)
            position = content + length
            odd += length == 0 or (opcode >= 0x80 and length < _ODD_BYTES)
            known = 0 < opcode <= Opcode.DATA_END or opcode >= 0x80
            if known and position <= file.size and odd <= MAX_ODD_RECORDS:
                if opcode in (Opcode.DATA_END, Opcode.FOOTER):
                    self._end(position)
                    return
                yield FileRecord(opcode, content, length)
                continue
            starts = self.summary.chunks.start if self.summary else np.zeros(0, np.int64)
            after = starts[np.searchsorted(starts, start, "right") :]
            position, odd = int(after[0]) if len(after) else file.size, 0
            self.torn.append((start, position))
            yield FileRecord(TORN, start, position - start)
            if not len(after):
                return

    def take(self, record: FileRecord, chunk: Future[bytes | memoryview] | None) -> None:
        """Process a record, with its chunk decompressed.

        Raises:
            DamageError: The record is unusable.
        """
        opcode, position, length = record
        if opcode == TORN:
            raise DamageError("damaged or torn record")
        if chunk is not None:
            self._chunk(position, chunk)
        elif opcode == Opcode.MESSAGE_INDEX:
            self._count_indexed(position, length)
        elif opcode in (Opcode.MESSAGE, Opcode.CHANNEL, Opcode.SCHEMA):
            self.file.check_memory(length, "record")
            content = memoryview(self.file.read(position, length))
            self._content(opcode, content, position, length, 0)

    def index(self) -> FileIndex:
        """Return the index of the messages found, with the counts declared by the file."""
        missing = self._missing()
        statistics = self.summary.statistics if self.summary else None
        if missing or (self.summary and not statistics):
            self._lose_missing_chunks()
        return self.walk.index(
            declared_messages=statistics.message_count if statistics else None,
            chunks=self.chunks,
            chunks_with_crc=self.chunks_with_crc,
            has_end=self.ended,
            lost_spans_ns=tuple(self.lost_spans),
            missing=missing,
            summary_problem=self.summary_problem,
        )

    def _record_head(self, position: int) -> tuple[int, int]:
        """Return opcode and length; ``TORN`` if the file ends or is unreadable there."""
        if position + RECORD_HEAD.size > self.file.size:
            return TORN, 0
        try:
            opcode, length = RECORD_HEAD.unpack(self.file.read(position, RECORD_HEAD.size))
        except DamageError:
            return TORN, 0
        return opcode, length

    def _end(self, position: int) -> None:
        """Record the end of the data; if no summary was read yet, read it after this position."""
        try:
            magic = self.file.read(self.file.size - len(MAGIC), len(MAGIC))
        except DamageError:
            return
        self.ended = magic == MAGIC
        if self.summary is None and self.ended:
            try:
                self.summary = read_summary(self.file, position)
                self.summary_problem = ""
            except DamageError as error:
                self.summary_problem = self.summary_problem or str(error)

    def _chunk(self, position: int, decompressed: Future[bytes | memoryview]) -> None:
        head = self.file.chunk_head(position)
        self.chunks += 1
        self.chunks_with_crc += head.crc != 0
        self.seen[_chunk_key(head)] += 1
        try:
            chunk = decompressed.result()
        except DamageError:
            if head.start_ns <= head.end_ns <= MAX_TIME_NS:
                self.lost_spans.append((head.start_ns, head.end_ns))
            raise
        view = memoryview(chunk)
        for opcode, offset, size in chunk_records(chunk):
            try:
                content, start = view[offset : offset + size], offset - RECORD_HEAD.size
                self._content(opcode, content, position, head.length, start)
            except DamageError as error:
                self.walk.lose(str(error), size)

    def _content(
        self, opcode: int, content: memoryview, position: int, length: int, offset: int
    ) -> None:
        """Process the record at an offset in the records of a chunk."""
        if opcode == Opcode.SCHEMA:
            self.declared.add_schema(content)
            return
        if opcode == Opcode.CHANNEL:
            self.declared.add_channel(content)
            return
        if len(content) < MESSAGE_HEAD.size:
            raise DamageError("message record is too short")
        channel_id, _, log_ns, _ = MESSAGE_HEAD.unpack_from(content)
        info = self.infos.get(channel_id) or self._info(channel_id)
        if info is None:
            raise DamageError("message of an undeclared channel")
        self.walk.add(channel_id, info, min(log_ns, MAX_TIME_NS), position, length, offset)

    def _info(self, channel_id: int) -> ChannelInfo | None:
        info = self.declared.info(channel_id, self.summary.declared if self.summary else None)
        if info is not None:
            self.infos[channel_id] = info
        return info

    def _count_indexed(self, position: int, length: int) -> None:
        if length < _INDEX_HEAD.size:
            raise DamageError("message index is damaged")
        channel, size = _INDEX_HEAD.unpack(self.file.read(position, _INDEX_HEAD.size))
        if size != length - _INDEX_HEAD.size:
            raise DamageError("message index is damaged")
        self.indexed[channel] += size // _ENTRY_BYTES

    def _missing(self) -> dict[str, int]:
        """Return the number of messages per topic that are declared but were not found."""
        statistics = self.summary.statistics if self.summary else None
        declared = statistics.channel_message_counts if statistics else {}
        missing: Counter[str] = Counter()
        for number in sorted({*declared, *self.indexed}):
            count = max(declared.get(number, 0), self.indexed[number]) - self.walk.read[number]
            if count > 0:
                info = self.infos.get(number) or self._info(number)
                missing[info.topic if info else f"channel {number}"] += count
        return dict(missing)

    def _lose_missing_chunks(self) -> None:
        """Count chunks of the summary that were not found as lost."""
        if self.summary is None:
            return
        left, chunks = Counter(self.seen), self.summary.chunks
        columns = chunks.first_ns, chunks.last_ns, chunks.size, chunks.stored, chunks.start
        for *key, start in zip(*(column.tolist() for column in columns), strict=True):
            known = tuple(key)
            left[known] -= 1
            if left[known] >= 0:
                continue
            self.lost_spans.append((key[0], key[1]))
            place = bisect_right(self.torn, start, key=lambda span: span[0])
            if not place or start >= self.torn[place - 1][1]:
                self.walk.lose("chunk of the index is missing", key[3])


def _chunk_key(head: ChunkHead) -> tuple[int, int, int, int]:
    return head.start_ns, head.end_ns, head.uncompressed_size, head.data_size
