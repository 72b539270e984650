"""Own index of an MCAP file: time and position of each message, without reading messages.

The summary at the end of the file lists channels, counts and chunks; each chunk is followed by its
message indexes. Both are parsed with array operations: a file of 100 GB has 100,000 chunks, and the
indexes of a million messages take a fraction of a second. The message indexes are checked against
the summary here, and against each message when it is read.
"""

import struct
from collections.abc import Iterator
from io import BytesIO
from typing import NamedTuple

import deflate
import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Statistics

from jaxdet.io.chunks import MAGIC, PAYLOAD_OFFSET, RECORD_HEAD, DamageError
from jaxdet.io.container import LogFile
from jaxdet.io.declarations import Declarations
from jaxdet.io.file_index import (
    ChannelCount,
    FileIndex,
    FileIntegrity,
    file_index,
    useful_channels,
)
from jaxdet.io.limits import MAX_DECLARATIONS, MAX_ODD_RECORDS

_FOOTER = struct.Struct("<BQQQI")
_CHUNK_INDEX_BYTES = 36 + 8 + 4 + 16
"""Size of a chunk index without channels and compression name."""
_OFFSET_BYTES = 10
"""Size of a channel in a chunk index: its number and the offset of its message index."""
_HEAD_BYTES = RECORD_HEAD.size + 6
"""Size of a message index before its entries: record head, channel, length."""
_ENTRY_BYTES = 16
"""Size of an entry: log time and offset in the chunk."""
_PART_BYTES = 32 << 20
"""Maximum size of the message indexes in memory at once."""


class ChunkTable(NamedTuple):
    """Chunks listed in the summary, ``(C,)`` int64 each, in file order."""

    start: np.ndarray
    """Start of the chunk's record in the file [byte]."""
    length: np.ndarray
    """Length of the complete record [byte]."""
    index_length: np.ndarray
    """Length of the message indexes that follow the chunk [byte]."""
    stored: np.ndarray
    """Size of the data in the file [byte]."""
    size: np.ndarray
    """Size of the decompressed records [byte]."""
    first_ns: np.ndarray
    """Log time of the first message [ns]."""
    last_ns: np.ndarray
    """Log time of the last message [ns]."""


class IndexOffsets(NamedTuple):
    """Positions of the message indexes, one per channel of a chunk, ``(T,)`` int64 each."""

    chunk: np.ndarray
    """Number of the chunk."""
    channel: np.ndarray
    position: np.ndarray
    """Position of the record in the file [byte]."""


class Summary(NamedTuple):
    """Summary of a file."""

    start: int
    """Start of the summary in the file [byte]."""
    crc_is_right: bool
    """Whether the CRC is correct; also True if there is none."""
    declared: Declarations
    """Schemas and channels."""
    statistics: Statistics | None
    chunks: ChunkTable
    offsets: IndexOffsets


