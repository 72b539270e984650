"""What a file may ask for. All that a log declares is held against these before it is done.

A file is not trusted: a few kilobytes can declare gigabytes, or work for hours. Each bound is far
above what recordings hold (their figures are beside it) and low enough that whatever is within all
of them is read in seconds and within a gigabyte. Chunks and messages have their bound in
``LogOptions.max_chunk_mib``, images in ``LogOptions.max_pixels``.
"""

from typing import NamedTuple

from jaxdet.errors import ChunkMemoryError, InputError
from jaxdet.memory import size_text

MAX_SCHEMA_BYTES = 1 << 20
"""Of one schema. ROS definitions have up to 30 kB, sets of protobuf descriptors up to 300 kB."""
MAX_SCHEMAS_BYTES = 64 << 20
"""Of all schemas of a file that are of use."""
MAX_SCHEMA_LINES = 10_000
"""Of a ROS definition, comments and constants left out; an Image with all its parts has 11."""
MAX_DECLARATIONS = 200_000
"""Schema and channel records in a summary; both have numbers of 16 bits."""
MAX_TOPICS = 10_000
"""Of a log. Large robots have some 500."""
MAX_FRAMES_TF = 10_000
"""TF frames of a log. Robots with hands have some 200."""
MAX_ODD_RECORDS = 1000
"""Empty records and those of unknown kinds, in a chunk, a summary or between chunks."""
MAX_SMALL_BYTES = 1 << 20
"""Of a message of calibration, transforms or poses. A thousand transforms take 150 kB."""
MAX_MESSAGE_BYTES = 256 << 20
"""Of a message that was compressed alone. An image of 32 megapixels takes 128 MiB."""
MAX_JSON_BYTES = 16 << 20
"""Of a JSON message: Python takes up to 50 times as much for it."""
MAX_TRANSLATION_M = 1e8
"""Of a transform or pose [m]: coordinates with their origin in the Earth's middle are within."""

_INDEX_BYTES = 64
"""Of a message that is known."""
_FIT = {"messages": (250_000, 8), "small messages": (100_000, 32), "images": (10_000, 64)}
"""A file may have so many of them, and one more per so many bytes. Small messages are transforms,
poses and calibrations."""


class ReadMemory(NamedTuple):
    """How much memory reading a log may take in a process [bytes]; by default any amount."""

    chunk: int = 1 << 40
    """For the largest chunk or message, and as much for those that are kept."""
    messages: int = 1 << 40
    """For what is known of messages while a file is opened."""


def check_index(count: int, path: str, memory: ReadMemory) -> None:
    """Refuse more messages than there is memory for in an index.

    Raises:
        InputError: There are more.
    """
    if count * _INDEX_BYTES > memory.messages:
        what, most = f"an index of {count} messages", memory.messages
        raise _too_large(InputError, what, count * _INDEX_BYTES, most, path)


def check_chunk(nbytes: int, path: str, memory: ReadMemory) -> None:
    """Refuse a chunk that takes more memory than there is for one.

    Raises:
        ChunkMemoryError: It does.
    """
    if nbytes > memory.chunk:
        what = f"a chunk of {nbytes} bytes"
        raise _too_large(ChunkMemoryError, what, nbytes, memory.chunk, path)


def _too_large(kind: type[InputError], what: str, nbytes: int, most: int, path: str) -> InputError:
    problem = f"{what} takes {size_text(nbytes)}, where {size_text(most)} are allowed"
    # A chunk gets a quarter of what there is for a process, and the index half.
    remedy = f"give --memory {size_text(4 * (nbytes - most))} more"
    return kind(problem, path=path, remedy=remedy)


def check_topics(count: int, path: str) -> None:
    """Refuse more topics than ``MAX_TOPICS``.

    Raises:
        InputError: There are more.
    """
    if count > MAX_TOPICS:
        problem = f"the log has {count} topics or more, but at most {MAX_TOPICS} are taken"
        raise InputError(problem, path=path, remedy="no recorder writes so many; check the file")


def check_count(what: str, count: int, file_bytes: int, path: str, topic: str = "") -> None:
    """Refuse more messages than a recorder writes into files of this size.

    Args:
        what: A key of ``_FIT``.
        count: Number of messages.
        file_bytes: Size of the files.
        path: The log, for errors.
        topic: The topic, for errors.

    Raises:
        InputError: There are more.
    """
    free, each = _FIT[what]
    most = free + file_bytes // each
    if count > most:
        problem = f"{count} {what} or more in {file_bytes} bytes, but at most {most} fit into them"
        remedy = "no recorder writes this; check the file"
        raise InputError(problem, path=path, topic=topic, remedy=remedy)
