"""ROS 1's bags, version 2.0: their records, and chunks as MCAP has them.

A record is a head of named fields and data, each with its length before it. A chunk holds
connections and messages; at the file's end are all connections and the places of the chunks.
The index of a chunk follows it. Source: the ROS wiki's page "Bags/Format/2.0".

A message's head takes more bytes in a bag (46) than in MCAP (31). So a chunk as MCAP has it is as
long as the bag's, and every message begins where the bag's index says; between them is padding.
"""

import bz2
import struct
from collections.abc import Iterator
from pathlib import Path
from threading import Lock
from typing import NamedTuple

import lz4.frame
from mcap.opcode import Opcode

from jaxdet.io.chunks import MESSAGE_HEAD, PAYLOAD_OFFSET, RECORD_HEAD, ChunkHead, DamageError
from jaxdet.io.container import FileState, LogFile
from jaxdet.io.declarations import ChannelInfo
from jaxdet.io.limits import MAX_SCHEMA_BYTES, MAX_SCHEMAS_BYTES
from jaxdet.io.messages import kind_of
from jaxdet.io.ros1 import require_rosbags

MESSAGE, BAG, INDEX, CHUNK, CHUNK_INFO, CONNECTION = 2, 3, 4, 5, 6, 7
"""Kinds of records (their field ``op``)."""
MAGIC = b"#ROSBAG V2.0\n"
_LENGTH = struct.Struct("<I")
_PADDING = 0x80
"""Opcode of MCAP's records that programs may use as they like."""
_MAX_HEAD_BYTES = 1 << 16
_FIRST_BYTES = 256
"""Read at once of a record's head."""


class BagRecord(NamedTuple):
    """A record of a bag."""

    op: int
    fields: dict[bytes, bytes]
    start: int
    """Where it begins."""
    data: int
    """Where its data begin."""
    size: int
    """Of its data."""

    @property
    def end(self) -> int:
        """Where the next one begins."""
        return self.data + self.size

    def number(self, name: bytes, size: int = 4) -> int:
        """A field of so many bytes.

        Raises:
            DamageError: It isn't there, or has another size.
        """
        value = self.fields.get(name, b"")
        if len(value) != size:
            raise DamageError("record of the bag is damaged")
        return int.from_bytes(value, "little")


