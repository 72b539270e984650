"""ROS 1 bags, version 2.0: records, index, and chunks converted to MCAP records.

A record consists of a header of named fields and of data, each preceded by its length. A chunk
contains connections and messages, and is followed by its index; all connections and the positions
of the chunks are at the end of the file. Source: the ROS wiki's page "Bags/Format/2.0". A bag
without this list is not read; if the recording was not closed, ``rosbag reindex`` creates it.

``rosbags`` decodes the messages, but its file reader is not used: it needs 150 bytes per message,
parses the index entry by entry, and decompresses chunks without a size limit.

The header of a message is larger in a bag (46 bytes) than in MCAP (31). The converted chunk
therefore has the length of the original, each message starts at the offset in the bag's index, and
the gaps are padding.
"""

import bz2
import struct
from collections import Counter
from collections.abc import Iterator, Mapping
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import lz4.frame
import numpy as np
from mcap.opcode import Opcode

from jaxdet.errors import InputError
from jaxdet.io.chunks import MESSAGE_HEAD, PAYLOAD_OFFSET, RECORD_HEAD, ChunkHead, DamageError
from jaxdet.io.container import LogFile, Source, Walk
from jaxdet.io.declarations import ChannelInfo
from jaxdet.io.file_index import MAX_CHANNEL, FileIndex, FileIntegrity, file_index
from jaxdet.io.limits import MAX_DECLARATIONS, MAX_SCHEMA_BYTES, MAX_SCHEMAS_BYTES
from jaxdet.io.messages import kind_of

MESSAGE, BAG, INDEX, CHUNK, CHUNK_INFO, CONNECTION = 2, 3, 4, 5, 6, 7
"""Record types (field ``op``)."""
MAGIC = b"#ROSBAG V2.0\n"
_LENGTH = struct.Struct("<I")
_PADDING = 0x80
"""Opcode of the padding records, one that MCAP reserves for applications."""
_MAX_HEAD_BYTES = 1 << 16
_FIRST_BYTES = 256
"""Number of bytes of a record header that are read first."""
_ENTRY = np.dtype([("sec", "<u4"), ("nanosec", "<u4"), ("offset", "<u4")])
_COUNT = np.dtype([("connection", "<u4"), ("messages", "<u4")])
_INDEX_VERSION = 1


class BagRecord(NamedTuple):
    """A record of a bag and its position in the file."""

    op: int
    fields: dict[bytes, bytes]
    start: int
    """Position of the record [byte]."""
    data: int
    """Position of the record's data [byte]."""
    size: int
    """Size of the record's data [byte]."""

    @property
    def end(self) -> int:
        """Position of the next record [byte]."""
        return self.data + self.size

    def number(self, name: bytes, size: int = 4) -> int:
        """Return a field of ``size`` bytes as an integer.

        Raises:
            DamageError: The field is missing, or has another size.
        """
        value = self.fields.get(name, b"")
        if len(value) != size:
            raise DamageError("record of the bag is damaged")
        return int.from_bytes(value, "little")


class _End(NamedTuple):
    """Contents of the index at the end of a bag."""

    connections: dict[int, ChannelInfo]
    counts: dict[int, dict[int, int]]
    """Number of messages per connection in each chunk, by the position of the chunk [byte]."""