def read_summary(file: LogFile, at: int | None = None) -> Summary:
    """Read the summary of a file.

    Args:
        file: File.
        at: Start of the summary; by default from the footer. If set, the CRC must be correct.

    Raises:
        DamageError: The file has no summary, or it can't be parsed.
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
    except Exception as error:  # mcap's reader may raise any exception
        raise DamageError("summary is damaged") from error


class FileBytes:
    """Little-endian integers at any positions of a buffer, as arrays."""

    def __init__(self, data: bytes | bytearray | memoryview) -> None:
        self.size = len(data)
        padded = np.zeros(self.size + 8, np.uint8)
        padded[: self.size] = np.frombuffer(data, np.uint8)
        self._views = {
            kind: np.ndarray((self.size + 1,), kind, padded, strides=(1,))
            for kind in ("<u1", "<u2", "<u4", "<u8")
        }

    def at(self, position: np.ndarray, kind: str) -> np.ndarray:
        """Return the integers of a type (``<u1`` to ``<u8``) at the given positions, int64.

        Raises:
            DamageError: A position is outside of the buffer, or a number exceeds int64.
        """
        if len(position) and not (position.min() >= 0 and position.max() < self.size):
            raise DamageError("index extends beyond its record")
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
            raise DamageError("record extends beyond the summary")
        odd += not length or not Opcode.SCHEMA <= opcode <= Opcode.SUMMARY_OFFSET
        count += opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS)
        if odd > MAX_ODD_RECORDS or count > MAX_DECLARATIONS:
            raise DamageError("summary has invalid records, or too many")
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


class _Records(NamedTuple):
    """Message indexes, one per channel of a chunk, ``(T,)`` int64 each."""

    messages: np.ndarray
    """Number of messages."""
    first: np.ndarray
    """Log time of the first or the last message, whichever is earlier [ns]."""
    last: np.ndarray
    """Log time of the first or the last message, whichever is later [ns]."""


def read_mcap_index(file: LogFile) -> FileIndex:
    """Read the index of a file from its summary and message indexes.

    Raises:
        DamageError: A part is missing, or the indexes contradict the summary.
    """
    summary = read_summary(file)
    _check(file, summary)
    chunks, offsets = summary.chunks, summary.offsets
    infos = {key: summary.declared.info(key) for key in summary.declared.channels}
    infos = {key: info for key, info in infos.items() if info is not None}
    wanted = np.isin(offsets.channel, useful_channels(infos))
    records, found = [], [(np.zeros(0, np.int64),) * 4]
    for part, data, base in _parts(file, summary):
        chunk, channel = offsets.chunk[part], offsets.channel[part]
        position = offsets.position[part] - (chunks.start + chunks.length)[chunk]
        entries, size = _entries(data, position, base, channel, chunks.index_length[chunk])
        count = size // _ENTRY_BYTES
        some, first, last = np.flatnonzero(count), np.zeros_like(count), np.zeros_like(count)
        ends = data.at(entries[some], "<u8"), data.at((entries + size)[some] - 16, "<u8")
        first[some], last[some] = np.minimum(*ends), np.maximum(*ends)
        records.append(_Records(count, first, last))
        which = np.flatnonzero(wanted[part])
        each = np.repeat(which, count[which])
        before = np.cumsum(count[which]) - count[which]
        within = np.arange(len(each)) - np.repeat(before, count[which])
        entry = entries[each] + _ENTRY_BYTES * within
        log_ns, offset = data.at(entry, "<u8"), data.at(entry + 8, "<u8")
        found.append((channel[each], log_ns, chunk[each], offset))
    counts = _counts(offsets.channel, records)
    _check_counts(summary, counts)
    channel, log_ns, chunk, offset = map(np.concatenate, zip(*found, strict=True))
    inside = (log_ns >= chunks.first_ns[chunk]) & (log_ns <= chunks.last_ns[chunk])
    inside &= offset <= chunks.size[chunk] - PAYLOAD_OFFSET
    if not inside.all():
        raise DamageError("message index points beyond its chunk")
    place, length = chunks.start + RECORD_HEAD.size, chunks.length - RECORD_HEAD.size
    messages = np.stack([channel, log_ns, place[chunk], length[chunk], offset])
    checked = len(place) if len(place) and file.chunk_head(int(place[0])).crc else 0
    known = FileIntegrity(file.path, chunks=len(place), chunks_with_crc=checked, by_index=True)
    return file_index(infos, messages, known, counts)


def _check(file: LogFile, summary: Summary) -> None:
    """Check that the summary is complete and matches the file."""
    statistics, chunks = summary.statistics, summary.chunks
    if not summary.crc_is_right:
        raise DamageError("summary has a wrong CRC")
    if statistics is None or statistics.chunk_count != len(chunks.start):
        raise DamageError("summary has no statistics that fit its chunks")
    columns = chunks.start, chunks.length, chunks.index_length, chunks.stored
    if any((column > file.size).any() for column in (*columns, summary.offsets.position)):
        raise DamageError("index points beyond the end of the file")
    beyond = np.append(chunks.start[1:], summary.start)
    end = chunks.start + chunks.length + chunks.index_length
    if (end > beyond).any() or (chunks.stored > chunks.length).any():
        raise DamageError("chunks overlap")
    file.check_size(int(chunks.size.max(initial=0)))
    if (chunks.first_ns > chunks.last_ns).any():
        raise DamageError("chunk ends before it begins")
    file.check_messages(int(chunks.index_length.sum()) // _ENTRY_BYTES)


def _check_counts(summary: Summary, counts: dict[int, ChannelCount]) -> None:
    """Check that the number of messages per channel equals the statistics."""
    statistics = summary.statistics
    assert statistics is not None
    declared = {key: count for key, count in statistics.channel_message_counts.items() if count}
    if declared != {key: item.messages for key, item in counts.items()}:
        raise DamageError("message indexes contradict the statistics")
    if sum(declared.values()) != statistics.message_count:
        raise DamageError("statistics contradict themselves")


def _entries(
    data: FileBytes,
    position: np.ndarray,
    base: np.ndarray,
    channel: np.ndarray,
    length: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Locate and check message indexes; return the position and the size of their entries.

    Args:
        data: Message indexes of some chunks.
        position: Position of each index relative to the first index of its chunk.
        base: Position in ``data`` of the first index of its chunk.
        channel: Expected channel of each index.
        length: Total length of the indexes of its chunk.
    """
    if (position < 0).any() or (position + _HEAD_BYTES > length).any():
        raise DamageError("message index is not at the expected position")
    place = position + base
    size = data.at(place + _HEAD_BYTES - 4, "<u4")
    whole = data.at(place, "<u1") == Opcode.MESSAGE_INDEX
    whole &= data.at(place + 1, "<u8") == size + 6
    whole &= data.at(place + RECORD_HEAD.size, "<u2") == channel
    whole &= (position + _HEAD_BYTES + size <= length) & (size % _ENTRY_BYTES == 0)
    if not whole.all():
        raise DamageError("message index is damaged")
    return place + _HEAD_BYTES, size


