"""Own index of an MCAP file: time and position of each message, without reading messages.

The file is walked from record to record by their heads. Each chunk is followed by its message
indexes, so chunks are skipped; the summary at the end of the file has the channels and the number
of messages. The message indexes are checked against the summary here, and against each message when
it is read.
"""

import struct
from array import array
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from io import BytesIO
from typing import NamedTuple

import deflate
import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Statistics

from jaxdet.io.chunks import (
    HEAD_BYTES,
    MAGIC,
    MAX_TIME_NS,
    PAYLOAD_OFFSET,
    RECORD_HEAD,
    DamageError,
    read_chunk_head,
)
from jaxdet.io.container import LogFile
from jaxdet.io.declarations import Declarations
from jaxdet.io.file_index import FileIndex, FileIntegrity, file_index
from jaxdet.io.limits import MAX_DECLARATIONS, MAX_ODD_RECORDS

TORN = 0
"""Opcode for parts of the file that are not records."""
_KNOWN, _LAST = {*Opcode}, {Opcode.DATA_END, Opcode.FOOTER}
"""Record types of the specification, and those that end the data. Opcodes of 128 and more are
reserved for applications."""
_FOOTER = struct.Struct("<BQQQI")
INDEX_HEAD = struct.Struct("<HI")
"""Channel of a message index, and size of its entries [byte]."""
INDEX_ENTRY_BYTES = 16
"""Size of an entry: log time and offset in the chunk."""
_CHUNK_BEGIN, _CHUNK_NAME = struct.Struct("<QQQ8xI"), struct.Struct("<8xI")
_CHUNK_SIZES = struct.Struct("<QQ")
"""Fields of a chunk index that are read: log times, position, and the size of the positions of its
message indexes, which follow; the size of the name of the compression, which follows; sizes of the
compressed and the decompressed records."""
_ODD_BYTES = 64
"""Size below which records of unknown types count as odd, see ``MAX_ODD_RECORDS``."""
_UNCHECKED_BYTES = 1 << 20
"""Size of message indexes after which their number is checked again."""
_AHEAD_BYTES = 384
"""Minimum size of a read: usually message indexes, and the head of the next chunk."""


class ChunkIndexes(NamedTuple):
    """Chunk indexes of a summary, ``(N,)`` uint64 each; their values are not checked."""

    start_ns: np.ndarray
    """Log time of the first message [ns]."""
    end_ns: np.ndarray
    """Log time of the last message [ns]."""
    position: np.ndarray
    """Position of the chunk's record in the file [byte]."""
    packed_size: np.ndarray
    """Size of the compressed records [byte]."""
    size: np.ndarray
    """Size of the decompressed records [byte]."""


class Summary(NamedTuple):
    """Summary of a file."""

    crc_is_right: bool
    """Whether the CRC is correct; also True if there is none."""
    declared: Declarations
    """Schemas and channels."""
    statistics: Statistics | None
    chunks: ChunkIndexes


class FileRecord(NamedTuple):
    """A record in the data section of a file."""

    opcode: int
    """Opcode, or ``TORN`` for a part that can't be parsed."""
    position: int
    """Position of the content in the file [byte]."""
    length: int
    """Declared length of the content [byte]."""


