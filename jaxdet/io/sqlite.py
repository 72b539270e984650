"""ROS 2's SQLite recordings (``.db3`` of rosbag2).

A message's number is its ``id``; SQLite gives any part of a blob without reading all of it.
Source: rosbag2's ``rosbag2_storage_sqlite3``, schemas 1 to 4.
"""

import math
import sqlite3
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from threading import local
from typing import Any

from jaxdet.errors import InputError
from jaxdet.io.chunks import DamageError
from jaxdet.io.container import FileState, LogFile
from jaxdet.io.message_file import MessageFile, MessageRow

_ROW = "SELECT topic_id, timestamp, length(data), typeof(data) FROM messages WHERE id = ?"
_TABLES = "SELECT name FROM sqlite_master WHERE type = 'table' AND rootpage > 0"
_XINFO = "table_xinfo"
"""Pragma that lists the columns of a table, the generated ones too."""
_HIDDEN = 6
_READ = {"sqlite_master", "messages", "topics", "message_definitions"}
_FUNCTIONS = {"length", "typeof", "count", "max"}
_MAX_BYTES = (1 << 31) - 1
_STEPS = 1_000_000
"""Instructions of SQLite's virtual machine between two looks at the clock, some milliseconds."""
_PATIENCE_S, _BYTES_PER_S = 5.0, 50 << 20
"""The next row of a query may take so long, and a second more for so many bytes of the file."""
_NEEDED = {"messages", "topics"}


class SqliteFile(MessageFile):
    """A rosbag2 recording in SQLite; it is never written to."""

    magic = b"SQLite format 3\0"
    kind = "a rosbag2 SQLite"
    tables: frozenset[str] | set[str] = frozenset()
    """Tables of a recording that the file has; views are none."""

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

    def query(
        self, text: str, values: Sequence[object] | Mapping[str, object] = ()
    ) -> Iterator[tuple[Any, ...]]:
        """The rows of a query.

        Raises:
            DamageError: SQLite can't go on.
        """
        patience_s = _PATIENCE_S + self.size / _BYTES_PER_S
        try:
            rows = self._connection().execute(text, values)
            while True:
                self._of_thread.until = time.monotonic() + patience_s
                row = next(rows, None)
                if row is None:
                    return
                yield row
        except (sqlite3.Error, OverflowError) as error:
            raise damage(error) from error

    def read_payload(self, number: int, start: int, parts: Sequence[memoryview]) -> None:
        """Fills writable byte views with a message's data from ``start``, one after the other.

        Raises:
            DamageError: They end before, or can't be read.
        """
        try:
            with self._connection().blobopen("messages", "data", number, readonly=True) as blob:
                blob.seek(start)
                for part in parts:
                    data = blob.read(len(part))
                    if len(data) != len(part):
                        raise DamageError("message ends early")
                    part[:] = data
        except (sqlite3.Error, OverflowError, ValueError) as error:
            raise damage(error) from error

    @property
    def declared_bytes(self) -> int:
        """Bytes of the file, by its own head."""
        page, pages = LogFile.read(self, 16, 2), LogFile.read(self, 28, 4)
        size = int.from_bytes(page, "big")
        return int.from_bytes(pages, "big") * (65536 if size == 1 else size)

    def row(self, number: int) -> MessageRow:
        """What is known of a message.

        Raises:
            DamageError: There is none, or it can't be read.
        """
        row = next(self.query(_ROW, (number,)), None)
        if row is None or row[3] != "blob":
            raise DamageError("no message where one should be")
        return MessageRow(*row[:3]).check()

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
            found.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, min(self.max_bytes, _MAX_BYTES))
            found.set_authorizer(_authorize)
            found.set_progress_handler(self._takes_too_long, _STEPS)
        except sqlite3.Error as error:
            raise damage(error) from error
        self._of_thread.connection = found
        return found

    def _takes_too_long(self) -> bool:
        """Whether this thread's query takes longer than any recording's does; ends it then."""
        return time.monotonic() > getattr(self._of_thread, "until", math.inf)

    def _check(self) -> None:
        """Whether this is a recording, and closed.

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
            self.tables = tables & _READ
            made = {
                f"{table}.{row[1]}"
                for table in sorted(self.tables)
                for row in self.query(f"PRAGMA {_XINFO}({table})")
                if row[_HIDDEN]
            }
        except DamageError as error:
            remedy = "recover it with sqlite3 FILE .recover, or leave it out"
            raise InputError(str(error), path=str(self.path), remedy=remedy) from error
        if not tables >= _NEEDED:
            problem = "not a rosbag2 recording: it has no tables messages and topics"
            raise InputError(problem, path=str(self.path), remedy="leave it out")
        if made:
            problem = f"not a rosbag2 recording: columns are generated ({', '.join(sorted(made))})"
            raise InputError(problem, path=str(self.path), remedy="leave it out")


def _authorize(action: int, first: str | None, second: str | None, *_: object) -> int:
    """Allow reading a recording's tables, and nothing else: no views, no functions of theirs."""
    allowed = {
        sqlite3.SQLITE_SELECT: True,
        sqlite3.SQLITE_READ: first in _READ,
        sqlite3.SQLITE_FUNCTION: second in _FUNCTIONS,
        sqlite3.SQLITE_PRAGMA: first == _XINFO,
    }
    return sqlite3.SQLITE_OK if allowed.get(action) else sqlite3.SQLITE_DENY


def damage(error: Exception) -> DamageError:
    """What SQLite says, as damage."""
    return DamageError(f"the SQLite file can't be read ({error})")
