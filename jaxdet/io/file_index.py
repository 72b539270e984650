"""What a file's own index tells of its messages, whatever the file's format is."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxdet.io.chunks import DamageError
from jaxdet.io.declarations import ChannelInfo
from jaxdet.io.integrity import FileIntegrity
from jaxdet.io.messages import kind_of


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
    path: Path,
    infos: dict[int, ChannelInfo],
    messages: np.ndarray,
    counts: dict[int, ChannelCount] | None = None,
    chunks: int = 0,
    chunks_with_crc: int = 0,
) -> FileIndex:
    """The index of a file.

    Args:
        path: The file.
        infos: Its channels.
        messages: ``(5, N)`` int64, the last five fields of the index of messages in any order;
            those of no use are left out.
        counts: What else is known of the channels, where ``messages`` lacks some of no use.
        chunks: Of the file.
        chunks_with_crc: Of these.

    Raises:
        DamageError: A message is of no channel.
    """
    counts = (counts or {}) | _counts(*messages[:2])
    if counts.keys() - infos.keys():
        raise DamageError("message index of an undeclared channel")
    which = np.flatnonzero(np.isin(messages[0], useful_channels(infos)))
    which = which[np.lexsort(messages[[4, 2]][:, which])]
    count = sum(item.messages for item in counts.values())
    integrity = FileIntegrity(
        path=path,
        messages=count,
        declared_messages=count,
        has_end=True,
        chunks=chunks,
        chunks_with_crc=chunks_with_crc,
        by_index=True,
    )
    return FileIndex(infos, counts, integrity, *messages[:, which])


def useful_channels(infos: dict[int, ChannelInfo]) -> np.ndarray:
    """The numbers of the channels with messages of use, int64."""
    useful = [number for number, info in infos.items() if kind_of(info.schema_name) is not None]
    return np.array(useful, np.int64)


def _counts(channel: np.ndarray, log_ns: np.ndarray) -> dict[int, ChannelCount]:
    found = {}
    for number in np.unique(channel).tolist():
        mine = log_ns[channel == number]
        found[number] = ChannelCount(len(mine), int(mine.min()), int(mine.max()))
    return found
