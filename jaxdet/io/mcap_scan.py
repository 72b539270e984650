"""Index of an MCAP file from its contents, tolerant of damage.

The file is walked from the first record to the last, and all chunks are read. Damaged parts (a
chunk with a wrong CRC, a message longer than its chunk, a truncated end) are dropped and counted;
all other parts are used. The summary is optional. If the length of a record is damaged, the walk
continues at the next chunk listed in the summary. Chunks and messages that are listed in the
summary or the message indexes, but were not found, are reported as lost.
"""

from bisect import bisect_right
from collections import Counter, deque

import numpy as np
from mcap.opcode import Opcode

from jaxdet.io.chunks import (
    MAGIC,
    MAX_TIME_NS,
    MESSAGE_HEAD,
    RECORD_HEAD,
    ChunkHead,
    DamageError,
    chunk_records,
)
from jaxdet.io.container import LogFile, Walk
from jaxdet.io.declarations import ChannelInfo, Declarations
from jaxdet.io.file_index import FileIndex, Place
from jaxdet.io.mcap_index import (
    INDEX_ENTRY_BYTES,
    INDEX_HEAD,
    TORN,
    FileRecord,
    FileRecords,
    Summary,
    read_summary,
)
from jaxdet.io.store import ChunkStore

_MAX_SPANS = 1000
"""Maximum number of lost chunks whose log times are kept."""


def rebuild_mcap_index(file: LogFile) -> FileIndex:
    """Build an index of all readable messages, with statistics of what was lost.

    Raises:
        InputError: The file was changed meanwhile, or has an impossible number of messages.
    """
    store = ChunkStore([file], most_bytes=file.memory.chunk)
    try:
        scan = _Scan(file, store)
        for record in scan.records.walk(scan.restarts):
            try:
                scan.take(record)
            except DamageError as error:
                scan.walk.lose(str(error), record.length)
    finally:
        store.stop()
    return scan.index()