class BagFile(LogFile):
    """A ROS 1 bag; the position of a chunk is where its record begins.

    Attributes:
        connections: What is declared by those records that were read so far. Where several declare
            a number, it is the first of them in the file, whichever thread reads first.
    """

    magic = MAGIC
    kind = "a ROS 1 bag (version 2.0)"

    def __init__(self, path: Path, max_bytes: int, state: FileState | None = None) -> None:
        require_rosbags(path)
        super().__init__(path, max_bytes, state)
        self.connections: dict[int, ChannelInfo] = {}
        self._declared: dict[int, int] = {}
        """The chunk that declares each of them, by its position; -1: the index."""
        self._bytes = 0
        self._declaring = Lock()

    def record(self, position: int, end: int | None = None) -> BagRecord:
        """The record at a position of the file.

        Args:
            position: Where it begins.
            end: Where it must have ended; default: the file's end.

        Raises:
            DamageError: There is none.
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
        """The head of the chunk whose record begins at ``position``; it has no times.

        Raises:
            DamageError: There is none.
        """
        record = self.record(position)
        if record.op != CHUNK:
            raise DamageError("no chunk where one should be")
        name = record.fields.get(b"compression", b"").decode("ascii", "replace")
        place = record.data - position
        size = record.number(b"size")
        return ChunkHead(0, 0, size, 0, f"bag {name}", place, record.size, record.size)

    def chunk(self, position: int) -> memoryview:
        """The chunk at ``position`` with its messages as MCAP's records, each where it was.

        Raises:
            DamageError: It can't be read, or a record overruns it.
        """
        head = self.chunk_head(position)
        self.check_memory(max(head.uncompressed_size, head.data_size))
        data = _decompress(head, self.read(position + head.data_offset, head.data_size))
        found = bytearray(len(data))
        view = memoryview(data)
        for record in records(data):
            start = record.start
            if record.op == CONNECTION:
                self.declare(record, view[record.data : record.end], position)
            elif record.op == MESSAGE:
                number, log_ns = record.number(b"conn"), nanoseconds(record)
                if number > 0xFFFF:
                    raise DamageError("connection number is out of range")
                RECORD_HEAD.pack_into(found, start, Opcode.MESSAGE, MESSAGE_HEAD.size + record.size)
                MESSAGE_HEAD.pack_into(found, start + RECORD_HEAD.size, number, 0, log_ns, log_ns)
                payload = start + PAYLOAD_OFFSET
                start = payload + record.size
                found[payload:start] = view[record.data : record.end]
            RECORD_HEAD.pack_into(found, start, _PADDING, record.end - start - RECORD_HEAD.size)
        return memoryview(found)

    def declare(self, record: BagRecord, data: bytes | memoryview, chunk: int = -1) -> None:
        """Takes in a connection; of one number the first counts.

        Args:
            record: It.
            data: Its data.
            chunk: The position of the chunk that it is in; -1: it is in the index.

        Raises:
            DamageError: It is damaged, or all take too much memory.
        """
        number = record.number(b"conn")
        with self._declaring:
            if self._declared.get(number, chunk + 1) > chunk:
                self._declare(number, record, _fields(data))
                self._declared[number] = chunk

    def connection(self, number: int, chunk: int) -> ChannelInfo | None:
        """That of a message in a chunk, by the position of that; chunks before it have been read.

        None: what declares it comes later, or never.
        """
        there = self._declared.get(number, chunk + 1) <= chunk
        return self.connections[number] if there else None

    def _declare(self, number: int, record: BagRecord, fields: dict[bytes, bytes]) -> None:
        topic = record.fields.get(b"topic", fields.get(b"topic", b"")).decode("utf-8", "replace")
        name = fields.get(b"type", b"").decode("utf-8", "replace")
        text = fields.get(b"message_definition", b"")
        kept = text if kind_of(name) is not None and len(text) <= MAX_SCHEMA_BYTES else b""
        self._bytes += len(topic) + len(name) + len(kept)
        if self._bytes > MAX_SCHEMAS_BYTES:
            raise DamageError("connections take too much memory")
        self.connections[number] = ChannelInfo(topic, "ros1", name, "ros1msg", kept, len(text))


def records(data: bytes) -> Iterator[BagRecord]:
    """The records in some data, such as a decompressed chunk.

    Raises:
        DamageError: One overruns the data.
    """
    position = 0
    while position < len(data):
        record = read_record(data, position)
        if record.end > len(data):
            raise DamageError("record is longer than its chunk")
        yield record
        position = record.end


def read_record(data: bytes, place: int, start: int = 0) -> BagRecord:
    """The record whose head stands at ``place`` in some data, which begin at ``start``.

    Raises:
        DamageError: There is none; whether its data are there isn't looked at.
    """
    try:
        (size,) = _LENGTH.unpack_from(data, place)
        after = place + _LENGTH.size + size
        (data_size,) = _LENGTH.unpack_from(data, after)
    except struct.error as error:
        raise DamageError("record of the bag is damaged") from error
    fields = _fields(memoryview(data)[place + _LENGTH.size : after])
    op = fields.get(b"op", b"")
    if len(op) != 1:
        raise DamageError("record of the bag is damaged")
    return BagRecord(op[0], fields, start + place, start + after + _LENGTH.size, data_size)


def nanoseconds(record: BagRecord) -> int:
    """The log time of a message record [ns].

    Raises:
        DamageError: It has none.
    """
    nanosec, sec = divmod(record.number(b"time", 8), 1 << 32)
    return sec * 1_000_000_000 + nanosec


def _fields(head: bytes | memoryview) -> dict[bytes, bytes]:
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
        raise DamageError("chunk has another size than declared")
    return found
