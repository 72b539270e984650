"""The index of a rosbag2 recording in SQLite: by its tables, or row by row around damage."""

from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from itertools import islice
from typing import Any

import numpy as np

from jaxdet.io.chunks import PAYLOAD_OFFSET, DamageError
from jaxdet.io.declarations import ChannelInfo
from jaxdet.io.definition import DEFINITIONS, schema_text
from jaxdet.io.file_index import FileIndex, file_index
from jaxdet.io.integrity import FileIntegrity
from jaxdet.io.limits import MAX_SCHEMA_BYTES, check_topics
from jaxdet.io.message_file import MessageRow, indexed_messages, position_of
from jaxdet.io.messages import kind_of
from jaxdet.io.sqlite import SqliteFile, damage
from jaxdet.io.walk import Walk

_ROWS_AT_ONCE = 1 << 14
_DAMAGED = "page is damaged"
_MAX_LOST = 100_000
"""Numbers tried one by one where pages are damaged; a few seconds."""
_INDEX = "SELECT id, topic_id, timestamp, length(data) FROM messages ORDER BY id"
_DATA = """SELECT id, topic_id, timestamp,
CASE WHEN length(data) <= :most THEN data END, length(data)
FROM messages WHERE id > :before ORDER BY id LIMIT :count"""
_WITHOUT_DATA = """SELECT id, topic_id, timestamp, NULL, length(data)
FROM messages WHERE id > :before ORDER BY id LIMIT :count"""
_COUNT = "SELECT count(*) FROM messages INDEXED BY timestamp_idx"
_GREATEST = "SELECT max(id) FROM messages INDEXED BY timestamp_idx WHERE timestamp >= 0"
_TOPICS = "SELECT id, name, type, serialization_format FROM topics ORDER BY id"
_DEFINITIONS = """SELECT topic_type, encoding, encoded_message_definition
FROM message_definitions WHERE length(encoded_message_definition) <= ? ORDER BY id"""


def read_sqlite_index(file: SqliteFile) -> FileIndex:
    """What the tables of a recording tell, but for the data of messages.

    Raises:
        DamageError: A table can't be read as a whole.
    """
    if file.declared_bytes > file.size:
        raise DamageError("file ends early")
    infos = _channels(file)
    rows, parts = file.query(_INDEX), [np.zeros((4, 0), np.int64)]
    try:
        while some := list(islice(rows, _ROWS_AT_ONCE)):
            parts.append(np.array(some, np.int64).T)
    except (OverflowError, TypeError, ValueError) as error:
        raise damage(error) from error
    number, channel, log_ns, size = np.concatenate(parts, axis=1)
    file.check_messages(len(number))
    for value in (channel.min(initial=0), channel.max(initial=0)):
        MessageRow(int(value), int(log_ns.min(initial=0)), 0).check()
    if (np.diff(number) <= 0).any():
        raise DamageError("numbers of messages are out of order")
    for value in (number.min(initial=0), number.max(initial=0)):
        position_of(int(value))
    if _declared(file) not in (None, len(number)):
        raise DamageError("index of times contradicts the messages")
    messages = indexed_messages(number, channel, log_ns, size)
    return file_index(infos, messages, FileIntegrity(file.path, by_index=True))


def rebuild_sqlite_index(file: SqliteFile) -> FileIndex:
    """The index of every readable message, with what was lost.

    Where SQLite finds a page damaged, the walk goes on at the next message that it can reach. Of
    a message whose data are damaged the topic is known mostly; else its number is counted as lost.

    Raises:
        InputError: The file was changed meanwhile, or holds more messages than it has room for.
    """
    problem, infos = "", {}
    try:
        infos = _channels(file)
    except DamageError as error:
        problem = str(error)
    walk, missing = Walk(file), Counter[str]()
    for number, channel, log_ns, data, size in _rows(file, walk.lost):
        try:
            MessageRow(channel, log_ns, size).check()
            position = position_of(number)
            if channel not in infos:
                raise DamageError("message of an undeclared topic")
            if not isinstance(data, bytes):
                missing[infos[channel].topic] += 1
                raise DamageError("message is damaged or larger than --log.max-chunk-mib")
        except DamageError as error:
            walk.lose(str(error), size or 0)
            continue
        walk.add(channel, infos[channel], log_ns, position, len(data) + PAYLOAD_OFFSET, 0)
    return walk.index(
        declared_messages=_declared(file),
        has_end=file.declared_bytes <= file.size,
        missing=dict(missing),
        summary_problem=problem,
    )


def _rows(file: SqliteFile, lost: Counter[str]) -> Iterator[tuple[Any, ...]]:
    """Number, topic, log time, data and their bytes of all messages that can be reached.

    The data are None where they can't be read.
    """
    before, last = -1, _last_number(file)

    def after(text: str, count: int) -> Iterator[tuple[Any, ...]]:
        values = {"most": file.max_bytes, "before": before, "count": count}
        return file.query(text, values)

    def comes_next(row: tuple[Any, ...]) -> bool:  # a damaged page may lead back
        return isinstance(row[0], int) and row[0] > before

    while before < last and lost[_DAMAGED] < _MAX_LOST:
        with suppress(DamageError):
            for row in after(_DATA, -1):
                if comes_next(row):
                    yield row
                    before = row[0]
            return
        # The next one may be whole: what SQLite could not read can come after it.
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
    """The greatest number of a message, by the messages or by the index of their times."""
    numbers = [0]
    for text in ("SELECT max(id) FROM messages", _GREATEST):
        with suppress(DamageError):
            numbers += [number or 0 for (number,) in file.query(text)]
    return max(numbers)


def _declared(file: SqliteFile) -> int | None:
    """How many messages the index of their times has; None where it can't be read."""
    with suppress(DamageError):
        for (count,) in file.query(_COUNT):
            return int(count)
    return None


def _channels(file: SqliteFile) -> dict[int, ChannelInfo]:
    """The topics with their definitions; where the file has none (before ROS 2 Iron), ROS 2's.

    Raises:
        DamageError: The table can't be read.
    """
    topics, known = list(file.query(_TOPICS)), {}
    check_topics(len(topics), str(file.path))
    with suppress(DamageError):
        rows = file.query(_DEFINITIONS, (MAX_SCHEMA_BYTES,))
        known = {row[0]: row[1:] for row in (rows if "message_definitions" in file.tables else ())}
    found = {}
    for number, topic, name, encoding in topics:
        schema, text = known.get(name) or ("ros2msg", _definition(str(name)))
        data = str(text).encode()
        useful = kind_of(str(name)) is not None
        kept = data if useful else b""
        found[number] = ChannelInfo(
            str(topic), str(encoding), str(name), str(schema), kept, len(data)
        )
    return found


def _definition(name: str) -> str:
    plain = name.replace("/msg/", "/")
    return schema_text(plain) if plain in DEFINITIONS else ""
