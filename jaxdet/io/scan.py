"""The walk over a whole MCAP file, tolerant of damage.

A file is walked from its first record to its last, whole chunks at a time; those ahead are
decompressed on threads, and all is taken in by the caller's, in order. What is damaged is
dropped and counted, and its neighbours are used: a chunk with a wrong CRC, a message longer
than its chunk, a torn end. A missing summary does no harm. Where a record's length is damaged
the walk goes on at the next chunk that the summary's index knows.
"""

from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from io import BytesIO
from typing import NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from jaxdet.io.chunks import MESSAGE_HEAD, RECORD_HEAD, DamageError, chunk_records
from jaxdet.io.container import MAGIC, Location, McapFile
from jaxdet.io.integrity import FileIntegrity
from jaxdet.io.lookahead import FileRecord, ahead
from jaxdet.io.summary import read_summary

_TOP_LEVEL = -1
_TORN = 0
"""Opcode, which no record has, of what can't be walked over."""
_MAX_TIME_NS = (1 << 63) - 1


class ChannelInfo(NamedTuple):
    """A channel with its schema, as the file declares them."""

    topic: str
    message_encoding: str
    schema_name: str
    schema_encoding: str
    schema_data: bytes

    @property
    def schema_text(self) -> str:
        """The schema as text."""
        return self.schema_data.decode("utf-8", "replace")


def channel_info(channel: Channel, schema: Schema | None) -> ChannelInfo:
    """A channel with its schema, if it has one."""
    if schema is None:
        return ChannelInfo(channel.topic, channel.message_encoding, "", "", b"")
    named = schema.name, schema.encoding, schema.data
    return ChannelInfo(channel.topic, channel.message_encoding, *named)


Handler = Callable[[ChannelInfo, int, memoryview, Location], None]
"""Gets channel, log time [ns], payload and location of each message."""


def scan(file: McapFile, handler: Handler, pool: ThreadPoolExecutor) -> FileIntegrity:
    """Gives every readable message to ``handler``, in file order; says what was lost.

    Args:
        file: The file.
        handler: Called by this thread.
        pool: Decompresses chunks, up to 64 MiB of them ahead (or one chunk, if larger).
    """
    walk = _Scan(file, handler)
    for item in ahead(file, walk.records(), pool):
        try:
            walk.record(item.record, item.chunk)
        except DamageError as error:
            walk.lose(str(error), item.record.length)
        del item  # and its chunk, before the next is decompressed
    return walk.integrity()


class _Summary(NamedTuple):
    channels: dict[int, Channel]
    schemas: dict[int, Schema]
    chunk_offsets: list[int]
    message_count: int | None


def _read_summary(file: McapFile) -> _Summary:
    try:
        summary = read_summary(file)
    except DamageError:
        return _Summary({}, {}, [], None)
    count = summary.statistics.message_count if summary.statistics else None
    return _Summary(summary.channels, summary.schemas, summary.chunks.start.tolist(), count)


