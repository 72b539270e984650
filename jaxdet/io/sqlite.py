"""ROS 2's SQLite recordings (``.db3`` of rosbag2): each message is a chunk of its own.

Where a message's blob is long, SQLite gives any part of it without reading the rest. So the
position of message ``id`` is ``id << 32``, its bytes follow from there: first the head that it
would have in an MCAP file, then the blob, and pixels are read straight into their arrays.
Source: rosbag2's ``rosbag2_storage_sqlite3``, schemas 1 to 4.
"""

import sqlite3
from collections.abc import Sequence
from pathlib import Path
from threading import local
from typing import Any

from mcap.opcode import Opcode

from jaxdet.errors import InputError
from jaxdet.io.chunks import MESSAGE_HEAD, RECORD_HEAD, ChunkHead, DamageError
from jaxdet.io.container import FileState, LogFile

MAX_ID = (1 << 31) - 1
HEAD_BYTES = RECORD_HEAD.size + MESSAGE_HEAD.size
POSITION_BITS = 32
_WITHIN = (1 << POSITION_BITS) - 1
_MAX_CHANNEL = 0xFFFF
_ROW = "SELECT topic_id, timestamp, length(data), typeof(data) FROM messages WHERE id = ?"
_ZSTD = b"\x28\xb5\x2f\xfd"


