"""The files of a log: bytes by position, whole chunks and their heads.

Whatever a file's format is, its messages are read as those of an MCAP file: from chunks whose
records, once decompressed, are MCAP's.
"""

import errno
import os
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

from jaxdet.errors import InputError
from jaxdet.io.chunks import ChunkHead, DamageError
from jaxdet.io.file_index import FileIndex
from jaxdet.io.limits import ReadMemory, check_chunk, check_count, check_index

_MAX_PARTS = 512
"""Buffers filled by one call, fewer than any system's limit."""
_PASSING = errno.EIO, errno.ETIMEDOUT
"""Errors of disks and file servers that may pass."""
_WAITS_S = 0.1, 0.5, 2.0
"""Pauses before a read that failed so is repeated."""
_PATIENCE_S = 30.0
"""Sum of the pauses per file, which may have many bad places."""


class FileState(NamedTuple):
    """Properties by which a changed file is recognised."""

    device: int
    inode: int
    size: int
    modified_ns: int

    @classmethod
    def of(cls, found: os.stat_result) -> "FileState":
        """Return the state that the system reports."""
        return cls(found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns)


class LogFile(ABC):
    """One open file; threads may share it, since no read moves its position.

    Args:
        path: The file.
        max_bytes: Largest chunk or message, before and after decompression.
        state: State that the file must still have; default: its present one.

    Raises:
        InputError: It can't be opened, has another format, or is not as ``state`` says.
    """

    magic: bytes
    """First bytes of the file."""
    kind: str
    """Name of the format, for messages."""
    memory: ReadMemory = ReadMemory()
    """Limits of the memory for reading."""

    def __init__(self, path: Path, max_bytes: int, state: FileState | None = None) -> None:
        self.path, self.max_bytes = path, max_bytes
        self._patience_s = _PATIENCE_S
        with ExitStack() as failed:
            try:
                self._file = failed.enter_context(path.open("rb", buffering=0))
                self._descriptor = self._file.fileno()
                self.state = state or FileState.of(os.fstat(self._descriptor))
                self.size = self.state.size
                self.check_unchanged()
                magic = LogFile.read(self, 0, min(self.size, len(self.magic)))
            except (OSError, DamageError) as error:
                text = getattr(error, "strerror", None) or error
                problem = f"can't be read ({text})"
                raise InputError(problem, path=str(path), remedy="check the file") from error
            if magic != self.magic or self.size <= 2 * len(self.magic):
                problem = "the file is empty" if not self.size else f"not {self.kind} file"
                if magic == self.magic:
                    problem = f"the {self.kind.partition(' ')[2]} file holds no records"
                raise InputError(problem, path=str(path), remedy="record it again or leave it out")
            failed.pop_all()

    def __reduce__(self) -> tuple:
        """In another process the file is opened again."""
        arguments = self.path, self.max_bytes, self.state
        return type(self), arguments, {"memory": self.memory}

    def close(self) -> None:
        """Close the file."""
        self._file.close()
        self._descriptor = -1

    def check_unchanged(self) -> None:
        """Check that the file is what it was when it was opened.

        Raises:
            InputError: It has another size or time of change, or another file has its name.
        """
        try:
            states = self._call(os.fstat, self._descriptor), self._call(os.stat, self.path)
            found = {FileState.of(state) for state in states}
        except OSError:
            found = set()
        if found != {self.state}:
            problem = "the file was changed while it was read"
            remedy = "read it again when nothing writes to it"
            raise InputError(problem, path=str(self.path), remedy=remedy)

    def check_size(self, size: int, what: str = "chunk") -> None:
        """Check that a chunk, or anything else read at once, has at most ``max_bytes``.

        Raises:
            DamageError: It is larger.
        """
        if size > self.max_bytes:
            raise DamageError(f"{what} is larger than --log.max-chunk-mib")

    def check_memory(self, size: int, what: str = "chunk") -> None:
        """Check that a chunk has at most ``max_bytes``, and that there is memory for it.

        Raises:
            DamageError: It is larger.
            ChunkMemoryError: There isn't.
        """
        self.check_size(size, what)
        check_chunk(size, str(self.path), self.memory)

    def check_messages(self, count: int) -> None:
        """Check that so many messages fit into the file, and their index into memory.

        Raises:
            InputError: One hasn't.
        """
        check_count("messages", count, self.size, str(self.path))
        check_index(count, str(self.path), self.memory)

    @abstractmethod
    def read_index(self) -> FileIndex:
        """Return the index of the file's messages by its own index, without reading a message.

        Raises:
            DamageError: The file's own index is missing, torn or wrong.
        """

    @abstractmethod
    def rebuild_index(self) -> FileIndex:
        """Return the index of every readable message by reading all of the file.

        Raises:
            InputError: The file was changed meanwhile, or holds more messages than fit into it.
        """

    @abstractmethod
    def chunk_head(self, position: int) -> ChunkHead:
        """Return the head of the chunk at ``position``, a number by which the index names it.

        Raises:
            DamageError: There is none.
        """

    @abstractmethod
    def chunk(self, position: int) -> bytes | memoryview:
        """Return the decompressed chunk at ``position``; its messages are MCAP's records.

        Raises:
            DamageError: It can't be read any more.
        """

    def chunk_begin(self, position: int, size: int) -> bytes:
        """Return up to ``size`` bytes of a packed chunk's records, not checked; perhaps none."""
        return b""

    def chunk_bytes(self, position: int) -> int:
        """Return how much memory :meth:`chunk` may take there; 0 if there is no chunk."""
        try:
            head = self.chunk_head(position)
        except DamageError:
            return 0
        return min(max(head.uncompressed_size, head.data_size), self.max_bytes)

    def name_of(self, position: int) -> str:
        """Return the name of the image that the chunk is; empty if it is not a file of its own."""
        return ""

    def read(self, position: int, size: int) -> bytes:
        """Return exactly ``size`` bytes at ``position``.

        Raises:
            DamageError: The file ends before, or can't be read there.
            InputError: It was changed since it was opened.
        """
        try:
            data = self._call(os.pread, self._descriptor, size, position)
        except (OSError, OverflowError, ValueError) as error:
            raise _unreadable(error) from error
        if len(data) == size:
            return data
        if position + size > self.size:
            self.check_unchanged()
            raise DamageError("file ends early")
        whole = bytearray(size)
        whole[: len(data)] = data
        LogFile.read_into(self, position + len(data), [memoryview(whole)[len(data) :]])
        return bytes(whole)

    def read_into(self, position: int, parts: Sequence[memoryview]) -> None:
        """Fill writable byte views, one after the other, with what begins at ``position``.

        Raises:
            DamageError: The file ends before, or can't be read there.
            InputError: It was changed since it was opened.
        """
        left = list(parts)
        while left := [part for part in left if len(part)]:
            try:
                count = self._call(os.preadv, self._descriptor, left[:_MAX_PARTS], position)
            except (OSError, OverflowError, ValueError) as error:
                raise _unreadable(error) from error
            if not count:
                self.check_unchanged()
                raise DamageError("file ends early")
            position += count
            done = 0
            while done < len(left) and count >= len(left[done]):
                count -= len(left[done])
                done += 1
            left = left[done:]
            if count:
                left[0] = left[0][count:]

    def _call(self, function: Callable[..., Any], *args: Any) -> Any:
        """Call a function of the system; try again after errors that may pass.

        Raises:
            OSError: It fails for good.
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


def _unreadable(error: Exception) -> DamageError:
    return DamageError(f"file can't be read ({getattr(error, 'strerror', None) or error})")
