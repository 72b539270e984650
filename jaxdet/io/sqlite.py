"""ROS 2 recordings in SQLite (``.db3`` of rosbag2).

The number of a message is its ``rowid``, which is ``id`` unless a tool copied the table without its
primary key; SQLite can read any part of a blob separately. The tables are
the file's own index; if pages are damaged, the tables are read row by row. Source: rosbag2's
``rosbag2_storage_sqlite3``, schemas 1 to 4.
"""

import math
import sqlite3
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import islice
from pathlib import Path
from threading import local
from typing import Any

import numpy as np

from jaxdet.errors import InputError
from jaxdet.io.chunks import DamageError
from jaxdet.io.container import MessageFile, MessageRow, Source, Walk
from jaxdet.io.declarations import ChannelInfo
from jaxdet.io.file_index import FileIndex, FileIntegrity, file_index
from jaxdet.io.limits import MAX_SCHEMA_BYTES, MAX_TOPICS, check_topics
from jaxdet.io.messages import kind_of

_ROW = "SELECT topic_id, timestamp, length(data), typeof(data) FROM messages WHERE rowid = ?"
_TABLES = "SELECT name FROM sqlite_master WHERE type = 'table' AND rootpage > 0"
_XINFO = "table_xinfo"
"""Pragma that lists the columns of a table, including generated ones."""
_HIDDEN = 6
_READ = {"sqlite_master", "messages", "topics", "message_definitions"}
_FUNCTIONS = {"length", "typeof", "count", "max"}
_MAX_BYTES = (1 << 31) - 1
_READ_VERSION, _WAL = 19, b"\2"
"""Position of the version needed to read the file, and that of files with a write-ahead log."""
_CHANGE, _SIZE_VALID_FOR = 24, 92
"""Positions of two numbers [byte]; if they are equal, the declared size of the file is valid."""
_STEPS = 20_000
"""Number of instructions of SQLite's virtual machine between two checks of the time limit; while
SQLite parses the tables of a file, an instruction may take much longer than usual."""
_PATIENCE_S, _BYTES_PER_S = 5.0, 50 << 20
"""Time limit for the next row of a query [s]: a constant, plus one second per this many bytes of
the file."""
_NEEDED, _MAX_TABLES = {"messages", "topics"}, 1000
_ROWS_AT_ONCE = 1 << 14
_DAMAGED = "page is damaged"
_MAX_LOST = 100_000
"""Maximum number of ids that are tried one by one if pages are damaged; this takes a few seconds.
"""
_INDEX = "SELECT topic_id, timestamp, rowid FROM messages ORDER BY rowid"
_DATA = """SELECT rowid, topic_id, timestamp,
CASE WHEN length(data) <= :most THEN data END, length(data)
FROM messages WHERE rowid > :before ORDER BY rowid LIMIT :count"""
_WITHOUT_DATA = """SELECT rowid, topic_id, timestamp, NULL, length(data)
FROM messages WHERE rowid > :before ORDER BY rowid LIMIT :count"""
_COUNT = "SELECT count(*) FROM messages INDEXED BY timestamp_idx"
_GREATEST = "SELECT max(rowid) FROM messages INDEXED BY timestamp_idx WHERE timestamp >= 0"
_TOPICS = "SELECT id, name, type, serialization_format FROM topics ORDER BY id"
_DEFINITIONS = """SELECT topic_type, encoding, encoded_message_definition
FROM message_definitions ORDER BY id"""


