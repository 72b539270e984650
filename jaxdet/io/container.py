"""Files of a log: bytes by position, decompressed chunks, and chunk headers.

Messages of all formats are read like those of an MCAP file: each format presents its messages as
chunks that contain MCAP records after decompression.
"""

import errno
import os
import time
from abc import ABC, abstractmethod
from array import array
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple, TypeVar
from weakref import WeakSet

import numpy as np
from mcap.opcode import Opcode

from jaxdet.errors import InputError
from jaxdet.io.chunks import MESSAGE_HEAD, PAYLOAD_OFFSET, RECORD_HEAD, ChunkHead, DamageError
from jaxdet.io.declarations import ChannelInfo
from jaxdet.io.file_index import MAX_CHANNEL, FileIndex, FileIntegrity, file_index
from jaxdet.io.limits import ReadMemory, check_chunk, check_count, check_index

T = TypeVar("T")

opened: WeakSet["BytesFile"] = WeakSet()
"""Open files of this process."""

_MESSAGE = "message"
"""Compression name of chunks that can't be read by their position in the file."""
_PASSING = errno.EIO, errno.ETIMEDOUT
"""Errors of disks and file servers that may be temporary."""
_WAITS_S = 0.1, 0.5, 2.0
"""Pauses before a failed read is retried [s]."""
_PATIENCE_S = 30.0
"""Maximum total time of these pauses per file [s], as a disk may be damaged in many places."""


class FileState(NamedTuple):
    """Properties by which a change of a file is detected."""

    device: int
    inode: int
    size: int
    modified_ns: int

    @classmethod
    def of(cls, found: os.stat_result) -> "FileState":
        """Return the state from a result of ``os.stat``."""
        return cls(found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns)


class Source(NamedTuple):
    """Bytes of a log file on the disk."""

    path: Path
    """File that is read: the log file, or a decompressed copy of it."""
    note: str = ""
    """Warning about the contents; empty if there is none."""
    state: FileState | None = None
    """State that ``path`` must have; None: its state when it is opened."""


class BytesFile:
    """An open file, read by position, so that threads may share it.

    Args:
        path: File, as passed by the user.
        source: Bytes of the file; by default those in ``path``.

    Raises:
        InputError: The file can't be opened, or its state is not the expected one.
    """

    def __init__(self, path: Path, source: Source | None = None) -> None:
        self.path, self.source = path, source or Source(path)
        self._patience_s = _PATIENCE_S
        with ExitStack() as failed:
            try:
                self._file = failed.enter_context(self.source.path.open("rb", buffering=0))
                self._descriptor = self._file.fileno()
                self.state = self.source.state or FileState.of(os.fstat(self._descriptor))
            except OSError as error:
                raise unreadable(error, path) from error
            self.source = self.source._replace(state=self.state)
            self.size = self.state.size
            self.check_unchanged()
            failed.pop_all()
        opened.add(self)

    def close(self) -> None:
        """Close the file."""
        self._file.close()
        self._descriptor = -1
        opened.discard(self)

    def check_unchanged(self) -> None:
        """Check that the file has not changed since it was opened.

        Raises:
            InputError: Size or modification time differ, or another file has this name.
        """
        try:
            states = self._call(os.fstat, self._descriptor), self._call(os.stat, self.source.path)
            found = {FileState.of(state) for state in states}
        except OSError:
            found = set()
        if found != {self.state}:
            problem = "the file was changed while it was read"
            remedy = "wait until nothing writes to it, then run again"
            raise InputError(problem, path=str(self.path), remedy=remedy)

    def read(self, position: int, size: int) -> bytes:
        """Return exactly ``size`` bytes from ``position``.

        Raises:
            DamageError: The file ends earlier, or is unreadable there.
            InputError: The file was changed since it was opened.
        """
        self._check_within(position, size)
        try:
            data = self._call(os.pread, self._descriptor, size, position)
        except (OSError, OverflowError, ValueError) as error:
            raise _damage(error) from error
        if len(data) == size:
            return data
        rest = bytearray(size - len(data))
        self.read_into(position + len(data), memoryview(rest))
        return data + rest

    def read_into(self, position: int, memory: memoryview) -> None:
        """Fill a writable byte view with the bytes from ``position`` on.

        Raises:
            DamageError: The file ends earlier, or is unreadable there.
            InputError: The file was changed since it was opened.
        """
        self._check_within(position, len(memory))
        while len(memory):
            try:
                count = self._call(os.preadv, self._descriptor, [memory], position)
            except (OSError, OverflowError, ValueError) as error:
                raise _damage(error) from error
            if not count:
                self.check_unchanged()
                raise DamageError("file ends early")
            position, memory = position + count, memory[count:]

    def _check_within(self, position: int, size: int) -> None:
        if not 0 <= position <= self.size - size:
            self.check_unchanged()
            raise DamageError("file ends early")

    def _call(self, function: Callable[..., Any], *args: Any) -> Any:
        """Call a system function; retry after errors that may be temporary.

        Raises:
            OSError: The call still fails.
        """
        for wait_s in _WAITS_S:
            try:
                return function(*args)
            except OSError as error:
                if error.errno not in _PASSING or self._patience_s < wait_s:
                    raise
            self._patience_s -= wait_s
            time.sleep(wait_s)
        return function(*args)


