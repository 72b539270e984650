"""The summary at the end of an MCAP file: channels, counts, and where its chunks lie.

A summary is parsed with arrays, not record by record: a file of 100 GB has 100,000 chunks.
"""

import struct
from io import BytesIO
from typing import NamedTuple

import deflate
import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Statistics

from jaxdet.io.chunks import MAGIC, RECORD_HEAD, DamageError
from jaxdet.io.container import LogFile
from jaxdet.io.declarations import Declarations
from jaxdet.io.limits import MAX_DECLARATIONS, MAX_ODD_RECORDS

_FOOTER = struct.Struct("<BQQQI")
_CHUNK_INDEX_BYTES = 36 + 8 + 4 + 16
"""Of a chunk index without channels and compression name."""
_OFFSET_BYTES = 10
"""Of a channel in a chunk index: its number and the offset of its message index."""


class ChunkTable(NamedTuple):
    """What the summary says of the chunks, ``(C,)`` each, in file order."""

    start: np.ndarray
    """int64, where the chunk's record begins in the file."""
    length: np.ndarray
    """int64, of the whole record."""
    index_length: np.ndarray
    """int64, of the message indexes that follow it."""
    stored: np.ndarray
    """int64, bytes of its data in the file."""
    size: np.ndarray
    """int64, bytes of its records."""
    first_ns: np.ndarray
    """int64, log time of its first message."""
    last_ns: np.ndarray
    """int64, log time of its last message."""


class IndexOffsets(NamedTuple):
    """Where the message indexes lie, one for each channel of each chunk, ``(T,)`` each."""

    chunk: np.ndarray
    """int64, number of the chunk."""
    channel: np.ndarray
    """int64."""
    position: np.ndarray
    """int64, of the record in the file."""


class Summary(NamedTuple):
    """A file's summary."""

    start: int
    """Where it begins in the file."""
    crc_is_right: bool
    """Or there is none."""
    declared: Declarations
    """Schemas and channels."""
    statistics: Statistics | None
    chunks: ChunkTable
    offsets: IndexOffsets


def read_summary(file: LogFile, at: int | None = None) -> Summary:
    """Return the summary of a file.

    Args:
        file: The file.
        at: Where it begins, whatever the footer says; its CRC must be right then.

    Raises:
        DamageError: It has none, or it can't be parsed.
    """
    place = file.size - len(MAGIC) - _FOOTER.size
    if place < len(MAGIC) or file.read(file.size - len(MAGIC), len(MAGIC)) != MAGIC:
        raise DamageError("no end of file")
    footer = file.read(place, _FOOTER.size)
    opcode, length, start, _, crc = _FOOTER.unpack(footer)
    start = start if at is None else at
    if opcode != Opcode.FOOTER or length != _FOOTER.size - RECORD_HEAD.size:
        raise DamageError("footer is damaged")
    if not start:
        raise DamageError("no summary")
    if not len(MAGIC) < start <= place or place - start > file.max_bytes:
        raise DamageError("summary is not where the footer says")
    data = file.read(start, place - start)
    right = not crc or deflate.crc32(footer[:-4], deflate.crc32(data)) == crc
    if at is not None and not right:
        raise DamageError("summary has a wrong CRC")
    try:
        return _parse(data, start, right)
    except DamageError:
        raise
    except Exception as error:  # mcap's reader raises what it likes
        raise DamageError("summary is damaged") from error


class FileBytes:
    """Little-endian numbers at any position of some bytes, as arrays."""

    def __init__(self, data: bytes | bytearray | memoryview) -> None:
        self.size = len(data)
        padded = np.zeros(self.size + 8, np.uint8)
        padded[: self.size] = np.frombuffer(data, np.uint8)
        self._views = {
            kind: np.ndarray((self.size + 1,), kind, padded, strides=(1,))
            for kind in ("<u1", "<u2", "<u4", "<u8")
        }

    def at(self, position: np.ndarray, kind: str) -> np.ndarray:
        """Return the numbers of a kind (``<u1`` to ``<u8``) at some positions, int64.

        Raises:
            DamageError: A position is outside, or a number beyond int64.
        """
        if len(position) and not (position.min() >= 0 and position.max() < self.size):
            raise DamageError("index leaves its record")
        found = self._views[kind][position]
        if kind == "<u8" and len(found) and found.max() >= 1 << 63:
            raise DamageError("number in the index is out of range")
        return found.astype(np.int64)


def _parse(data: bytes, start: int, crc_is_right: bool) -> Summary:
    declared, statistics, chunks, view = Declarations(), None, [], memoryview(data)
    place = odd = count = 0
    while place < len(data):
        opcode, length = RECORD_HEAD.unpack_from(data, place)
        place += RECORD_HEAD.size
        if place + length > len(data):
            raise DamageError("record leaves the summary")
        odd += not length or not Opcode.SCHEMA <= opcode <= Opcode.SUMMARY_OFFSET
        count += opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS)
        if odd > MAX_ODD_RECORDS or count > MAX_DECLARATIONS:
            raise DamageError("summary holds what is no record, or too many")
        if opcode == Opcode.CHUNK_INDEX:
            chunks.append((place, length))
        elif opcode == Opcode.SCHEMA:
            declared.add_schema(view[place : place + length])
        elif opcode == Opcode.CHANNEL:
            declared.add_channel(view[place : place + length])
        elif opcode == Opcode.STATISTICS:
            statistics = Statistics.read(ReadDataStream(BytesIO(data[place : place + length])))
        place += length
    table, offsets = _chunk_indexes(FileBytes(data), np.array(chunks, np.int64).reshape(-1, 2))
    return Summary(start, crc_is_right, declared, statistics, table, offsets)


def _chunk_indexes(data: FileBytes, records: np.ndarray) -> tuple[ChunkTable, IndexOffsets]:
    place, length = records.T
    if len(length) and length.min() < _CHUNK_INDEX_BYTES:
        raise DamageError("chunk index is too short")
    first, last, start, size = (data.at(place + 8 * i, "<u8") for i in range(4))
    map_bytes = data.at(place + 32, "<u4")
    after_map = place + 36 + map_bytes
    index_length = data.at(after_map, "<u8")
    name_bytes = data.at(after_map + 8, "<u4")
    after_name = after_map + 12 + name_bytes
    stored, unpacked = data.at(after_name, "<u8"), data.at(after_name + 8, "<u8")
    if (after_name + 16 > place + length).any() or (map_bytes % _OFFSET_BYTES).any():
        raise DamageError("chunk index is damaged")
    order = np.argsort(start, kind="stable")
    columns = (start, size, index_length, stored, unpacked, first, last)
    table = ChunkTable(*(column[order] for column in columns))
    count = (map_bytes // _OFFSET_BYTES)[order]
    chunk = np.repeat(np.arange(len(order)), count)
    within = np.arange(len(chunk)) - np.repeat(np.cumsum(count) - count, count)
    entry = (place + 36)[order][chunk] + _OFFSET_BYTES * within
    return table, IndexOffsets(chunk, data.at(entry, "<u2"), data.at(entry + 2, "<u8"))