class SqliteFile(MessageFile):
    """A rosbag2 recording in SQLite, opened read-only."""

    magic = b"SQLite format 3\0"
    tables: frozenset[str] | set[str] = frozenset()
    """Tables of a recording that exist in the file, without views."""

    def __init__(self, path: Path, max_bytes: int, source: Source | None = None) -> None:
        super().__init__(path, max_bytes, source)
        self._of_thread = local()
        self._connections: list[sqlite3.Connection] = []
        try:
            self._check()
            if self.read(_CHANGE, 4) == self.read(_SIZE_VALID_FOR, 4):
                self.note_unread(self.size - self.declared_bytes)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the file."""
        for connection in self._connections:
            connection.close()
        self._connections = []
        super().close()

    def read_index(self) -> FileIndex:
        """Read the index from the tables, see :meth:`LogFile.read_index`."""
        if self.declared_bytes > self.size:
            raise DamageError("file ends early")
        infos = _channels(self)
        rows, parts, count = self.query(_INDEX), [np.zeros((4, 0), np.int64)], 0
        try:
            while some := list(islice(rows, _ROWS_AT_ONCE)):
                parts.append(np.zeros((4, len(some)), np.int64))
                parts[-1][:3] = np.array(some, np.int64).T
                count += len(some)
                self.check_messages(count)
        except (OverflowError, TypeError, ValueError) as error:
            raise _damage(error) from error
        messages = np.concatenate(parts, axis=1)
        channel, log_ns, number = messages[:3]
        for value in (channel.min(initial=0), channel.max(initial=0)):
            MessageRow(int(value), int(log_ns.min(initial=0)), 0).check()
        if (np.diff(number) <= 0).any():
            raise DamageError("numbers of messages are out of order")
        if number.min(initial=0) < 0:
            raise DamageError("number of a message is out of range")
        if _declared(self) not in (None, len(number)):
            raise DamageError("index of times contradicts the messages")
        return file_index(infos, messages, FileIntegrity(self.path, by_index=True))

    def rebuild_index(self) -> FileIndex:
        """Build an index of all readable messages, with statistics of what was lost.

        If a page is damaged, the scan continues at the next reachable message. The topic of a
        message with damaged data can usually be read; if not, only its id is counted as lost.

        Raises:
            InputError: The file was changed meanwhile, or has an impossible number of messages.
        """
        problem, infos = "", {}
        try:
            infos = _channels(self)
        except DamageError as error:
            problem = str(error)
        walk, missing = Walk(self), Counter[str]()
        for number, channel, log_ns, data, size in _rows(self, walk.lost):
            try:
                MessageRow(channel, log_ns, size).check()
                if channel not in infos:
                    raise DamageError("message of an undeclared topic")
                if not isinstance(data, bytes):
                    missing[infos[channel].topic] += 1
                    raise DamageError("message is damaged or larger than --log.max-chunk-mib")
            except DamageError as error:
                walk.lose(str(error), size or 0)
                continue
            walk.add(channel, log_ns, number, 0)
        return walk.index(
            infos,
            declared_messages=_declared(self),
            has_end=self.declared_bytes <= self.size,
            missing=dict(missing),
            summary_problem=problem,
        )

    def query(
        self,
        text: str,
        values: Sequence[object] | Mapping[str, object] = (),
        most: int = _MAX_BYTES,
    ) -> Iterator[tuple[Any, ...]]:
        """Yield the rows of a query, which may use values of up to ``most`` bytes.

        Raises:
            DamageError: SQLite reports an error.
        """
        patience_s = _PATIENCE_S + self.size / _BYTES_PER_S
        try:
            connection = self._connection()
            connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, min(self.max_bytes, most))
            self._of_thread.until = time.monotonic() + patience_s
            rows = connection.execute(text, values)
            while True:
                self._of_thread.until = time.monotonic() + patience_s
                row = next(rows, None)
                if row is None:
                    return
                yield row
        except (sqlite3.Error, OverflowError) as error:
            raise _damage(error) from error

    def payload(self, number: int, most: int) -> bytes:
        """Return the first bytes of a message's data, see :meth:`MessageFile.payload`."""
        try:
            with self._connection().blobopen("messages", "data", number, readonly=True) as blob:
                return blob.read(most)
        except (sqlite3.Error, OverflowError, ValueError) as error:
            raise _damage(error) from error

    @property
    def declared_bytes(self) -> int:
        """Size of the file according to its header [byte]."""
        page, pages = self.read(16, 2), self.read(28, 4)
        size = int.from_bytes(page, "big")
        return int.from_bytes(pages, "big") * (65536 if size == 1 else size)

    def row(self, number: int) -> MessageRow:
        """Return channel, log time and size of a message.

        Raises:
            DamageError: The message does not exist, or can't be read.
        """
        row = next(self.query(_ROW, (number,)), None)
        if row is None or row[3] != "blob":
            raise DamageError("no message at the expected position")
        return MessageRow(*row[:3]).check()

    def _connection(self) -> sqlite3.Connection:
        """Return the connection of this thread."""
        try:
            return self._of_thread.connection
        except AttributeError:
            pass
        self.check_unchanged()
        address = f"{self.source.path.resolve().as_uri()}?mode=ro&immutable=1"
        try:
            found = sqlite3.connect(address, uri=True, check_same_thread=False)
            self._connections.append(found)
            # so that the available part of a truncated file can be read
            found.execute("PRAGMA writable_schema = ON")
            found.execute("PRAGMA trusted_schema = OFF")
            found.set_authorizer(_authorize)
            found.set_progress_handler(self._takes_too_long, _STEPS)
        except sqlite3.Error as error:
            raise _damage(error) from error
        self._of_thread.connection = found
        return found

    def _takes_too_long(self) -> bool:
        """Return whether the query of this thread exceeds its time limit; SQLite then aborts it."""
        return time.monotonic() > getattr(self._of_thread, "until", math.inf)

    def _check(self) -> None:
        """Check that the file is a recording, and was closed.

        Raises:
            InputError: The file is not a recording, or was not closed.
        """
        for suffix in ("-wal", "-journal"):
            journal = self.path.with_name(self.path.name + suffix)
            if journal.exists() and journal.stat().st_size:
                problem = f"the recording was not closed, {journal.name} has part of it"
                raise InputError(
                    problem,
                    path=str(self.path),
                    remedy="run sqlite3 FILE 'PRAGMA wal_checkpoint(TRUNCATE)' on a copy",
                )
        try:
            tables = {row[0] for row in islice(self.query(_TABLES), _MAX_TABLES + 1)}
            self.tables = tables & _READ
            made = {
                f"{table}.{row[1]}"
                for table in sorted(self.tables)
                for row in self.query(f"PRAGMA {_XINFO}({table})")
                if row[_HIDDEN]
            }
        except DamageError as error:
            remedy = "recover it with sqlite3 FILE .recover, or exclude it"
            raise InputError(str(error), path=str(self.path), remedy=remedy) from error
        if len(tables) > _MAX_TABLES:
            problem = f"not a rosbag2 recording: it has more than {_MAX_TABLES} tables"
            raise InputError(problem, path=str(self.path), remedy="exclude it")
        if not tables >= _NEEDED:
            problem = "not a rosbag2 recording: the tables messages and topics are missing"
            remedy = "exclude it"
            if self.read(_READ_VERSION, 1) == _WAL:
                remedy = f"if its recorder was stopped, copy {self.path.name}-wal with it"
            raise InputError(problem, path=str(self.path), remedy=remedy)
        if made:
            problem = f"not a rosbag2 recording: generated columns ({', '.join(sorted(made))})"
            raise InputError(problem, path=str(self.path), remedy="exclude it")


