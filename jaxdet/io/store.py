"""The chunks of a log's files: decompressed once, checked once, the latest kept."""

from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from threading import Lock
from typing import NamedTuple, TypeVar

from jaxdet.cores import cores
from jaxdet.io.chunks import ChunkHead, DamageError
from jaxdet.io.container import LogFile
from jaxdet.io.limits import ReadMemory

T = TypeVar("T")
R = TypeVar("R")

CACHE_BYTES = 64 << 20
"""Of decompressed chunks that are kept, or one if it is larger."""
BEGIN_BYTES = 4096
"""Of a large packed chunk's records, which may be read alone."""
LARGE_BYTES = 1 << 18
_MAX_HEADS = 4096


class Place(NamedTuple):
    """A chunk of a log."""

    file: int
    """Number of the file."""
    position: int
    """Of the chunk, see :meth:`jaxdet.io.container.LogFile.chunk_head`."""


class ChunkStore:
    """Gives bytes of chunks; threads may share it.

    Args:
        files: The log's open files.
        threads: How many load and decode; 1: only the caller's. None: one a core.
        cache_bytes: Of decompressed chunks that are kept, or one if it is larger.
        most_bytes: Of these, whatever :meth:`keep` asks for.
    """

    def __init__(
        self,
        files: Sequence[LogFile],
        threads: int | None = None,
        cache_bytes: int = CACHE_BYTES,
        most_bytes: int = ReadMemory().chunk,
    ) -> None:
        self.files, self._most_bytes = files, most_bytes
        self.cache_bytes = min(cache_bytes, most_bytes)
        self.checked: set[Place] = set()
        """Chunks that were read as a whole, and are as their CRC says."""
        self.threads = threads or cores()
        several = self.threads > 1
        self._pool = ThreadPoolExecutor(self.threads, "jaxdet-read") if several else None
        self._heads: OrderedDict[Place, ChunkHead] = OrderedDict()
        self._chunks: OrderedDict[Place, bytes | memoryview] = OrderedDict()
        self._ahead: set[Place] = set()
        self._bytes = 0
        self._lock = Lock()

    def __reduce__(self) -> tuple:
        """In another process one thread loads and decodes, as processes share the cores."""
        return ChunkStore, (self.files, 1, self.cache_bytes, self._most_bytes)

    def keep(self, nbytes: int) -> None:
        """Keep at least so many bytes of chunks, if there is room."""
        self.cache_bytes = min(max(self.cache_bytes, nbytes), self._most_bytes)

    def close(self) -> None:
        """Stop the threads and close the files."""
        if self._pool:
            self._pool.shutdown(cancel_futures=True)
        for file in self.files:
            file.close()

    def check_unchanged(self) -> None:
        """Check that the files are what they were when they were opened.

        Raises:
            InputError: One isn't.
        """
        for file in self.files:
            file.check_unchanged()

    def map(self, function: Callable[[T], R], items: Sequence[T]) -> Iterable[R]:
        """``function`` of each item, in order, by all threads."""
        return (
            self._pool.map(function, items)
            if self._pool and len(items) > 1
            else map(function, items)
        )

    def waves(self, places: Iterable[Place]) -> Iterator[list[Place]]:
        """Chunks in order, as many together as are kept in memory."""
        wave: list[Place] = []
        total = 0
        for place in places:
            size = self._size(place)
            if wave and total + size > self.cache_bytes:
                yield wave
                wave, total = [], 0
            wave.append(place)
            total += size
        if wave:
            yield wave

    def head(self, place: Place) -> ChunkHead:
        """Return the head of a chunk.

        Raises:
            DamageError: There is none.
        """
        head = self._heads.get(place)
        if head is None:
            head = self.files[place.file].chunk_head(place.position)
            with self._lock:
                self._heads[place] = head
                while len(self._heads) > _MAX_HEADS:
                    self._heads.popitem(last=False)
        return head

    def data(self, place: Place, ahead: bool = False) -> bytes | memoryview:
        """Return the records of a chunk, checked against its CRC.

        Args:
            place: The chunk.
            ahead: It is only looked at, and kept until it is used.

        Raises:
            DamageError: It can't be read.
        """
        size = self._size(place)
        with self._lock:
            if not ahead:
                self._ahead.discard(place)
            if place in self._chunks:
                self._chunks.move_to_end(place)
                return self._chunks[place]
            while self._chunks and self._bytes + size > self.cache_bytes:
                self._drop_one()
        data = self.files[place.file].chunk(place.position)
        with self._lock:
            if place not in self._chunks:
                self._chunks[place] = data
                self._bytes += len(data)
                if ahead:
                    self._ahead.add(place)
            self.checked.add(place)
        return data

    def loaded(self, places: Iterable[Place]) -> Iterator[Place]:
        """Chunks in order; those of a wave that are packed are decompressed by all threads.

        One that can't be read raises a DamageError where its bytes are used.
        """
        for wave in self.waves(places):
            for _ in self.map(self._load, [place for place in wave if self._is_packed(place)]):
                pass
            yield from wave

    def _is_packed(self, place: Place) -> bool:
        try:
            return not self.head(place).is_plain
        except DamageError:
            return False

    def _load(self, place: Place) -> None:
        """Decompresses a packed chunk, which is kept until it is used."""
        with suppress(DamageError):
            self.data(place, ahead=True)

    def _drop_one(self) -> None:
        """Drop the least recently used chunk; one that waits for its use only if all do."""
        used = (place for place in self._chunks if place not in self._ahead)
        place = next(used, next(iter(self._chunks)))
        self._ahead.discard(place)
        self._bytes -= len(self._chunks.pop(place))

    def check(self, place: Place) -> None:
        """Check a chunk against its CRC, if it has one.

        Raises:
            DamageError: It is not.
        """
        if place in self.checked:
            return
        head = self.head(place)
        if not head.is_plain:
            self.data(place, ahead=True)
        elif head.crc:
            self.files[place.file].chunk(place.position)
            self.checked.add(place)

    def peek(self, place: Place, offset: int, size: int, *, whole: bool = True) -> memoryview:
        """Return up to ``size`` bytes of a chunk's records, without the CRC if it isn't packed.

        Args:
            place: The chunk.
            offset: In its records.
            size: Of what is read.
            whole: Whether a packed chunk is read whole. If not, bytes near its begin are read
                without its CRC, where it isn't in memory.

        Raises:
            DamageError: The chunk can't be read.
        """
        head = self.head(place)
        if not head.is_plain:
            near = head.uncompressed_size >= LARGE_BYTES and offset + size <= BEGIN_BYTES
            if not whole and near and place not in self._chunks:
                known = self.files[place.file].chunk_begin(place.position, offset + size)
                if len(known) == offset + size:
                    return memoryview(known)[offset:]
            return memoryview(self.data(place, ahead=True))[offset : offset + size]
        size = min(size, head.uncompressed_size - offset)
        self.files[place.file].check_memory(size, "message")
        start = place.position + head.data_offset
        return memoryview(self.files[place.file].read(start + offset, max(size, 0)))

    def _size(self, place: Place) -> int:
        try:
            return min(self.head(place).uncompressed_size, self.files[place.file].max_bytes)
        except DamageError:
            return 0
