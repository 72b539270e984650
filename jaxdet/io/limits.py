"""Limits on the contents of files, checked before memory or time is spent on them.

Files are not trusted: a few kilobytes can declare gigabytes of data, or hours of work. Each limit
is far above the values in real recordings, which its comment states, and low enough that a file
within all limits is read in seconds with less than a gigabyte. Chunks and messages are limited by
``LogOptions.max_chunk_mib``, images by ``LogOptions.max_pixels``.
"""

from typing import NamedTuple

from jaxdet.errors import ChunkMemoryError, InputError
from jaxdet.memory import size_text

MAX_SCHEMA_BYTES = 1 << 20
"""Maximum size of a schema [byte]. ROS definitions have up to 30 kB, protobuf descriptors 300 kB.
"""
MAX_SCHEMAS_BYTES = 64 << 20
"""Maximum total size of the useful schemas in a file [byte]."""
MAX_SCHEMA_LINES = 10_000
"""Maximum lines of a ROS definition without comments and constants; an Image and its members have
11."""
MAX_DECLARATIONS = 200_000
"""Maximum number of schema and channel records in a summary; ids have 16 bits."""
MAX_TOPICS = 10_000
"""Maximum number of topics in a log; large robots have about 500."""
MAX_USED_TOPICS = 2000
"""Maximum number of topics with images, calibrations or poses in a log; large robots have about
100."""
MAX_FRAMES_TF = 10_000
"""Maximum number of TF frames in a log; robots with hands have about 200."""
MAX_ODD_RECORDS = 1000
"""Maximum number of empty or unknown records in a chunk, in a summary or between chunks."""
MAX_SMALL_BYTES = 1 << 20
"""Maximum size of a calibration, transform or pose message [byte]; a thousand transforms have 150
kB."""
MAX_MESSAGE_BYTES = 256 << 20
"""Maximum size of a decompressed message [byte]; an image of 32 megapixels has 128 MiB."""
MAX_JSON_BYTES = 16 << 20
"""Maximum size of a JSON message [byte]; Python needs up to 50 times as much memory."""
MAX_TRANSLATION_M = 1e8
"""Maximum translation of a transform or pose [m]; coordinates relative to the Earth's centre are
smaller."""

_INDEX_BYTES = 64
"""Memory per message in an index [byte]."""
_FIT = {"messages": (250_000, 8), "small messages": (100_000, 32), "images": (10_000, 64)}
"""Maximum number of messages in a file: a constant, plus one per this many bytes of the file. Small
messages are transforms, poses and calibrations."""


class ReadMemory(NamedTuple):
    """Memory that reading a log may use in a process [byte]; practically unlimited by default."""

    chunk: int = 1 << 40
    """Memory for the largest chunk or message, and as much again for cached chunks."""
    messages: int = 1 << 40
    """Memory for the index while a file is opened."""
    short: int = 0
    """Additional memory up to which ``chunk`` does not grow; of more, ``chunk`` gets a quarter."""


def check_index(count: int, path: str, memory: ReadMemory) -> None:
    """Check that there is enough memory for an index of ``count`` messages.

    Raises:
        InputError: There is too little memory.
    """
    if count * _INDEX_BYTES > memory.messages:
        what, most = f"an index of {count} messages", memory.messages
        raise _too_large(InputError, what, count * _INDEX_BYTES, most, 0, path)


def check_chunk(nbytes: int, path: str, memory: ReadMemory) -> None:
    """Check that there is enough memory for a chunk.

    Raises:
        ChunkMemoryError: There is too little memory.
    """
    if nbytes > memory.chunk:
        what = f"a chunk of {nbytes} bytes"
        raise _too_large(ChunkMemoryError, what, nbytes, memory.chunk, memory.short, path)


def _too_large(
    kind: type[InputError], what: str, nbytes: int, most: int, short: int, path: str
) -> InputError:
    problem = f"{what} needs {size_text(nbytes)}, but only {size_text(most)} are available"
    # A chunk gets a quarter of the memory of a process, and the index half.
    remedy = f"raise --memory by {size_text(4 * (nbytes - most) + short)}"
    return kind(problem, path=path, remedy=remedy)


def check_topics(count: int, path: str, most: int = MAX_TOPICS) -> None:
    """Check that a log has at most ``most`` topics.

    Raises:
        InputError: The log has more topics.
    """
    if count > most:
        problem = f"the log has at least {count} topics, more than the maximum of {most}"
        raise InputError(problem, path=path, remedy="no recorder writes so many; check the file")


def check_count(what: str, count: int, file_bytes: int, path: str, topic: str = "") -> None:
    """Check that files of this size can contain ``count`` messages.

    Args:
        what: Key of ``_FIT``.
        count: Number of messages.
        file_bytes: Size of the files [byte].
        path: Path of the log, for errors.
        topic: Topic, for errors.

    Raises:
        InputError: There are more messages than the files can contain.
    """
    free, each = _FIT[what]
    most = free + file_bytes // each
    if count > most:
        problem = f"{count} {what} or more in {file_bytes} bytes, but at most {most} fit into them"
        remedy = "no recorder writes this; check the file"
        raise InputError(problem, path=path, topic=topic, remedy=remedy)
