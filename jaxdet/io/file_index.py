"""Index of a file: positions of its messages, in the same form for all formats.

The index is read from the file's own index, without reading messages, or rebuilt by a scan of the
complete file (:class:`jaxdet.io.container.Walk`). All readers of messages use these arrays and do
not depend on their source.
"""

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxdet.errors import printable
from jaxdet.io.chunks import MAX_TIME_NS, DamageError
from jaxdet.io.declarations import ChannelInfo
from jaxdet.io.messages import kind_of

MAX_CHANNEL = 0xFFFF


class FileIntegrity(NamedTuple):
    """Result of a file's integrity check: what was read, and what was lost."""

    path: Path
    messages: int = 0
    """Number of messages found."""
    declared_messages: int | None = None
    """Number of messages according to the file's statistics; None if it has no statistics."""
    has_end: bool = True
    """Whether the end of the data and the closing magic bytes exist."""
    chunks: int = 0
    chunks_with_crc: int = 0
    lost: Mapping[str, int] = {}
    """Number of rejected records and chunks by reason."""
    lost_bytes: int = 0
    lost_spans_ns: tuple[tuple[int, int], ...] = ()
    """First and last log time of rejected and missing chunks, of the first 1000."""
    last_log_time_ns: int = 0
    """Last log time of the messages found."""
    missing: Mapping[str, int] = {}
    """Number of lost messages by topic, according to statistics or message indexes."""
    summary_problem: str = ""
    """Reason why the file has no readable summary; empty if it has one."""
    by_index: bool = False
    """Whether the messages are from the file's own index, not from a scan. In this case a chunk is
    checked only when frames are read from it."""

    @property
    def recovered(self) -> bool:
        """Whether data are missing."""
        declared = self.declared_messages
        counted = declared in (None, self.messages) and not self.missing
        return bool(self.lost) or not self.has_end or not counted

    @property
    def text(self) -> str:
        """Summary in one line."""
        if self.by_index and self.chunks_with_crc:
            return "has an index; the CRC of each chunk is checked when it is read"
        crc = f"CRC checked in {self.chunks_with_crc} of {self.chunks} chunks"
        crc = crc if self.chunks_with_crc else "not checkable (no CRC in file)"
        if self.summary_problem:
            crc += f"; missing messages can't be counted ({self.summary_problem})"
        if not self.recovered:
            return crc
        parts = [f"{self.messages} messages"]
        if self.declared_messages not in (None, self.messages):
            parts[0] += f" of the {self.declared_messages} declared"
        if self.lost:
            reasons = ", ".join(f"{reason} ({count})" for reason, count in self.lost.items())
            parts.append(f"{self.lost_bytes} bytes lost: {reasons}")
        for topic, count in [*self.missing.items()][:8]:
            parts.append(f"{count} messages of {printable(topic)} missing")
        for start, end in self.lost_spans_ns[:3]:
            parts.append(f"log time {_utc(start)} to {_utc(end)} lost")
        if not self.has_end:
            upto = f"; data up to {_utc(self.last_log_time_ns)}" if self.messages else ""
            parts.append(f"no end of file{upto}")
        parts.append(crc)
        return "recovered: " + "; ".join(parts)


class ChannelCount(NamedTuple):
    """Number and time range of the messages of a channel."""

    messages: int
    first_ns: int
    last_ns: int


class Place(NamedTuple):
    """Identifier of a chunk in a log."""

    file: int
    """Number of the file."""
    position: int
    """Position of the chunk, see :meth:`jaxdet.io.container.LogFile.chunk_head`."""