class FileRecords:
    """Records of the data section of a file.

    Args:
        file: File.
    """

    def __init__(self, file: LogFile) -> None:
        self._file = file
        self._start = self._end = 0
        self._ahead = b""

    def read(self, position: int, size: int) -> bytes:
        """Return bytes of the file; further bytes are read with them, for the next calls.

        Raises:
            DamageError: The file ends earlier, or is unreadable there.
        """
        if position < self._start or position + size > self._end:
            most = max(size, min(_AHEAD_BYTES, self._file.size - position))
            self._ahead = self._file.read(position, most)
            self._start, self._end = position, position + most
        offset = position - self._start
        return self._ahead[offset : offset + size]

    def walk(
        self, restarts: Sequence[int] | np.ndarray = (), position: int = len(MAGIC)
    ) -> Iterator[FileRecord]:
        """Yield the records from a position up to the end of the data or of the summary.

        A part that can't be parsed is a ``TORN`` record; it ends at the next position in
        ``restarts`` (sorted), or at the end of the file.
        """
        odd = 0
        while True:
            start, content = position, position + RECORD_HEAD.size
            try:
                opcode, length = RECORD_HEAD.unpack(self.read(start, RECORD_HEAD.size))
            except DamageError:
                opcode, length = TORN, 0
            position = content + length
            odd += length == 0 or (opcode >= 0x80 and length < _ODD_BYTES)
            is_known = opcode in _KNOWN or opcode >= 0x80
            if is_known and position <= self._file.size and odd <= MAX_ODD_RECORDS:
                yield FileRecord(opcode, content, length)
                odd = 0 if opcode in (Opcode.CHUNK, Opcode.MESSAGE) else odd
                if opcode in _LAST:
                    return
                continue
            after = bisect_right(restarts, start)
            position, odd = int(restarts[after]) if after < len(restarts) else self._file.size, 0
            yield FileRecord(TORN, start, position - start)
            if after == len(restarts):
                return


def read_summary(file: LogFile, at: int | None = None, end: int | None = None) -> Summary:
    """Read the summary of a file.

    Args:
        file: File.
        at: Start of the summary [byte]; default: from the footer. If set, the CRC must be right.
        end: End of the recording [byte]; default: end of the file.

    Raises:
        DamageError: The file has no summary, or it can't be parsed.
    """
    after = (file.size if end is None else end) - len(MAGIC)
    place = after - _FOOTER.size
    if place < len(MAGIC) or file.read(after, len(MAGIC)) != MAGIC:
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
        return _parse(data, right)
    except DamageError:
        raise
    except Exception as error:  # mcap's reader may raise any exception
        raise DamageError("summary is damaged") from error


def _parse(data: bytes, crc_is_right: bool) -> Summary:
    declared, statistics, rows = Declarations(), None, array("Q")
    place = odd = count = 0
    while place < len(data):
        opcode, length = RECORD_HEAD.unpack_from(data, place)
        place += RECORD_HEAD.size
        end = place + length
        if end > len(data):
            raise DamageError("record extends beyond the summary")
        odd += not length or not Opcode.SCHEMA <= opcode <= Opcode.SUMMARY_OFFSET
        count += opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS)
        if odd > MAX_ODD_RECORDS or count > MAX_DECLARATIONS:
            raise DamageError("summary has invalid records, or too many")
        if opcode == Opcode.CHUNK_INDEX:
            *begin, size = _CHUNK_BEGIN.unpack_from(data, place)
            after = place + _CHUNK_BEGIN.size + size
            (name_size,) = _CHUNK_NAME.unpack_from(data, after)
            after += _CHUNK_NAME.size + name_size
            if after + _CHUNK_SIZES.size > end:
                raise DamageError("chunk index is damaged")
            rows.extend((*begin, *_CHUNK_SIZES.unpack_from(data, after)))
        elif opcode == Opcode.SCHEMA:
            declared.add_schema(data[place:end])
        elif opcode == Opcode.CHANNEL:
            declared.add_channel(data[place:end])
        elif opcode == Opcode.STATISTICS:
            statistics = Statistics.read(ReadDataStream(BytesIO(data[place:end])))
        place = end
    columns = np.frombuffer(rows, np.uint64).reshape(-1, len(ChunkIndexes._fields)).T
    return Summary(crc_is_right, declared, statistics, ChunkIndexes(*columns))


class _Chunk(NamedTuple):
    """A chunk in the file."""

    position: int
    """Position of the record's content [byte]."""
    size: int
    """Size of the decompressed records [byte]."""
    start_ns: int
    end_ns: int
    has_crc: bool