class LogFile(BytesFile, ABC):
    """A file of a log.

    Args:
        path: File, as passed by the user.
        max_bytes: Maximum size of a chunk or message, before and after decompression.
        source: Bytes of the file; by default those in ``path``.

    Raises:
        InputError: The file can't be opened, or its state is not the expected one.
    """

    note: str
    """Warning about the contents; empty if there is none."""
    memory: ReadMemory = ReadMemory()
    """Limits of the memory for reading."""

    def __init__(self, path: Path, max_bytes: int, source: Source | None = None) -> None:
        super().__init__(path, source)
        self.max_bytes, self.note = max_bytes, self.source.note

    def __reduce__(self) -> tuple:
        """Pickle the arguments; another process opens the file again."""
        return type(self), (self.path, self.max_bytes, self.source), {"memory": self.memory}

    def note_unread(self, nbytes: int) -> None:
        """Add a warning about bytes after the end of the recording, if there are any."""
        if nbytes > 0:
            text = f"{nbytes} bytes after the end of the recording are not read"
            self.note = "; ".join(filter(None, (self.source.note, text)))

    def check_size(self, size: int, what: str = "chunk") -> None:
        """Check that a chunk, or other data read at once, has at most ``max_bytes``.

        Raises:
            DamageError: The chunk is larger.
        """
        if size > self.max_bytes:
            raise DamageError(f"{what} is larger than --log.max-chunk-mib")

    def check_memory(self, size: int, what: str = "chunk") -> None:
        """Check that a chunk has at most ``max_bytes``, and that there is enough memory for it.

        Raises:
            DamageError: The chunk is larger.
            ChunkMemoryError: There is too little memory.
        """
        self.check_size(size, what)
        check_chunk(size, str(self.path), self.memory)

    def check_messages(self, count: int) -> None:
        """Check that ``count`` messages fit in the file, and their index in memory.

        Raises:
            InputError: There are too many messages.
        """
        check_count("messages", count, self.size, str(self.path))
        check_index(count, str(self.path), self.memory)

    @abstractmethod
    def read_index(self) -> FileIndex:
        """Read the file's own index of its messages, without reading any message.

        Raises:
            DamageError: The index is missing, incomplete or wrong.
        """

    def rebuild_index(self) -> FileIndex:
        """Build an index of all readable messages by reading the complete file.

        A file that can't be scanned returns its own index, whose messages may be unreadable.

        Raises:
            InputError: The file was changed meanwhile, or has an impossible number of messages.
        """
        found = self.read_index()
        return found._replace(integrity=found.integrity._replace(by_index=False))

    def by_index(self, use: Callable[[FileIndex], T]) -> T:
        """Call a function with the file's index, and return the function's result.

        If the index is damaged, or a chunk that the function reads, the function is called with a
        rebuilt index.

        Raises:
            DamageError: The function raises it for the rebuilt index too.
            InputError: See :meth:`rebuild_index`.
        """
        try:
            return use(self.read_index())
        except DamageError:
            return use(self.rebuild_index())

    @abstractmethod
    def chunk_head(self, position: int) -> ChunkHead:
        """Return the header of the chunk at ``position``, an identifier used in the index.

        Raises:
            DamageError: There is no chunk.
        """

    @abstractmethod
    def chunk(self, position: int) -> bytes | memoryview:
        """Return the decompressed chunk at ``position``, which consists of MCAP records.

        Raises:
            DamageError: The chunk is no longer readable.
        """

    def chunk_begin(self, position: int, size: int) -> bytes:
        """Return at most the first ``size`` bytes of a compressed chunk's records, unchecked.

        The result is empty if decompressing the complete chunk takes about as long.
        """
        return b""

    def name_of(self, position: int) -> str:
        """Return the file name of the image in the chunk; empty if it is not an image file."""
        return ""


