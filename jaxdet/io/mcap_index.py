"""The message indexes of an MCAP file: when and where each message is, without reading one.

They stand behind each chunk; those of a million messages are parsed in a fraction of a second.
What they say is held against the summary here, and against each message when it is read.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from mcap.opcode import Opcode

from jaxdet.io.chunks import PAYLOAD_OFFSET, RECORD_HEAD, DamageError
from jaxdet.io.container import LogFile
from jaxdet.io.file_index import ChannelCount, FileIndex, FileIntegrity, file_index, useful_channels
from jaxdet.io.mcap_summary import FileBytes, Summary, read_summary

_HEAD_BYTES = RECORD_HEAD.size + 6
"""Of a message index before its entries: record head, channel, length."""
_ENTRY_BYTES = 16
"""Log time and offset in the chunk."""
_PART_BYTES = 32 << 20
"""Of message indexes in memory at once."""


class _Records(NamedTuple):
    """The message indexes themselves, one for each channel of each chunk, ``(T,)`` each."""

    messages: np.ndarray
    """int64, how many."""
    first: np.ndarray
    """int64, log time of the first or last [ns], the smaller one."""
    last: np.ndarray
    """int64, the larger one."""


def read_mcap_index(file: LogFile) -> FileIndex:
    """Return the index of a file by its summary and message indexes.

    Raises:
        DamageError: Something is missing, or the indexes contradict the summary.
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
        raise DamageError("message index leaves its chunk")
    place, length = chunks.start + RECORD_HEAD.size, chunks.length - RECORD_HEAD.size
    messages = np.stack([channel, log_ns, place[chunk], length[chunk], offset])
    checked = len(place) if len(place) and file.chunk_head(int(place[0])).crc else 0
    known = FileIntegrity(file.path, chunks=len(place), chunks_with_crc=checked, by_index=True)
    return file_index(infos, messages, known, counts)


def _check(file: LogFile, summary: Summary) -> None:
    """Check that the summary is complete and fits the file."""
    statistics, chunks = summary.statistics, summary.chunks
    if not summary.crc_is_right:
        raise DamageError("summary has a wrong CRC")
    if statistics is None or statistics.chunk_count != len(chunks.start):
        raise DamageError("summary has no statistics that fit its chunks")
    columns = chunks.start, chunks.length, chunks.index_length, chunks.stored
    if any((column > file.size).any() for column in (*columns, summary.offsets.position)):
        raise DamageError("index leaves the file")
    beyond = np.append(chunks.start[1:], summary.start)
    end = chunks.start + chunks.length + chunks.index_length
    if (end > beyond).any() or (chunks.stored > chunks.length).any():
        raise DamageError("chunks overlap")
    file.check_size(int(chunks.size.max(initial=0)))
    if (chunks.first_ns > chunks.last_ns).any():
        raise DamageError("chunk ends before it begins")
    file.check_messages(int(chunks.index_length.sum()) // _ENTRY_BYTES)


def _check_counts(summary: Summary, counts: dict[int, ChannelCount]) -> None:
    """Check that the numbers of messages of each channel equal the statistics."""
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
    """Return where the entries of message indexes begin in the data, and their bytes.

    Args:
        data: The indexes of some chunks.
        position: Where each begins among those of its chunk.
        base: Where those of its chunk begin in the data.
        channel: What channel it should be of.
        length: Of all indexes of its chunk.
    """
    if (position < 0).any() or (position + _HEAD_BYTES > length).any():
        raise DamageError("message index lies elsewhere")
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
    """Yield ranges of ``IndexOffsets``, their bytes, and where the indexes of a chunk begin."""
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