def read_mcap_index(file: LogFile) -> FileIndex:
    """Read the index of a file from its message indexes and its summary.

    Raises:
        DamageError: A part is missing, or the message indexes contradict the summary.
    """
    summary = read_summary(file)
    if not summary.crc_is_right:
        raise DamageError("summary has a wrong CRC")
    records, chunks, size, checked_size = FileRecords(file), list[_Chunk](), 0, 0
    owners, indexes = list[int](), list[bytes]()
    for opcode, position, length in records.walk():
        if opcode == Opcode.MESSAGE_INDEX:
            file.check_size(length, "message index")
            if length == INDEX_HEAD.size:  # it names no message
                continue
            owners.append(len(chunks) - 1)
            indexes.append(records.read(position, length))
            size += length
            if size > checked_size + _UNCHECKED_BYTES:
                file.check_messages(size // INDEX_ENTRY_BYTES + len(owners) + len(chunks))
                checked_size = size
        elif opcode == Opcode.CHUNK:
            head = read_chunk_head(records.read(position, min(length, HEAD_BYTES)), length)
            file.check_size(head.uncompressed_size)
            if not head.start_ns <= head.end_ns <= MAX_TIME_NS:
                raise DamageError("chunk ends before it begins")
            about = head.uncompressed_size, head.start_ns, head.end_ns, head.crc != 0
            chunks.append(_Chunk(position, *about))
        elif opcode in (TORN, Opcode.MESSAGE):
            raise DamageError("a record is damaged, or a message is outside of chunks")
    file.check_messages(size // INDEX_ENTRY_BYTES)
    messages = _indexed_messages(chunks, np.array(owners, np.int64), indexes)
    crcs = sum(chunk.has_crc for chunk in chunks)
    about = FileIntegrity(file.path, chunks=len(chunks), chunks_with_crc=crcs, by_index=True)
    infos = {key: summary.declared.info(key) for key in summary.declared.channels}
    known = file_index({key: info for key, info in infos.items() if info}, messages, about)
    _check_counts(summary.statistics, len(chunks), known)
    return known


def _indexed_messages(
    chunks: Sequence[_Chunk], owners: np.ndarray, contents: Sequence[bytes]
) -> np.ndarray:
    """Return the input of :func:`jaxdet.io.file_index.file_index`.

    Args:
        chunks: Chunks of the file.
        owners: Number of the chunk of each message index, ``(T,)`` int64.
        contents: Contents of the message index records.

    Raises:
        DamageError: A message index is damaged, or points beyond its chunk.
    """
    heads = b"".join(content[: INDEX_HEAD.size] for content in contents)
    entries = b"".join(content[INDEX_HEAD.size :] for content in contents)
    size = np.array([len(content) - INDEX_HEAD.size for content in contents], np.int64)
    if (owners < 0).any() or (size < 0).any() or (size % INDEX_ENTRY_BYTES).any():
        raise DamageError("message index is damaged")
    head, values = np.frombuffer(heads, "<u2, <u4"), np.frombuffer(entries, "<u8")
    if (head["f1"] != size).any() or (values > MAX_TIME_NS).any():
        raise DamageError("message index is damaged")
    count, channel = size // INDEX_ENTRY_BYTES, head["f0"].astype(np.int64)
    log_ns, offset = values.astype(np.int64).reshape(-1, 2).T
    columns = np.array(chunks, np.int64).reshape(-1, len(_Chunk._fields)).T
    position, most, start, end, _ = columns[:, np.repeat(owners, count)]
    if not ((log_ns >= start) & (log_ns <= end) & (offset <= most - PAYLOAD_OFFSET)).all():
        raise DamageError("message index points beyond its chunk")
    return np.stack([np.repeat(channel, count), log_ns, position, offset])


def _check_counts(statistics: Statistics | None, num_chunks: int, found: FileIndex) -> None:
    """Check that the numbers of chunks and of messages per channel equal the statistics."""
    if statistics is None or statistics.chunk_count != num_chunks:
        raise DamageError("summary has no statistics that fit its chunks")
    declared = {key: count for key, count in statistics.channel_message_counts.items() if count}
    if declared != {key: item.messages for key, item in found.counts.items()}:
        raise DamageError("message indexes contradict the statistics")
    if sum(declared.values()) != statistics.message_count:
        raise DamageError("statistics contradict themselves")