class BagFile(LogFile):
    """A ROS 1 bag; chunks are identified by the position of their record.

    Raises:
        InputError: The bag has no index.
    """

    magic = MAGIC

    def __init__(self, path: Path, max_bytes: int, source: Source | None = None) -> None:
        _require_rosbags(path)
        super().__init__(path, max_bytes, source)
        try:
            self.head = self.record(len(MAGIC))
            self.index = self.head.number(b"index_pos", 8) if self.head.op == BAG else 0
        except DamageError:
            self.index = 0
        if not self.index:
            self.close()
            raise self.without_index("the bag was not closed")

    def without_index(self, why: str) -> InputError:
        """Return the error for a bag whose index is missing or damaged."""
        problem, remedy = f"the bag has no usable index ({why})", "run rosbag reindex on a copy"
        if self.source.note:
            problem, remedy = self.source.note, "copy or compress the original bag again"
        elif self.source.path != self.path:
            remedy = "decompress it and run rosbag reindex"
        return InputError(problem, path=str(self.path), remedy=remedy)

    def read_index(self) -> FileIndex:
        """Read the index of the bag, see :meth:`LogFile.read_index`."""
        end = _read_end(self)
        parts = [np.zeros((4, 0), np.int64)]
        for position, after in pairwise([*sorted(end.counts), self.index]):
            parts += _chunk_index(self, position, after, end.counts[position])
        messages = np.concatenate(parts, axis=1)
        self.check_messages(messages.shape[1])
        about = FileIntegrity(self.path, chunks=len(end.counts), by_index=True)
        return file_index(dict(sorted(end.connections.items())), messages, about)

    def rebuild_index(self) -> FileIndex:
        """Build an index of the messages in all intact chunks, without the indexes of the chunks.

        The chunks are those listed at the end of the bag, with the numbers of their messages.

        Raises:
            InputError: The list is missing or damaged, or the file was changed meanwhile.
        """
        try:
            end = _read_end(self)
        except DamageError as error:
            raise self.without_index(str(error)) from error
        walk, missing = Walk(self), Counter[str]()
        for position, after in pairwise([*sorted(end.counts), self.index]):
            try:
                found = self._messages(position, end.connections)
            except DamageError as error:
                walk.lose(str(error), after - position)
                found = []
            for number, log_ns, offset in found:
                walk.add(number, log_ns, position, offset)
            lost = Counter(end.counts[position]) - Counter(number for number, *_ in found)
            for number, count in lost.items():
                info = end.connections.get(number)
                missing[info.topic if info else f"connection {number}"] += count
        return walk.index(
            dict(sorted(end.connections.items())),
            declared_messages=sum(sum(counts.values()) for counts in end.counts.values()),
            chunks=len(end.counts),
            missing=dict(missing),
        )

    def record(self, position: int, end: int | None = None) -> BagRecord:
        """Return the record at a position in the file.

        Args:
            position: Start of the record [byte].
            end: Upper limit for the end of the record [byte]; by default the size of the file.

        Raises:
            DamageError: There is no complete record at the position.
        """
        end = self.size if end is None else min(end, self.size)
        known = self.read(position, max(0, min(_FIRST_BYTES, end - position)))
        if len(known) >= _LENGTH.size:
            size = 2 * _LENGTH.size + _LENGTH.unpack_from(known)[0]
            if len(known) < size <= min(_MAX_HEAD_BYTES, end - position):
                known = self.read(position, size)
        found = read_record(known, 0, position)
        if found.end > end:
            raise DamageError("file ends early")
        return found

    def chunk_head(self, position: int) -> ChunkHead:
        """Return the header of the chunk whose record starts at ``position``, with log times of 0.

        Raises:
            DamageError: There is no chunk.
        """
        record = self.record(position)
        if record.op != CHUNK:
            raise DamageError("no chunk at the expected position")
        name = record.fields.get(b"compression", b"").decode("ascii", "replace")
        place = record.data - position
        size = record.number(b"size")
        return ChunkHead(0, 0, size, 0, f"bag {name}", place, record.size)

    def chunk(self, position: int) -> memoryview:
        """Return the chunk at ``position``, each message converted to an MCAP record at its offset.

        Raises:
            DamageError: The chunk is unreadable, or a record exceeds it.
        """
        data = self._decompressed(position)
        found = bytearray(len(data))
        view = memoryview(data)
        for record in records(data):
            start = record.start
            if record.op == MESSAGE:
                number, log_ns = record.number(b"conn"), nanoseconds(record)
                if number > MAX_CHANNEL:
                    raise DamageError("connection number is out of range")
                RECORD_HEAD.pack_into(found, start, Opcode.MESSAGE, MESSAGE_HEAD.size + record.size)
                MESSAGE_HEAD.pack_into(found, start + RECORD_HEAD.size, number, 0, log_ns, log_ns)
                payload = start + PAYLOAD_OFFSET
                start = payload + record.size
                found[payload:start] = view[record.data : record.end]
            RECORD_HEAD.pack_into(found, start, _PADDING, record.end - start - RECORD_HEAD.size)
        return memoryview(found)

    def _decompressed(self, position: int) -> bytes:
        """Return the decompressed records of a chunk.

        Raises:
            DamageError: The chunk is unreadable.
        """
        head = self.chunk_head(position)
        self.check_memory(max(head.uncompressed_size, head.data_size))
        return _decompress(head, self.read(position + head.data_offset, head.data_size))

    def _messages(
        self, position: int, connections: Mapping[int, ChannelInfo]
    ) -> list[tuple[int, int, int]]:
        """Return connection, log time [ns] and offset of each message in a chunk.

        Raises:
            DamageError: The chunk is unreadable, or the connection of a message is not declared.
        """
        found = [
            (record.number(b"conn"), nanoseconds(record), record.start)
            for record in records(self._decompressed(position))
            if record.op == MESSAGE
        ]
        if any(number not in connections for number, *_ in found):
            raise DamageError("message of an undeclared connection")
        return found


