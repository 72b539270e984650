"""Own index of an MCAP file: time and position of each message, without reading messages.

The summary at the end of the file has the channels, the number of messages, and the positions of
the chunks and of the message indexes that follow each chunk. Summary and indexes are checked here
against each other, and later against each message when it is read.
"""

import struct
from array import array
from collections.abc import Sequence
from io import BytesIO
from typing import NamedTuple

import deflate
import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Statistics
from numpy.lib.stride_tricks import sliding_window_view

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

_FOOTER = struct.Struct("<BQQQI")
INDEX_HEAD = struct.Struct("<HI")
"""Channel of a message index, and size of its entries [byte]."""
INDEX_ENTRY_BYTES = 16
"""Size of an entry: log time and offset in the chunk."""
_INDEX_RECORD = np.dtype([("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("size", "<u4")])
"""Start of a message index record, up to its entries."""
_PADDING = bytes(INDEX_ENTRY_BYTES)
"""Bytes after the message indexes, so that the data can be viewed even if there are no entries."""
_INDEX_PLACE = np.dtype([("channel", "<u2"), ("position", "<u8")])
"""Entry of a chunk index: position of the message index of a channel in the file [byte]."""
_CHUNK_BEGIN, _CHUNK_MIDDLE = struct.Struct("<QQQQI"), struct.Struct("<QI")
_CHUNK_END = struct.Struct("<QQ")
"""Fields of a chunk index. Between these three parts are the positions of the message indexes and
the name of the compression."""


class ChunkIndexes(NamedTuple):
    """Chunk indexes of a summary, ``(N,)`` uint64 each; their values are not checked."""

    start_ns: np.ndarray
    """Log time of the first message [ns]."""
    end_ns: np.ndarray
    """Log time of the last message [ns]."""
    position: np.ndarray
    """Position of the chunk's record in the file [byte]."""
    length: np.ndarray
    """Size of the record [byte]."""
    num_indexes: np.ndarray
    """Number of message indexes."""
    index_bytes: np.ndarray
    """Size of the message indexes, which follow the chunk [byte]."""
    packed_size: np.ndarray
    """Size of the compressed records [byte]."""
    size: np.ndarray
    """Size of the decompressed records [byte]."""
    places: np.ndarray
    """Channels and positions of the message indexes of all chunks, see ``_INDEX_PLACE``."""


class Summary(NamedTuple):
    """Summary of a file."""

    crc_is_right: bool
    """Whether the CRC is correct; also True if there is none."""
    declared: Declarations
    """Schemas and channels."""
    statistics: Statistics | None
    chunks: ChunkIndexes


def read_summary(file: LogFile, at: int | None = None) -> Summary:
    """Read the summary of a file.

    Args:
        file: File.
        at: Start of the summary [byte]; default: from the footer. If set, the CRC must be right.

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
        return _parse(data, right)
    except DamageError:
        raise
    except Exception as error:  # mcap's reader may raise any exception
        raise DamageError("summary is damaged") from error


def _parse(data: bytes, crc_is_right: bool) -> Summary:
    declared, statistics = Declarations(), None
    rows, places = array("Q"), bytearray()
    place = odd = count = 0
    while place < len(data):
        opcode, length = RECORD_HEAD.unpack_from(data, place)
        place += RECORD_HEAD.size
        end = place + length
        if end > len(data):
            raise DamageError("record extends beyond the summary")
        if opcode == Opcode.CHUNK_INDEX:
            *begin, size = _CHUNK_BEGIN.unpack_from(data, place)
            after = place + _CHUNK_BEGIN.size + size
            index_bytes, name_size = _CHUNK_MIDDLE.unpack_from(data, after)
            sizes = after + _CHUNK_MIDDLE.size + name_size
            if size % _INDEX_PLACE.itemsize or sizes + _CHUNK_END.size > end:
                raise DamageError("chunk index is damaged")
            places += data[after - size : after]
            num_indexes, last = size // _INDEX_PLACE.itemsize, _CHUNK_END.unpack_from(data, sizes)
            rows.extend((*begin, num_indexes, index_bytes, *last))
            place = end
            continue
        odd += not length or not Opcode.SCHEMA <= opcode <= Opcode.SUMMARY_OFFSET
        count += opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS)
        if odd > MAX_ODD_RECORDS or count > MAX_DECLARATIONS:
            raise DamageError("summary has invalid records, or too many")
        content = data[place:end]
        if opcode == Opcode.SCHEMA:
            declared.add_schema(content)
        elif opcode == Opcode.CHANNEL:
            declared.add_channel(content)
        elif opcode == Opcode.STATISTICS:
            statistics = Statistics.read(ReadDataStream(BytesIO(content)))
        place = end
    columns = np.frombuffer(rows, np.uint64).reshape(-1, 8).T
    chunks = ChunkIndexes(*columns, places=np.frombuffer(places, _INDEX_PLACE))
    return Summary(crc_is_right, declared, statistics, chunks)


def read_mcap_index(file: LogFile) -> FileIndex:
    """Read the index of a file from its summary and its message indexes.

    Raises:
        DamageError: A part is missing, or the message indexes contradict the summary.
    """
    summary = read_summary(file)
    if not summary.crc_is_right:
        raise DamageError("summary has a wrong CRC")
    statistics = summary.statistics
    if statistics is None or statistics.chunk_count != len(summary.chunks.position):
        raise DamageError("summary has no statistics that fit its chunks")
    chunks = _checked(file, summary.chunks)
    num_chunks, index_bytes = len(chunks.position), int(chunks.index_bytes.sum())
    file.check_messages(index_bytes // INDEX_ENTRY_BYTES + len(chunks.places) + num_chunks)
    crcs, indexes = 0, []
    rows = zip(*(column.tolist() for column in chunks[:-1]), strict=True)
    for start_ns, end_ns, position, length, _, size_of_indexes, packed_size, size in rows:
        begin = file.read(position, min(RECORD_HEAD.size + HEAD_BYTES, length))
        record = RECORD_HEAD.unpack_from(begin)
        head = read_chunk_head(begin[RECORD_HEAD.size :], record[1])
        about = head.start_ns, head.end_ns, head.data_size, head.uncompressed_size
        is_right = record == (Opcode.CHUNK, length - RECORD_HEAD.size)
        if not is_right or about != (start_ns, end_ns, packed_size, size):
            raise DamageError("chunk contradicts its index")
        crcs += head.crc != 0
        indexes.append(file.read(position + length, size_of_indexes))
    messages = _indexed_messages(chunks, indexes)
    about = FileIntegrity(file.path, chunks=num_chunks, chunks_with_crc=crcs, by_index=True)
    infos = {key: summary.declared.info(key) for key in summary.declared.channels}
    known = file_index({key: info for key, info in infos.items() if info}, messages, about)
    counts = {key: count for key, count in statistics.channel_message_counts.items() if count}
    if counts != {key: item.messages for key, item in known.counts.items()}:
        raise DamageError("message indexes contradict the statistics")
    if sum(counts.values()) != statistics.message_count:
        raise DamageError("statistics contradict themselves")
    return known


def _checked(file: LogFile, chunks: ChunkIndexes) -> ChunkIndexes:
    """Return chunk indexes as int64, after a check that the file has room for what they describe.

    Raises:
        DamageError: A value is out of range, or chunks overlap.
    """
    for sizes in (chunks.position, chunks.length, chunks.index_bytes, chunks.packed_size):
        if (sizes > file.size).any():
            raise DamageError("chunk index points beyond the end of the file")
    if (chunks.length < RECORD_HEAD.size).any():
        raise DamageError("chunk index is damaged")
    file.check_size(int(chunks.size.max(initial=0)))
    file.check_size(int(chunks.index_bytes.max(initial=0)), "message index")
    if not ((chunks.start_ns <= chunks.end_ns) & (chunks.end_ns <= MAX_TIME_NS)).all():
        raise DamageError("chunk ends before it begins")
    found = ChunkIndexes(*(part.astype(np.int64) for part in chunks[:-1]), places=chunks.places)
    order = np.argsort(found.position)
    ends = (found.position + found.length + found.index_bytes)[order]
    if (np.append(found.position[order], file.size)[1:] < ends).any():
        raise DamageError("chunks overlap")
    return found


def _indexed_messages(chunks: ChunkIndexes, contents: Sequence[bytes]) -> np.ndarray:
    """Return the messages as :func:`jaxdet.io.file_index.file_index` takes them, ``(4, N)``.

    Args:
        chunks: Chunks of the file.
        contents: Message indexes of each chunk.

    Raises:
        DamageError: A message index is damaged, or points beyond its chunk.
    """
    data = np.frombuffer(b"".join([*contents, _PADDING]), np.uint8)
    owner = np.repeat(np.arange(len(chunks.position)), chunks.num_indexes)
    stop, indexes = np.cumsum(chunks.index_bytes)[owner], chunks.position + chunks.length
    place = np.minimum(chunks.places["position"], MAX_TIME_NS).astype(np.int64) - indexes[owner]
    left = chunks.index_bytes[owner] - place
    if (place < 0).any() or (left < _INDEX_RECORD.itemsize).any():
        raise DamageError("message index does not follow its chunk")
    record = stop - left
    heads = sliding_window_view(data, _INDEX_RECORD.itemsize)[record].view(_INDEX_RECORD)[:, 0]
    size, entry = heads["size"].astype(np.int64), record + _INDEX_RECORD.itemsize
    is_right = (heads["opcode"] == Opcode.MESSAGE_INDEX) & (size % INDEX_ENTRY_BYTES == 0)
    is_right &= (heads["length"] == INDEX_HEAD.size + size) & (entry + size <= stop)
    is_right &= heads["channel"] == chunks.places["channel"]
    if not is_right.all() or size.sum() > len(data):
        raise DamageError("message index is damaged")
    count = size // INDEX_ENTRY_BYTES
    entry = np.repeat(entry - INDEX_ENTRY_BYTES * (np.cumsum(count) - count), count)
    entry += INDEX_ENTRY_BYTES * np.arange(len(entry))
    values = sliding_window_view(data, INDEX_ENTRY_BYTES)[entry].view("<u8")
    if (values > MAX_TIME_NS).any():
        raise DamageError("message index is damaged")
    log_ns, offset = values.astype(np.int64).T
    owner = np.repeat(owner, count)
    is_right = (log_ns >= chunks.start_ns[owner]) & (log_ns <= chunks.end_ns[owner])
    if not (is_right & (offset <= chunks.size[owner] - PAYLOAD_OFFSET)).all():
        raise DamageError("message index points beyond its chunk")
    channel = np.repeat(heads["channel"].astype(np.int64), count)
    return np.stack([channel, log_ns, chunks.position[owner] + RECORD_HEAD.size, offset])