def _parts(file: LogFile, summary: Summary) -> Iterator[tuple[slice, FileBytes, np.ndarray]]:
    """Yield slices of ``IndexOffsets``, their bytes, and where the indexes of each chunk start."""
    chunks, offsets = summary.chunks, summary.offsets
    total = np.append(0, np.cumsum(chunks.index_length))
    first = 0
    while first < len(chunks.start):
        last = int(np.searchsorted(total, total[first] + _PART_BYTES, "right")) - 1
        last = min(max(last, first + 1), len(chunks.start))
        size = int(total[last] - total[first])
        if size > max(file.max_bytes, _PART_BYTES):
            raise DamageError("message index is too large")
        data = bytearray(size)
        view = memoryview(data)
        begin = (total[first : last + 1] - total[first]).tolist()
        ends = (chunks.start + chunks.length)[first:last].tolist()
        for place, left, right in zip(ends, begin, begin[1:], strict=False):
            file.read_into(place, [view[left:right]])
        start, stop = np.searchsorted(offsets.chunk, [first, last]).tolist()
        base = np.array(begin, np.int64)[offsets.chunk[start:stop] - first]
        yield slice(start, stop), FileBytes(data), base
        first = last


def _counts(channel: np.ndarray, records: list[_Records]) -> dict[int, ChannelCount]:
    if not records:
        return {}
    count, first, last = map(np.concatenate, zip(*records, strict=True))
    known = {}
    for number in np.unique(channel[count > 0]).tolist():
        mine = (channel == number) & (count > 0)
        span = int(first[mine].min()), int(last[mine].max())
        known[number] = ChannelCount(int(count[mine].sum()), *span)
    return known
