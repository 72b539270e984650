"""The index of a ROS 1 bag: its own, or by a walk over the whole file.

A bag that was not closed has no index at its end; then, or where the index is torn, the walk takes
what is whole: it goes over damaged chunks, and ends where a record's length is damaged, but for
the chunks that the index at the end knows.
"""

from bisect import bisect_right
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import pairwise

import numpy as np
from mcap.opcode import Opcode

from jaxdet.io.bag import BAG, CHUNK, CHUNK_INFO, CONNECTION, INDEX, MAGIC, BagFile, records
from jaxdet.io.chunks import MESSAGE_HEAD, PAYLOAD_OFFSET, RECORD_HEAD, DamageError
from jaxdet.io.file_index import FileIndex, file_index
from jaxdet.io.integrity import FileIntegrity
from jaxdet.io.walk import TORN, FileRecord, Walk

_ENTRY = np.dtype([("sec", "<u4"), ("nanosec", "<u4"), ("offset", "<u4")])
_COUNT = np.dtype([("connection", "<u4"), ("messages", "<u4")])
_INDEX_VERSION = 1


def read_bag_index(file: BagFile) -> FileIndex:
    """What a bag's index tells.

    Raises:
        DamageError: It is missing, torn or wrong.
    """
    counts = _read_end(file)
    ends = [*sorted(counts), file.record(len(MAGIC)).number(b"index_pos", 8)]
    parts = [np.zeros((5, 0), np.int64)]
    for position, end in pairwise(ends):
        parts += _chunk_index(file, position, end, counts[position])
    messages = np.concatenate(parts, axis=1)
    file.check_messages(messages.shape[1])
    infos = dict(sorted(file.connections.items()))
    known = FileIntegrity(file.path, chunks=len(counts), by_index=True)
    return file_index(infos, messages, known)


def rebuild_bag_index(file: BagFile, pool: ThreadPoolExecutor) -> FileIndex:
    """The index of every readable message, with what was lost.

    Args:
        file: The file.
        pool: Decompresses chunks ahead.

    Raises:
        InputError: The file was changed meanwhile, or holds more messages than it has room for.
    """
    scan = _Scan(file)
    scan.walk.over(scan.records(), scan.take, pool)
    return scan.index()


def _read_end(file: BagFile) -> dict[int, dict[int, int]]:
    """The messages of each connection in each chunk, by its position; declares the connections.

    Raises:
        DamageError: The file's end is missing or damaged.
    """
    head = file.record(len(MAGIC))
    start = head.number(b"index_pos", 8) if head.op == BAG else 0
    if not head.end <= start < file.size:
        raise DamageError("no index: the bag was not closed")
    file.check_size(file.size - start, "index")
    data = file.read(start, file.size - start)
    found: dict[int, dict[int, int]] = {}
    for record in records(data):
        content = data[record.data : record.end]
        if record.op == CONNECTION:
            file.declare(record, content)
        elif record.op == CHUNK_INFO:
            position = record.number(b"chunk_pos", 8)
            if not head.end <= position < start or len(content) % _COUNT.itemsize:
                raise DamageError("index leaves the file")
            pairs = np.frombuffer(content, _COUNT).tolist()
            found[position] = dict(pairs)
    if len(found) != head.number(b"chunk_count"):
        raise DamageError("index lacks chunks")
    return found


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


class _Scan:
    """The state of one walk over a bag."""

    def __init__(self, file: BagFile) -> None:
        self.file, self.walk = file, Walk(file)
        self.chunks, self.problem = 0, ""
        try:
            self.counts = _read_end(file)
        except DamageError as error:
            self.counts, self.problem = {}, str(error)

    def records(self) -> Iterator[FileRecord]:
        """The chunks up to the file's end, and in their places what can't be one."""
        position, end = len(MAGIC), self.file.size
        chunks = sorted(self.counts)
        while position < end:
            try:
                record = self.file.record(position)
            except DamageError:
                place = bisect_right(chunks, position)
                start, position = position, chunks[place] if place < len(chunks) else end
                yield FileRecord(TORN, start, position - start)
                continue
            if record.op == CHUNK:
                yield FileRecord(Opcode.CHUNK, position, record.size)
            position = record.end

    def take(self, record: FileRecord, decompressed: Future[bytes | memoryview] | None) -> None:
        """Takes in a chunk.

        Raises:
            DamageError: It can't be used.
        """
        assert decompressed is not None  # all but chunks are passed over
        self.chunks += 1
        chunk = memoryview(decompressed.result())
        for place in _messages(chunk):
            number, _, log_ns, _ = MESSAGE_HEAD.unpack_from(chunk, place + RECORD_HEAD.size)
            info = self.file.connection(number, record.position)
            if info is None:
                raise DamageError("message of an undeclared connection")
            self.walk.add(number, info, log_ns, record.position, record.length, place)

    def index(self) -> FileIndex:
        """What was found, and of what the index speaks beside that."""
        declared: Counter[int] = Counter()
        for counts in self.counts.values():
            declared.update(counts)
        missing: Counter[str] = Counter()
        for number, count in sorted((declared - self.walk.read).items()):
            info = self.file.connections.get(number)
            missing[info.topic if info else f"connection {number}"] += count
        return self.walk.index(
            declared_messages=None if self.problem else declared.total(),
            chunks=self.chunks,
            has_end=not self.problem,
            missing=dict(missing),
            summary_problem=self.problem,
        )


def _messages(chunk: memoryview) -> Iterator[int]:
    """Where the messages of a chunk begin."""
    place = 0
    while place < len(chunk):
        opcode, length = RECORD_HEAD.unpack_from(chunk, place)
        if opcode == Opcode.MESSAGE:
            yield place
        place += RECORD_HEAD.size + length