class _Scan:
    """The state of one walk over a file."""

    def __init__(self, file: McapFile, handler: Handler) -> None:
        self.file, self.handler = file, handler
        self.summary = _read_summary(file)
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.infos: dict[int, ChannelInfo] = {}
        self.ended = False
        self.lost: Counter[str] = Counter()
        self.lost_bytes = self.messages = self.chunks = self.chunks_with_crc = 0
        self.lost_spans: list[tuple[int, int]] = []
        self.last_ns = 0

    def records(self) -> Iterator[FileRecord]:
        """The records up to the end of the data, and in their places what can't be one."""
        file, position = self.file, len(MAGIC)
        while True:
            start, content = position, position + RECORD_HEAD.size
            if content <= file.size:
                opcode, length = RECORD_HEAD.unpack(file.read(position, RECORD_HEAD.size))
                position = content + length
                known = 0 < opcode <= Opcode.DATA_END or opcode >= 0x80
                if known and position <= file.size:
                    if opcode in (Opcode.DATA_END, Opcode.FOOTER):
                        self.ended = file.read(file.size - len(MAGIC), len(MAGIC)) == MAGIC
                        return
                    yield FileRecord(opcode, content, length)
                    continue
            after = [offset for offset in self.summary.chunk_offsets if offset > start]
            position = after[0] if after else file.size
            yield FileRecord(_TORN, start, position - start)
            if not after:
                return

    def record(self, record: FileRecord, chunk: Future[bytes] | None) -> None:
        """Takes in one record.

        Raises:
            DamageError: It can't be used.
        """
        opcode, position, length = record
        if opcode == _TORN:
            raise DamageError("damaged or torn record")
        if chunk is not None:
            self._chunk(position, chunk)
        elif opcode in (Opcode.MESSAGE, Opcode.CHANNEL, Opcode.SCHEMA):
            if length > self.file.max_bytes:
                raise DamageError("record is larger than --log.max-chunk-mib")
            content = memoryview(self.file.read(position, length))
            self._content(opcode, content, _TOP_LEVEL, position)

    def lose(self, reason: str, size: int) -> None:
        """Counts something that can't be used."""
        self.lost[reason] += 1
        self.lost_bytes += size

    def integrity(self) -> FileIntegrity:
        """What was found."""
        return FileIntegrity(
            path=self.file.path,
            messages=self.messages,
            declared_messages=self.summary.message_count,
            chunks=self.chunks,
            chunks_with_crc=self.chunks_with_crc,
            has_end=self.ended,
            lost=dict(self.lost),
            lost_bytes=self.lost_bytes,
            lost_spans_ns=tuple(self.lost_spans),
            last_log_time_ns=self.last_ns,
        )

    def _chunk(self, position: int, decompressed: Future[bytes]) -> None:
        head = self.file.chunk_head(position)
        self.chunks += 1
        self.chunks_with_crc += head.crc != 0
        try:
            chunk = decompressed.result()
        except DamageError:
            if head.start_ns <= head.end_ns <= _MAX_TIME_NS:
                self.lost_spans.append((head.start_ns, head.end_ns))
            raise
        view = memoryview(chunk)
        for opcode, offset, size in chunk_records(chunk):
            try:
                self._content(opcode, view[offset : offset + size], position, offset)
            except DamageError as error:
                self.lose(str(error), size)

    def _content(self, opcode: int, content: memoryview, chunk: int, offset: int) -> None:
        if opcode != Opcode.MESSAGE:
            self._declare(opcode, bytes(content))
            return
        if len(content) < MESSAGE_HEAD.size:
            raise DamageError("message record is too short")
        channel_id, _, log_ns, _ = MESSAGE_HEAD.unpack_from(content)
        info = self.infos.get(channel_id) or self._info(channel_id)
        self.messages += 1
        log_ns = min(log_ns, _MAX_TIME_NS)
        self.last_ns = max(self.last_ns, log_ns)
        size = len(content) - MESSAGE_HEAD.size
        location = Location(chunk, offset + MESSAGE_HEAD.size, size)
        self.handler(info, log_ns, content[MESSAGE_HEAD.size :], location)

    def _declare(self, opcode: int, content: bytes) -> None:
        stream = ReadDataStream(BytesIO(content))
        try:
            if opcode == Opcode.SCHEMA:
                schema = Schema.read(stream)
                self.schemas.setdefault(schema.id, schema)
            else:
                channel = Channel.read(stream)
                self.channels.setdefault(channel.id, channel)
        except Exception as error:  # mcap's readers raise what they like
            raise DamageError("schema or channel record is damaged") from error

    def _info(self, channel_id: int) -> ChannelInfo:
        channel = self.channels.get(channel_id) or self.summary.channels.get(channel_id)
        if channel is None:
            raise DamageError("message of an undeclared channel")
        schema = self.schemas.get(channel.schema_id) or self.summary.schemas.get(channel.schema_id)
        info = channel_info(channel, schema)
        self.infos[channel_id] = info
        return info