def _require_rosbags(path: Path) -> None:
    """Check that ROS 1 messages can be decoded.

    Raises:
        InputError: ``rosbags`` is not installed.
    """
    if find_spec("rosbags") is None:
        remedy = "install jaxdet[rosbag], or convert the bag: "
        remedy += f"rosbags-convert --src {path} --dst NEW --dst-storage mcap"
        raise InputError("ROS 1 bags need the package rosbags", path=str(path), remedy=remedy)


def records(data: bytes) -> Iterator[BagRecord]:
    """Yield the records in data such as a decompressed chunk.

    Raises:
        DamageError: A record exceeds the data.
    """
    position = 0
    while position < len(data):
        record = read_record(data, position)
        if record.end > len(data):
            raise DamageError("record is longer than its chunk")
        yield record
        position = record.end


def read_record(data: bytes, place: int, start: int = 0) -> BagRecord:
    """Parse the record header at offset ``place`` of data that start at ``start`` in the file.

    Raises:
        DamageError: The header is damaged; it is not an error if the data after it are incomplete.
    """
    try:
        (size,) = _LENGTH.unpack_from(data, place)
        after = place + _LENGTH.size + size
        (data_size,) = _LENGTH.unpack_from(data, after)
    except struct.error as error:
        raise DamageError("record of the bag is damaged") from error
    found = fields(memoryview(data)[place + _LENGTH.size : after])
    op = found.get(b"op", b"")
    if len(op) != 1:
        raise DamageError("record of the bag is damaged")
    return BagRecord(op[0], found, start + place, start + after + _LENGTH.size, data_size)


def nanoseconds(record: BagRecord) -> int:
    """Return the log time of a message record [ns].

    Raises:
        DamageError: The record has no time.
    """
    nanosec, sec = divmod(record.number(b"time", 8), 1 << 32)
    return sec * 1_000_000_000 + nanosec


def fields(head: bytes | memoryview) -> dict[bytes, bytes]:
    """Parse the named fields of a record header, or of a connection's data.

    Raises:
        DamageError: The fields are damaged.
    """
    found: dict[bytes, bytes] = {}
    place = 0
    while place < len(head):
        if place + _LENGTH.size > len(head):
            raise DamageError("record of the bag is damaged")
        (size,) = _LENGTH.unpack_from(head, place)
        place += _LENGTH.size
        name, equals, value = bytes(head[place : place + size]).partition(b"=")
        if not equals or place + size > len(head):
            raise DamageError("record of the bag is damaged")
        found[name] = value
        place += size
    return found


def _decompress(head: ChunkHead, data: bytes) -> bytes:
    size, kind = head.uncompressed_size, head.compression.removeprefix("bag ")
    try:
        if kind == "none":
            found = data
        elif kind == "lz4":
            found = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1)
        elif kind == "bz2":
            found = bz2.BZ2Decompressor().decompress(data, max_length=size + 1)
        else:
            raise DamageError(f"chunk compression {kind!a} is unknown")
    except (RuntimeError, EOFError, OSError, ValueError) as error:
        raise DamageError("chunk can't be decompressed") from error
    if len(found) != size:
        raise DamageError("chunk has a size that differs from the declared one")
    return found


