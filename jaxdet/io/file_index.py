"""What a file's own index tells of its messages, whatever the file's format is."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxdet.io.declarations import ChannelInfo
from jaxdet.io.integrity import FileIntegrity
from jaxdet.io.message_index import ChannelCount


class FileIndex(NamedTuple):
    """The messages of a file; the arrays, ``(N,)`` int64, hold those of use, in file order."""

    infos: dict[int, ChannelInfo]
    """All channels."""
    counts: dict[int, ChannelCount]
    """Of the channels that have messages."""
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


def indexed_integrity(path: Path, messages: int, chunks: int, has_crc: bool) -> FileIntegrity:
    """What an index says of its file."""
    return FileIntegrity(
        path=path,
        messages=messages,
        declared_messages=messages,
        chunks=chunks,
        chunks_with_crc=chunks if has_crc else 0,
        has_end=True,
        lost={},
        lost_bytes=0,
        lost_spans_ns=(),
        last_log_time_ns=0,
        missing={},
        by_index=True,
    )


def count_channels(channel: np.ndarray, log_ns: np.ndarray) -> dict[int, ChannelCount]:
    """How many messages each channel has, and their first and last log time.

    Args:
        channel: ``(N,)`` int64.
        log_ns: ``(N,)`` int64.
    """
    found = {}
    for number in np.unique(channel).tolist():
        mine = log_ns[channel == number]
        found[number] = ChannelCount(len(mine), int(mine.min()), int(mine.max()))
    return found