class _Scan:
    """State of a scan."""

    def __init__(self, file: LogFile, store: ChunkStore) -> None:
        self.file, self.store, self.walk = file, store, Walk(file)
        self.summary: Summary | None = None
        self.summary_problem = ""
        self._read_summary()
        known = self.summary.chunks.position if self.summary else np.zeros(0, np.uint64)
        self.restarts = np.sort(known[known < file.size])
        """Positions of the chunks that the summary lists."""
        self.records = FileRecords(file)
        found = FileRecords(file).walk(self.restarts)
        places = (Place(0, item.position) for item in found if item.opcode == Opcode.CHUNK)
        self.loaded = store.loaded(places)
        """Chunks of the file in order, decompressed ahead in threads."""
        self.declared = Declarations()
        self.infos: dict[int, ChannelInfo] = {}
        self.ended = False
        self.chunks = self.chunks_with_crc = 0
        self.lost_spans: list[tuple[int, int]] = []
        self.indexed: Counter[int] = Counter()
        """Number of messages in message indexes, by channel."""
        self.torn: list[tuple[int, int]] = []
        """Parts of the file that were skipped; adjacent ones are merged."""
        self.seen: Counter[tuple[int, int, int, int]] = Counter()
        """Number of chunks found, by :func:`_chunk_key`, for the comparison with the summary."""

    def take(self, record: FileRecord) -> None:
        """Process a record.

        Raises:
            DamageError: The record is unusable.
        """
        opcode, position, length = record
        if opcode == TORN:
            begin = self.torn.pop()[0] if self.torn and self.torn[-1][1] == position else position
            self.torn.append((begin, position + length))
            raise DamageError("damaged or torn record")
        if opcode == Opcode.CHUNK:
            self._chunk(next(self.loaded))
        elif opcode == Opcode.MESSAGE_INDEX:
            if length < INDEX_HEAD.size:
                raise DamageError("message index is damaged")
            channel, size = INDEX_HEAD.unpack(self.records.read(position, INDEX_HEAD.size))
            if size != length - INDEX_HEAD.size:
                raise DamageError("message index is damaged")
            self.indexed[channel] += size // INDEX_ENTRY_BYTES
        elif opcode in (Opcode.MESSAGE, Opcode.CHANNEL, Opcode.SCHEMA):
            self.file.check_memory(length, "record")
            content = memoryview(self.file.read(position, length))
            self._content(opcode, content, position, 0)
        elif opcode in (Opcode.DATA_END, Opcode.FOOTER):
            self._end(record)

    def index(self) -> FileIndex:
        """Return the index of the messages found, with the counts declared by the file."""
        missing = self._missing()
        more = self.summary.declared.channels if self.summary else ()
        for number in (*self.declared.channels, *more):
            self._info(number)
        statistics = self.summary.statistics if self.summary else None
        if missing or (self.summary and not statistics):
            self._lose_missing_chunks()
        return self.walk.index(
            self.infos,
            declared_messages=statistics.message_count if statistics else None,
            chunks=self.chunks,
            chunks_with_crc=self.chunks_with_crc,
            has_end=self.ended,
            lost_spans_ns=tuple(self.lost_spans),
            missing=missing,
            summary_problem=self.summary_problem,
        )

    def _read_summary(self, at: int | None = None, end: int | None = None) -> None:
        try:
            self.summary, self.summary_problem = read_summary(self.file, at, end), ""
        except DamageError as error:
            self.summary_problem = self.summary_problem or str(error)

    def _end(self, last: FileRecord) -> None:
        """Find the end of the recording; if no summary was read yet, read the one before it.

        Args:
            last: Last record of the data, which the summary follows.
        """
        start, end = last.position + last.length, self.file.size
        if last.opcode == Opcode.DATA_END:
            last = deque(FileRecords(self.file).walk(position=start), maxlen=1).pop()
        if last.opcode == Opcode.FOOTER:
            end = min(end, last.position + last.length + len(MAGIC))
        self.ended = self.file.read(end - len(MAGIC), len(MAGIC)) == MAGIC
        if self.ended:
            self.file.note_unread(self.file.size - end)
        if self.summary is None and self.ended:
            self._read_summary(start, end)

    def _chunk(self, place: Place) -> None:
        head = self.store.head(place)
        self.chunks += 1
        self.chunks_with_crc += head.crc != 0
        self.seen[_chunk_key(head)] += 1
        try:
            chunk = self.store.data(place)
        except DamageError:
            if head.start_ns <= head.end_ns <= MAX_TIME_NS:
                self._lose_span(head.start_ns, head.end_ns)
            raise
        view = memoryview(chunk)
        for opcode, offset, size in chunk_records(chunk):
            try:
                content, start = view[offset : offset + size], offset - RECORD_HEAD.size
                self._content(opcode, content, place.position, start)
            except DamageError as error:
                self.walk.lose(str(error), size)

    def _content(self, opcode: int, content: memoryview, position: int, offset: int) -> None:
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
        if self._info(channel_id) is None:
            raise DamageError("message of an undeclared channel")
        self.walk.add(channel_id, min(log_ns, MAX_TIME_NS), position, offset)

    def _info(self, channel_id: int) -> ChannelInfo | None:
        """Return a channel as declared before its first message, or in the summary."""
        if channel_id not in self.infos:
            more = self.summary.declared if self.summary else None
            info = self.declared.info(channel_id, more)
            if info is None:
                return None
            self.infos[channel_id] = info
        return self.infos[channel_id]

    def _missing(self) -> dict[str, int]:
        """Return the number of messages per topic that are declared but were not found."""
        statistics = self.summary.statistics if self.summary else None
        declared = statistics.channel_message_counts if statistics else {}
        missing: Counter[str] = Counter()
        for number in sorted({*declared, *self.indexed}):
            count = max(declared.get(number, 0), self.indexed[number]) - self.walk.read[number]
            if count > 0:
                info = self._info(number)
                missing[info.topic if info else f"channel {number}"] += count
        return dict(missing)

    def _lose_missing_chunks(self) -> None:
        """Count chunks of the summary that were not found as lost."""
        if self.summary is None:
            return
        known, left = self.summary.chunks, Counter(self.seen)
        columns = known.start_ns, known.end_ns, known.size, known.packed_size, known.position
        for row in np.stack(columns, axis=1)[np.argsort(known.position, kind="stable")]:
            start_ns, end_ns, size, packed_size, start = row.tolist()
            key = start_ns, end_ns, size, packed_size
            if left[key]:
                left[key] -= 1
                continue
            self._lose_span(start_ns, end_ns)
            place = bisect_right(self.torn, start, key=lambda part: part[0])
            if not place or start >= self.torn[place - 1][1]:
                self.walk.lose("chunk of the index is missing", packed_size)

    def _lose_span(self, start_ns: int, end_ns: int) -> None:
        if len(self.lost_spans) < _MAX_SPANS:
            self.lost_spans.append((start_ns, end_ns))


def _chunk_key(head: ChunkHead) -> tuple[int, int, int, int]:
    return head.start_ns, head.end_ns, head.uncompressed_size, head.data_size