class SqliteFile(LogFile):
    """A rosbag2 recording in SQLite; it is never written to."""

    magic = b"SQLite format 3\0"
    kind = "a rosbag2 SQLite"

    def __init__(self, path: Path, max_bytes: int, state: FileState | None = None) -> None:
        super().__init__(path, max_bytes, state)
        self._of_thread = local()
        self._connections: list[sqlite3.Connection] = []
        try:
            self._check()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Closes the file."""
        for connection in self._connections:
            connection.close()
        self._connections = []
        super().close()

    def query(self, text: str, values: Sequence[object] = ()) -> sqlite3.Cursor:
        """The rows of a query.

        Raises:
            DamageError: SQLite can't answer; reading the rows may raise ``sqlite3.Error``.
        """
        try:
            return self._connection().execute(text, values)
        except sqlite3.Error as error:
            raise damage(error) from error

    def chunk_head(self, position: int) -> ChunkHead:
        """The head of the chunk that a message is.

        Raises:
            DamageError: There is none.
        """
        _, log_ns, size = self._row(position >> POSITION_BITS)
        size += HEAD_BYTES
        return ChunkHead(log_ns, log_ns, size, 0, "", 0, size, size)

    def chunk(self, position: int) -> bytes:
        """A message with its head.

        Raises:
            DamageError: It can't be read.
        """
        head = self.chunk_head(position)
        if head.uncompressed_size > self.max_bytes:
            raise DamageError("chunk is larger than --log.max-chunk-mib")
        return self.read(position, head.uncompressed_size)

    def read(self, position: int, size: int) -> bytes:
        """Exactly ``size`` bytes of a message.

        Raises:
            DamageError: It ends before, or can't be read.
        """
        found = bytearray(size)
        self.read_into(position, [memoryview(found)])
        return bytes(found)

    def read_into(self, position: int, parts: Sequence[memoryview]) -> None:
        """Fills writable byte views with what begins at ``position``, one after the other.

        Raises:
            DamageError: The message ends before, or can't be read.
        """
        number, start = position >> POSITION_BITS, position & _WITHIN
        try:
            with self._connection().blobopen("messages", "data", number, readonly=True) as blob:
                for part in parts:
                    if start < HEAD_BYTES:
                        head = self._head(number)[start : start + len(part)]
                        part[: len(head)] = head
                        start, part = start + len(head), part[len(head) :]
                    if not len(part):
                        continue
                    blob.seek(start - HEAD_BYTES)
                    data = blob.read(len(part))
                    if len(data) != len(part):
                        raise DamageError("message ends early")
                    part[:] = data
                    start += len(part)
        except (sqlite3.Error, OverflowError, ValueError) as error:
            raise damage(error) from error

    @property
    def declared_bytes(self) -> int:
        """Bytes of the file, by its own head."""
        page, pages = LogFile.read(self, 16, 2), LogFile.read(self, 28, 4)
        size = int.from_bytes(page, "big")
        return int.from_bytes(pages, "big") * (65536 if size == 1 else size)

    def _head(self, number: int) -> bytes:
        channel, log_ns, size = self._row(number)
        head = RECORD_HEAD.pack(Opcode.MESSAGE, MESSAGE_HEAD.size + size)
        return head + MESSAGE_HEAD.pack(channel, 0, log_ns, log_ns)

    def _row(self, number: int) -> tuple[int, int, int]:
        """Channel, log time [ns] and bytes of a message."""
        try:
            row = self._connection().execute(_ROW, (number,)).fetchone()
        except (sqlite3.Error, OverflowError) as error:
            raise damage(error) from error
        if row is None or row[3] != "blob":
            raise DamageError("no message where one should be")
        check_row(*row[:2])
        return row[0], row[1], row[2]

    def _connection(self) -> sqlite3.Connection:
        """This thread's connection."""
        try:
            return self._of_thread.connection
        except AttributeError:
            pass
        self.check_unchanged()
        address = f"{self.path.resolve().as_uri()}?mode=ro&immutable=1"
        try:
            found = sqlite3.connect(address, uri=True, check_same_thread=False)
            self._connections.append(found)
            # Of a file that ends early what is there can be read.
            found.execute("PRAGMA writable_schema = ON")
            found.execute("PRAGMA trusted_schema = OFF")
        except sqlite3.Error as error:
            raise damage(error) from error
        self._of_thread.connection = found
        return found

    def _check(self) -> None:
        """Whether this is a recording, whole and not compressed.

        Raises:
            InputError: It isn't.
        """
        for suffix in ("-wal", "-journal"):
            beside = self.path.with_name(self.path.name + suffix)
            if beside.exists() and beside.stat().st_size:
                problem = f"the recording was not closed: {beside.name} holds part of it"
                raise InputError(
                    problem,
                    path=str(self.path),
                    remedy="on a copy, run sqlite3 FILE 'PRAGMA wal_checkpoint(TRUNCATE)'",
                )
        try:
            tables = {row[0] for row in self.query(_TABLES)}
            first = self.query(_FIRST).fetchone() if tables >= _NEEDED else None
        except (sqlite3.Error, DamageError) as error:
            problem = str(error if isinstance(error, DamageError) else damage(error))
            remedy = "recover it with sqlite3 FILE .recover, or leave it out"
            raise InputError(problem, path=str(self.path), remedy=remedy) from error
        if not tables >= _NEEDED:
            problem = "not a rosbag2 recording: it has no tables messages and topics"
            raise InputError(problem, path=str(self.path), remedy="leave it out")
        if first and bytes(first[0] or b"") == _ZSTD:
            problem = "its messages are compressed one by one"
            remedy = f"convert it: rosbags-convert --src {self.path.parent} --dst NEW "
            remedy += "--dst-storage mcap"
            raise InputError(problem, path=str(self.path), remedy=remedy)


_TABLES = "SELECT name FROM sqlite_master WHERE type = 'table'"
_NEEDED = {"messages", "topics"}
_FIRST = "SELECT substr(data, 1, 4) FROM messages LIMIT 1"


def check_row(channel: Any, log_ns: Any) -> None:
    """Whether channel and log time [ns] of a message are such.

    Raises:
        DamageError: One is out of range.
    """
    if not isinstance(channel, int) or not 0 <= channel <= _MAX_CHANNEL:
        raise DamageError("number of a topic is out of range")
    if not isinstance(log_ns, int) or log_ns < 0:
        raise DamageError("time of a message is out of range")


def position_of(number: int) -> int:
    """The position of a message.

    Raises:
        DamageError: Its number is out of range.
    """
    if not 0 <= number <= MAX_ID:
        raise DamageError("number of a message is out of range")
    return number << POSITION_BITS


def damage(error: Exception) -> DamageError:
    """What SQLite says, as damage."""
    return DamageError(f"the SQLite file can't be read ({error})")
