"""One MCAP file: its bytes by position, whole chunks and single messages."""

from pathlib import Path
from threading import Lock
from typing import NamedTuple

from jaxdet.errors import InputError
from jaxdet.io.chunks import RECORD_HEAD, ChunkHead, DamageError, decompress, read_chunk_head

MAGIC = b"\x89MCAP0\r\n"
_HEAD_BYTES = 128


class Location(NamedTuple):
    """Where a message's payload lies; enough to read it again."""

    chunk: int
    """Offset of the chunk record's content in the file, -1 for a message outside chunks."""
    offset: int
    """Of the payload, in the decompressed chunk or in the file."""
    size: int


class McapFile:
    """One open file; threads may share it.

    Args:
        path: The file.
        max_bytes: Largest chunk or message, before and after decompression.

    Raises:
        InputError: It can't be opened or isn't an MCAP file.
    """

    def __init__(self, path: Path, max_bytes: int) -> None:
        self.path, self.max_bytes = path, max_bytes
        self._lock = Lock()
        try:
            self._file = path.open("rb")
            self.size = self._file.seek(0, 2)
            magic = self.read(0, len(MAGIC)) if self.size else b""
        except OSError as error:
            problem = f"can't be read ({error.strerror or error})"
            raise InputError(problem, path=str(path), remedy="check the file") from error
        if magic != MAGIC or self.size <= 2 * len(MAGIC):
            self._file.close()
            problem = "the file is empty" if not self.size else "not an MCAP file"
            problem = "the MCAP file holds no records" if magic == MAGIC else problem
            raise InputError(problem, path=str(path), remedy="record it again or leave it out")

    def __reduce__(self) -> tuple:
        """In another process the file is opened again."""
        return McapFile, (self.path, self.max_bytes)

    def close(self) -> None:
        """Closes the file."""
        self._file.close()

    def payload(self, location: Location, chunk: bytes | None) -> memoryview:
        """A message's payload; ``chunk`` is :meth:`chunk` of its location, if it has one."""
        if chunk is not None:
            return memoryview(chunk)[location.offset : location.offset + location.size]
        return memoryview(self.read(location.offset, location.size))

    def chunk_head(self, position: int) -> ChunkHead:
        """The head of the chunk record whose content begins at ``position``.

        Raises:
            DamageError: It isn't one.
        """
        _, length = RECORD_HEAD.unpack(self.read(position - RECORD_HEAD.size, RECORD_HEAD.size))
        return read_chunk_head(self.read(position, min(length, _HEAD_BYTES)), length)

    def chunk_bytes(self, position: int) -> int:
        """How much :meth:`chunk` may return there; 0 where no chunk can be."""
        try:
            return min(self.chunk_head(position).uncompressed_size, self.max_bytes)
        except DamageError:
            return 0

    def chunk(self, position: int) -> bytes:
        """The decompressed chunk whose record's content begins at ``position``.

        Raises:
            DamageError: It can't be read any more.
        """
        head = self.chunk_head(position)
        data = self.read(position + head.data_offset, min(head.data_size, self.max_bytes + 1))
        return decompress(head, data, self.max_bytes)

    def read(self, position: int, size: int) -> bytes:
        """Exactly ``size`` bytes at ``position``.

        Raises:
            DamageError: The file ends before, or can't be read there.
        """
        try:
            with self._lock:
                self._file.seek(position)
                data = self._file.read(size)
        except OSError as error:
            raise DamageError(f"file can't be read ({error.strerror or error})") from error
        if len(data) != size:
            raise DamageError("file ends early")
        return data
