"""The index of a file: what and where its messages are, whatever the file's format is.

A format reads it from the file's own index, without a look at a message, or rebuilds it by a walk
over the whole file (:mod:`jaxdet.io.walk`). All that reads messages stands on these arrays, and
does not know which of the two they come from.
"""

from typing import NamedTuple

import numpy as np

from jaxdet.io.chunks import MAX_TIME_NS, DamageError
from jaxdet.io.declarations import ChannelInfo
from jaxdet.io.integrity import FileIntegrity
from jaxdet.io.messages import kind_of

MAX_CHANNEL = 0xFFFF


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
    """Of the message's chunk, see :meth:`jaxdet.io.container.LogFile.chunk_head`."""
    length: np.ndarray
    """Of the chunk's content."""
    offset: np.ndarray
    """Of the message's record in the decompressed chunk."""


def file_index(
    infos: dict[int, ChannelInfo],
    messages: np.ndarray,
    integrity: FileIntegrity,
    counts: dict[int, ChannelCount] | None = None,
) -> FileIndex:
    """The index of a file.

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
    """The numbers of the channels with messages of use, int64."""
    useful = [number for number, info in infos.items() if kind_of(info.schema_name) is not None]
    return np.array(useful, np.int64)


def _counts(channel: np.ndarray, log_ns: np.ndarray) -> dict[int, ChannelCount]:
    """The messages by channel."""
    count = np.bincount(channel)
    first, last = np.full(len(count), MAX_TIME_NS), np.zeros(len(count), np.int64)
    np.minimum.at(first, channel, log_ns)
    np.maximum.at(last, channel, log_ns)
    columns = count.tolist(), first.tolist(), last.tolist()
    found = enumerate(map(ChannelCount, *columns))
    return {number: item for number, item in found if item.messages}
