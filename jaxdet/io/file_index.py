"""The index of a file: what and where its messages are, whatever the file's format is.

A format reads it from the file's own index, without a look at a message, or rebuilds it by a walk
over the whole file (:mod:`jaxdet.io.walk`). All that reads messages stands on these arrays, and
does not know which of the two they come from.
"""

from collections.abc import Mapping
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
    """Result of the checks of a file: what was read of it, and what was lost."""

    path: Path
    messages: int = 0
    """Number of messages found."""
    declared_messages: int | None = None
    """Number of messages by the file's statistics; None without."""
    has_end: bool = True
    """Whether the data end and the file's closing magic are there."""
    chunks: int = 0
    chunks_with_crc: int = 0
    lost: Mapping[str, int] = {}
    """Number of rejected records and chunks by reason."""
    lost_bytes: int = 0
    lost_spans_ns: tuple[tuple[int, int], ...] = ()
    """Log times that the heads of rejected chunks state."""
    last_log_time_ns: int = 0
    """Last log time of the messages found."""
    missing: Mapping[str, int] = {}
    """Number of messages by topic that statistics or message indexes count, but that are lost."""
    summary_problem: str = ""
    """Why the file has no summary that can be read; empty if it has one."""
    by_index: bool = False
    """Whether the messages are those of the file's own index, not of a walk over the whole file.
    Then the chunks are checked when frames are read from them, and the first one's CRC stands for
    all."""

    @property
    def recovered(self) -> bool:
        """Whether something is missing."""
        declared = self.declared_messages
        counted = declared in (None, self.messages) and not self.missing
        return bool(self.lost) or not self.has_end or not counted

    @property
    def text(self) -> str:
        """One line for people."""
        if self.by_index and self.chunks_with_crc:
            return "has an index; the CRC of each chunk is checked when it is read"
        crc = f"CRC checked in {self.chunks_with_crc} of {self.chunks} chunks"
        crc = crc if self.chunks_with_crc else "not checkable (no CRC in file)"
        if self.summary_problem:
            crc += f"; nothing tells what is missing ({self.summary_problem})"
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
    """The messages of one channel."""

    messages: int
    first_ns: int
    last_ns: int


class FileIndex(NamedTuple):
    """The messages of a file; the arrays, ``(N,)`` int64, hold those of use, in file order."""

    infos: dict[int, ChannelInfo]
    """All channels."""
    counts: dict[int, ChannelCount]
    """Of all channels that have messages; where the chunks of an MCAP file aren't in the order of
    log times, the span of those of no use is about right."""
    integrity: FileIntegrity
    channel: np.ndarray
    log_ns: np.ndarray
    """Log time [ns]."""
    position: np.ndarray
    """Position of the message's chunk, see :meth:`jaxdet.io.container.LogFile.chunk_head`."""
    length: np.ndarray
    """Length of the chunk's content."""
    offset: np.ndarray
    """Offset of the message's record in the decompressed chunk."""


def file_index(
    infos: dict[int, ChannelInfo],
    messages: np.ndarray,
    integrity: FileIntegrity,
    counts: dict[int, ChannelCount] | None = None,
) -> FileIndex:
    """Return the index of a file.

    Args:
        infos: Its channels.
        messages: ``(5, N)`` int64, the last five fields of the index of messages in any order;
            those of no use are left out.
        integrity: What is known of the file beside its messages. By the file's own index the
            numbers of messages are filled in.
        counts: What else is known of the channels, where ``messages`` lacks some of no use.

    Raises:
        DamageError: A message is of no channel, or of one whose number has more than 16 bits.
    """
    if messages.shape[1] and not 0 <= messages[0].min() <= messages[0].max() <= MAX_CHANNEL:
        raise DamageError("number of a channel is out of range")
    counts = (counts or {}) | _counts(*messages[:2])
    if counts.keys() - infos.keys():
        raise DamageError("message index of an undeclared channel")
    which = np.flatnonzero(np.isin(messages[0], useful_channels(infos)))
    which = which[np.lexsort(messages[[4, 2]][:, which])]
    if integrity.by_index:
        count = sum(item.messages for item in counts.values())
        integrity = integrity._replace(messages=count, declared_messages=count)
    return FileIndex(infos, counts, integrity, *messages[:, which])


def useful_channels(infos: dict[int, ChannelInfo]) -> np.ndarray:
    """Return the numbers of the channels with messages of use, int64."""
    useful = [number for number, info in infos.items() if kind_of(info.schema_name) is not None]
    return np.array(useful, np.int64)


def _counts(channel: np.ndarray, log_ns: np.ndarray) -> dict[int, ChannelCount]:
    """Return the messages by channel."""
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
