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
_FREE_MESSAGES, _MESSAGE_BYTES = 250_000, 8
_FREE_MOTIONS, _MOTION_BYTES = 100_000, 32
_FREE_IMAGES, _IMAGE_BYTES = 10_000, 64


class ReadMemory(NamedTuple):
    """How much memory reading a log may take in a process [bytes]; by default any amount."""

    chunk: int = 1 << 40
    """For the largest chunk or message, and as much for those that are kept."""
    messages: int = 1 << 40
    """For what is known of messages while a file is opened."""


def check_messages(count: int, file_bytes: int, path: str, memory: ReadMemory) -> None:
    """Refuses more messages than a file has room for, or memory: 250,000, and one for each 8 bytes.

    Raises:
        InputError: There are more.
    """
    _check("messages", count, _FREE_MESSAGES, _MESSAGE_BYTES, file_bytes, path)
    if count * _INDEX_BYTES > memory.messages:
        what, most = f"an index of {count} messages", memory.messages
        raise _too_large(InputError, what, count * _INDEX_BYTES, most, path)


def check_chunk(nbytes: int, path: str, memory: ReadMemory) -> None:
    """Refuses a chunk that takes more memory than there is for one.

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


def check_motions(count: int, file_bytes: int, path: str, topic: str) -> None:
    """Refuses more transforms, poses or calibrations: 100,000, and one for each 32 bytes.

    Raises:
        InputError: There are more.
    """
    _check("small messages", count, _FREE_MOTIONS, _MOTION_BYTES, file_bytes, path, topic)


def check_images(count: int, file_bytes: int, path: str, topic: str) -> None:
    """Refuses more images of a topic: 10,000, and one for each 64 bytes.

    Raises:
        InputError: There are more.
    """
    _check("images", count, _FREE_IMAGES, _IMAGE_BYTES, file_bytes, path, topic)


def check_topics(count: int, path: str) -> None:
    """Refuses more than ``MAX_TOPICS``.

    Raises:
        InputError: There are more.
    """
    if count > MAX_TOPICS:
        problem = f"the log has {count} topics or more, but at most {MAX_TOPICS} are taken"
        raise InputError(problem, path=path, remedy="no recorder writes so many; check the file")


def _check(
    what: str, count: int, free: int, each: int, file_bytes: int, path: str, topic: str = ""
) -> None:
    most = free + file_bytes // each
    if count > most:
        problem = f"{count} {what} or more in {file_bytes} bytes, but at most {most} fit into them"
        remedy = "no recorder writes this; check the file"
        raise InputError(problem, path=path, topic=topic, remedy=remedy)