class MessageRow(NamedTuple):
    """Header data of a message, without its payload."""

    channel: int
    log_ns: int
    """Log time [ns]."""
    size: int
    """Size of the payload [byte]."""

    def check(self) -> "MessageRow":
        """Check the row and return it.

        Raises:
            DamageError: Channel or log time is out of range.
        """
        if not isinstance(self.channel, int) or not 0 <= self.channel <= MAX_CHANNEL:
            raise DamageError("number of a topic is out of range")
        if not isinstance(self.log_ns, int) or self.log_ns < 0:
            raise DamageError("time of a message is out of range")
        return self


class MessageFile(LogFile):
    """A file with separately accessible messages, such as rows of a table.

    Each message is a chunk that consists of a single MCAP record: a header, then the payload. The
    position of the chunk is the number of the message.
    """

    @abstractmethod
    def row(self, number: int) -> MessageRow:
        """Return channel, log time and size of a message.

        Raises:
            DamageError: The message does not exist, or can't be read.
        """

    @abstractmethod
    def payload(self, number: int, most: int) -> bytes:
        """Return the first ``most`` bytes of a message's payload, or all if it is shorter.

        Raises:
            DamageError: The payload can't be read.
        """

    def chunk_head(self, position: int) -> ChunkHead:
        """Return the header of the chunk that represents a message.

        Raises:
            DamageError: There is no such message.
        """
        _, log_ns, size = self.row(position)
        size += PAYLOAD_OFFSET
        return ChunkHead(log_ns, log_ns, size, 0, _MESSAGE, 0, size)

    def chunk(self, position: int) -> bytes:
        """Return a message with its header.

        Raises:
            DamageError: The message can't be read.
        """
        size = self.chunk_head(position).uncompressed_size
        self.check_memory(size)
        found = self.chunk_begin(position, size)
        if len(found) != size:
            raise DamageError("message ends early")
        return found

    def chunk_begin(self, position: int, size: int) -> bytes:
        """Return up to ``size`` bytes of a message with its header.

        Raises:
            DamageError: The message can't be read.
        """
        channel, log_ns, payload_size = self.row(position)
        head = RECORD_HEAD.pack(Opcode.MESSAGE, MESSAGE_HEAD.size + payload_size)
        head += MESSAGE_HEAD.pack(channel, 0, log_ns, log_ns)
        return head[:size] + self.payload(position, max(0, size - len(head)))


class Walk:
    """Messages and losses found by a scan of a file, if its own index is missing or wrong.

    Intact messages are collected and losses are counted; no message is decoded.

    Args:
        file: File.
    """

    def __init__(self, file: LogFile) -> None:
        self._file = file
        self.lost: Counter[str] = Counter()
        """Number of unusable parts by reason."""
        self._lost_bytes = self._last_ns = 0
        self.read: Counter[int] = Counter()
        """Number of messages by channel."""
        self._messages = tuple(array("q") for _ in range(4))

    def add(self, channel: int, log_ns: int, position: int, offset: int) -> None:
        """Add a message, see :class:`jaxdet.io.file_index.IndexedMessages`.

        Raises:
            InputError: The file has an impossible number of messages.
        """
        self.read[channel] += 1
        values = channel, log_ns, position, offset
        for column, value in zip(self._messages, values, strict=True):
            column.append(value)
        self._file.check_messages(len(self._messages[0]))
        self._last_ns = max(self._last_ns, log_ns)

    def lose(self, reason: str, size: int) -> None:
        """Count an unusable part."""
        self.lost[reason] += 1
        self._lost_bytes += size

    def index(self, infos: Mapping[int, ChannelInfo], **more: Any) -> FileIndex:
        """Return the index of the messages found, with the losses.

        Args:
            infos: Channels of the file by id.
            more: Further fields of :class:`FileIntegrity`, depending on the format.

        Raises:
            InputError: The file was changed meanwhile.
        """
        self._file.check_unchanged()
        integrity = FileIntegrity(
            path=self._file.path,
            messages=len(self._messages[0]),
            lost=dict(self.lost),
            lost_bytes=self._lost_bytes,
            last_log_time_ns=self._last_ns,
            **more,
        )
        messages = np.array(self._messages, np.int64).reshape(4, -1)
        return file_index(dict(infos), messages, integrity)


def unreadable(error: Exception, path: Path) -> InputError:
    """Return the error for a file or folder that the system can't open or read."""
    problem = f"can't be read ({getattr(error, 'strerror', None) or error})"
    return InputError(problem, path=str(path), remedy="check the file")


def _damage(error: Exception) -> DamageError:
    return DamageError(f"file can't be read ({getattr(error, 'strerror', None) or error})")