def _authorize(action: int, first: str | None, second: str | None, *_: object) -> int:
    """Allow SQLite only to read the tables in ``_READ``, not views, and to call ``_FUNCTIONS``."""
    allowed = {
        sqlite3.SQLITE_SELECT: True,
        sqlite3.SQLITE_READ: first in _READ,
        sqlite3.SQLITE_FUNCTION: second in _FUNCTIONS,
        sqlite3.SQLITE_PRAGMA: first == _XINFO,
    }
    return sqlite3.SQLITE_OK if allowed.get(action) else sqlite3.SQLITE_DENY


def _damage(error: Exception) -> DamageError:
    """Convert an error of SQLite to a DamageError."""
    return DamageError(f"the SQLite file can't be read ({error})")


def _rows(file: SqliteFile, lost: Counter[str]) -> Iterator[tuple[Any, ...]]:
    """Yield id, topic, log time, data and data size of all reachable messages.

    The data are None if they can't be read.
    """
    before, last = -1, _last_number(file)

    def after(text: str, count: int) -> Iterator[tuple[Any, ...]]:
        values = {"most": file.max_bytes, "before": before, "count": count}
        return file.query(text, values)

    def comes_next(row: tuple[Any, ...]) -> bool:  # a damaged page may lead back to earlier rows
        return isinstance(row[0], int) and row[0] > before

    while before < last and lost[_DAMAGED] < _MAX_LOST:
        with suppress(DamageError):
            for row in after(_DATA, -1):
                if comes_next(row):
                    yield row
                    before = row[0]
            return
        # The next row may be intact even if SQLite could not reach it.
        for text in (_DATA, _WITHOUT_DATA):
            with suppress(DamageError):
                row = next(iter([*after(text, 1)]), None)
                if row and comes_next(row):
                    yield row
                    before = row[0]
                    break
        else:
            lost[_DAMAGED] += 1
            before += 1


def _last_number(file: SqliteFile) -> int:
    """Return the largest message id, from the messages or the index of their times."""
    numbers = [0]
    for text in ("SELECT max(rowid) FROM messages", _GREATEST):
        with suppress(DamageError):
            numbers += [number or 0 for (number,) in file.query(text)]
    return max(numbers)


def _declared(file: SqliteFile) -> int | None:
    """Return the number of messages in the index of their times; None if it can't be read."""
    with suppress(DamageError):
        for (count,) in file.query(_COUNT):
            return int(count)
    return None


def _channels(file: SqliteFile) -> dict[int, ChannelInfo]:
    """Return the topics with their definitions.

    Raises:
        DamageError: The table can't be read.
    """
    topics = list(islice(file.query(_TOPICS, most=MAX_SCHEMA_BYTES), MAX_TOPICS + 1))
    check_topics(len(topics), str(file.path))
    types, known, found = {name for _, _, name, _ in topics}, {}, {}
    rows = file.query(_DEFINITIONS, most=MAX_SCHEMA_BYTES)
    with suppress(DamageError):
        for name, *definition in rows if "message_definitions" in file.tables else ():
            if name in types:
                known[name] = definition
    for number, topic, name, encoding in topics:
        schema, text = known.get(name, ("", ""))
        data = str(text).encode()
        useful = kind_of(str(name)) is not None
        kept = data if useful else b""
        found[number] = ChannelInfo(
            str(topic), str(encoding), str(name), str(schema), kept, len(data)
        )
    return found