class IndexedMessages(NamedTuple):
    """Positions of messages, ``(N,)`` int64 each."""

    channel: np.ndarray
    """Id of the channel in the file."""
    log_ns: np.ndarray
    """Log time [ns]."""
    position: np.ndarray
    """Position of the chunk in the file, see :class:`Place`."""
    offset: np.ndarray
    """Offset of the message's record in the decompressed chunk [byte]."""
    file: np.ndarray
    """Number of the file in the log; 0 in the index of a file."""
    decoder: np.ndarray
    """Number of the decoder in a topic's or the log's list; 0 in the index of a file."""

    @classmethod
    def joined(cls, parts: Sequence["IndexedMessages"]) -> "IndexedMessages":
        """Concatenate messages."""
        none = cls(*[np.zeros(0, np.int64)] * 6)
        return cls(*map(np.concatenate, zip(none, *parts, strict=True)))

    def rows(self, which: np.ndarray | slice) -> "IndexedMessages":
        """Return a selection of the messages."""
        return IndexedMessages(*(column[which] for column in self))

    def in_file_order(self) -> "IndexedMessages":
        """Return the messages sorted by their position in the files."""
        step, inside = np.diff(self.position), np.diff(self.offset)
        if (np.diff(self.file) == 0).all() and ((step > 0) | (step == 0) & (inside >= 0)).all():
            return self
        return self.rows(np.lexsort((self.offset, self.position, self.file)))

    def between(self, begin: int | None, end: int | None) -> slice:
        """Return the messages in a range of log times, end exclusive; None: unbounded.

        The messages must be in order of log time.
        """
        first, last = np.searchsorted(self.log_ns, [begin or 0, end or 0]).tolist()
        return slice(0 if begin is None else first, len(self.log_ns) if end is None else last)

    def places(self, which: np.ndarray | slice = slice(None)) -> list[Place]:
        """Return the chunk of each selected message; by default of all."""
        pairs = zip(self.file[which].tolist(), self.position[which].tolist(), strict=True)
        return [Place(*pair) for pair in pairs]

    def chunks(self, which: np.ndarray | slice) -> set[Place]:
        """Return the chunks of the selected messages."""
        return set(self.places(which))


class FileIndex(NamedTuple):
    """Index of a file."""

    infos: dict[int, ChannelInfo]
    """All channels by id."""
    counts: dict[int, ChannelCount]
    """Counts of all channels that have messages."""
    integrity: FileIntegrity
    messages: IndexedMessages
    """Messages of useful kinds, in file order."""


def file_index(
    infos: dict[int, ChannelInfo],
    messages: np.ndarray,
    integrity: FileIntegrity,
) -> FileIndex:
    """Assemble the index of a file.

    Args:
        infos: Channels of the file.
        messages: ``(4, N)`` int64, the first four fields of :class:`IndexedMessages`, in any order.
            Messages of unused channels are counted and dropped.
        integrity: Integrity of the file. Message counts are added if the messages are from the
            file's own index.

    Raises:
        DamageError: The channel of a message is not declared, or its id exceeds 16 bits.
    """
    if messages.shape[1] and not 0 <= messages[0].min() <= messages[0].max() <= MAX_CHANNEL:
        raise DamageError("number of a channel is out of range")
    counts = _counts(*messages[:2])
    if counts.keys() - infos.keys():
        raise DamageError("message index of an undeclared channel")
    useful = [number for number, info in infos.items() if kind_of(info.schema_name) is not None]
    is_useful = np.isin(messages[0], useful)
    useful = messages if is_useful.all() else messages[:, is_useful]
    zero = np.zeros(useful.shape[1], np.int64)
    if integrity.by_index:
        count = sum(item.messages for item in counts.values())
        integrity = integrity._replace(messages=count, declared_messages=count)
    found = IndexedMessages(*useful, file=zero, decoder=zero).in_file_order()
    return FileIndex(infos, counts, integrity, found)


def _counts(channel: np.ndarray, log_ns: np.ndarray) -> dict[int, ChannelCount]:
    """Count the messages by channel."""
    count = np.bincount(channel)
    first, last = np.full(len(count), MAX_TIME_NS), np.zeros(len(count), np.int64)
    np.minimum.at(first, channel, log_ns)
    np.maximum.at(last, channel, log_ns)
    columns = count.tolist(), first.tolist(), last.tolist()
    found = enumerate(map(ChannelCount, *columns))
    return {number: item for number, item in found if item.messages}


def _utc(stamp_ns: int) -> str:
    whole, rest = divmod(stamp_ns, 1_000_000_000)
    try:
        text = datetime.fromtimestamp(whole, UTC).strftime("%Y-%m-%dT%H:%M:%S")
    except (OverflowError, ValueError, OSError):
        return f"{stamp_ns} ns"
    return f"{text}.{rest // 1_000_000:03d}Z"
