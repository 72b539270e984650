"""The index of a ROS 1 bag."""

from collections import Counter
from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from jaxdet.io.bag import (
    CHUNK,
    CHUNK_INFO,
    CONNECTION,
    INDEX,
    MAX_CONNECTION,
    BagFile,
    BagRecord,
    fields,
    records,
)
from jaxdet.io.chunks import PAYLOAD_OFFSET, DamageError
from jaxdet.io.declarations import ChannelInfo
from jaxdet.io.file_index import FileIndex, file_index
from jaxdet.io.integrity import FileIntegrity
from jaxdet.io.limits import MAX_SCHEMA_BYTES, MAX_SCHEMAS_BYTES
from jaxdet.io.messages import kind_of

_ENTRY = np.dtype([("sec", "<u4"), ("nanosec", "<u4"), ("offset", "<u4")])
_COUNT = np.dtype([("connection", "<u4"), ("messages", "<u4")])
_INDEX_VERSION = 1


class _End(NamedTuple):
    """What stands at the end of a bag."""

    connections: dict[int, ChannelInfo]
    counts: dict[int, dict[int, int]]
    """The messages of each connection in each chunk, by its position."""


def read_bag_index(file: BagFile) -> FileIndex:
    """What a bag's index tells.

    Raises:
        DamageError: It is torn or wrong.
    """
    end = _read_end(file)
    parts = [np.zeros((5, 0), np.int64)]
    for position, after in pairwise([*sorted(end.counts), file.index]):
        parts += _chunk_index(file, position, after, end.counts[position])
    messages = np.concatenate(parts, axis=1)
    file.check_messages(messages.shape[1])
    known = FileIntegrity(file.path, chunks=len(end.counts), by_index=True)
    return file_index(dict(sorted(end.connections.items())), messages, known)


def rebuild_bag_index(file: BagFile) -> FileIndex:
    """The same index, where messages can't be read that are in it.

    Raises:
        InputError: It is torn or wrong.
    """
    try:
        found = read_bag_index(file)
    except DamageError as error:
        raise file.without_index(str(error)) from error
    return found._replace(integrity=found.integrity._replace(by_index=False))


def _read_end(file: BagFile) -> _End:
    """What stands at the end of a bag.

    Raises:
        DamageError: It is missing or damaged.
    """
    head, start = file.head, file.index
    if not head.end <= start < file.size:
        raise DamageError("index leaves the file")
    file.check_size(file.size - start, "index")
    data = file.read(start, file.size - start)
    found, used = _End({}, {}), 0
    for record in records(data):
        content = data[record.data : record.end]
        if record.op == CONNECTION:
            number = record.number(b"conn")
            if number > MAX_CONNECTION:
                raise DamageError("connection number is out of range")
            info = _connection(record, fields(content))
            used += len(info.topic) + len(info.schema_name) + len(info.schema_data)
            if used > MAX_SCHEMAS_BYTES:
                raise DamageError("connections take too much memory")
            found.connections.setdefault(number, info)
        elif record.op == CHUNK_INFO:
            position = record.number(b"chunk_pos", 8)
            if not head.end <= position < start or len(content) % _COUNT.itemsize:
                raise DamageError("index leaves the file")
            found.counts[position] = dict(np.frombuffer(content, _COUNT).tolist())
    if len(found.counts) != head.number(b"chunk_count"):
        raise DamageError("index lacks chunks")
    return found


def _connection(record: BagRecord, about: dict[bytes, bytes]) -> ChannelInfo:
    topic = record.fields.get(b"topic", about.get(b"topic", b"")).decode("utf-8", "replace")
    name = about.get(b"type", b"").decode("utf-8", "replace")
    text = about.get(b"message_definition", b"")
    kept = text if kind_of(name) is not None and len(text) <= MAX_SCHEMA_BYTES else b""
    return ChannelInfo(topic, "ros1", name, "ros1msg", kept, len(text))


def _chunk_index(
    file: BagFile, position: int, end: int, counts: dict[int, int]
) -> Iterator[np.ndarray]:
    """Connection, log time, chunk, its length and offset ``(5, N)`` of a chunk's messages.

    Raises:
        DamageError: The index of the chunk isn't what it should be.
    """
    chunk = file.record(position, end)
    size = chunk.number(b"size")
    if chunk.op != CHUNK or size > file.max_bytes or end - chunk.end > file.max_bytes:
        raise DamageError("no chunk where one should be")
    data = file.read(chunk.end, end - chunk.end)
    seen: Counter[int] = Counter()
    for record in records(data):
        if record.op != INDEX:
            continue
        number, content = record.number(b"conn"), data[record.data : record.end]
        if record.number(b"ver") != _INDEX_VERSION or len(content) % _ENTRY.itemsize:
            raise DamageError("message index is damaged")
        entries = np.frombuffer(content, _ENTRY)
        found = np.empty((5, len(entries)), np.int64)
        found[0], found[2], found[3] = number, position, chunk.size
        found[1] = entries["sec"].astype(np.int64) * 1_000_000_000 + entries["nanosec"]
        found[4] = entries["offset"]
        if len(entries) and found[4].max() > size - PAYLOAD_OFFSET:
            raise DamageError("message index leaves its chunk")
        seen[number] += len(entries)
        yield found
    if +seen != +Counter(counts):
        raise DamageError("message indexes contradict the index of the chunks")