def _read_end(file: BagFile) -> _End:
    """Read the connections and chunks listed at the end of a bag.

    Raises:
        DamageError: The list is missing or damaged.
    """
    head, start = file.head, file.index
    if not head.end <= start < file.size:
        raise DamageError("index points beyond the end of the file")
    file.check_size(file.size - start, "index")
    data = file.read(start, file.size - start)
    found, used = _End({}, {}), 0
    if head.number(b"conn_count") > MAX_DECLARATIONS:
        raise DamageError("index lists too many connections")
    left = {CONNECTION: head.number(b"conn_count"), CHUNK_INFO: head.number(b"chunk_count")}
    for record in records(data):
        content = data[record.data : record.end]
        if record.op == CONNECTION:
            number = record.number(b"conn")
            if number > MAX_CHANNEL:
                raise DamageError("connection number is out of range")
            info = _connection(record, fields(content))
            used += len(info.topic) + len(info.schema_name) + len(info.schema_data)
            if used > MAX_SCHEMAS_BYTES:
                raise DamageError("connections take too much memory")
            found.connections.setdefault(number, info)
        elif record.op == CHUNK_INFO:
            position = record.number(b"chunk_pos", 8)
            if not head.end <= position < start or len(content) % _COUNT.itemsize:
                raise DamageError("index points beyond the end of the file")
            found.counts[position] = dict(np.frombuffer(content, _COUNT).tolist())
        left[record.op] = left.get(record.op, 0) - 1
        if left[CONNECTION] < 0 or left[CHUNK_INFO] < 0:
            raise DamageError("index lists more than its header")
        if not left[CONNECTION] and not left[CHUNK_INFO]:
            file.note_unread(len(data) - record.end)
            break
    if len(found.counts) != head.number(b"chunk_count"):
        raise DamageError("index lacks chunks")
    return found


def _connection(record: BagRecord, about: dict[bytes, bytes]) -> ChannelInfo:
    topic = record.fields.get(b"topic", about.get(b"topic", b"")).decode("utf-8", "replace")
    name = about.get(b"type", b"").decode("utf-8", "replace")
    text = about.get(b"message_definition", b"")
    kept = text if kind_of(name) is not None and len(text) <= MAX_SCHEMA_BYTES else b""
    return ChannelInfo(topic, "ros1", name, "ros1msg", kept, len(text))


def _chunk_index(
    file: BagFile, position: int, end: int, counts: dict[int, int]
) -> Iterator[np.ndarray]:
    """Yield the messages of a chunk according to its index, as arrays ``(4, N)`` int64.

    The rows are connection, log time [ns], position of the chunk and offset in the chunk [byte].

    Raises:
        DamageError: The index of the chunk is invalid.
    """
    chunk = file.record(position, end)
    size = chunk.number(b"size")
    if chunk.op != CHUNK or size > file.max_bytes or end - chunk.end > file.max_bytes:
        raise DamageError("no chunk at the expected position")
    data = file.read(chunk.end, end - chunk.end)
    seen: Counter[int] = Counter()
    for record in records(data):
        if record.op != INDEX:
            continue
        number, content = record.number(b"conn"), data[record.data : record.end]
        if record.number(b"ver") != _INDEX_VERSION or len(content) % _ENTRY.itemsize:
            raise DamageError("message index is damaged")
        entries = np.frombuffer(content, _ENTRY)
        found = np.empty((4, len(entries)), np.int64)
        found[0], found[2] = number, position
        found[1] = entries["sec"].astype(np.int64) * 1_000_000_000 + entries["nanosec"]
        found[3] = entries["offset"]
        if len(entries) and found[3].max() > size - PAYLOAD_OFFSET:
            raise DamageError("message index points beyond its chunk")
        seen[number] += len(entries)
        yield found
    if +seen != +Counter(counts):
        raise DamageError("message indexes contradict the index of the chunks")
