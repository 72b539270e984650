"""Cache of a log's decompressed chunks, each of which is decompressed and checked once."""

from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from threading import Lock
from typing import TypeVar

from jaxdet.cores import cores
from jaxdet.io.chunks import ChunkHead, DamageError
from jaxdet.io.container import LogFile
from jaxdet.io.file_index import Place
from jaxdet.io.limits import ReadMemory

T = TypeVar("T")
R = TypeVar("R")

CACHE_BYTES = 64 << 20
"""Size of the cache of decompressed chunks [byte]; a single larger chunk is kept as well."""
BEGIN_BYTES = 4096
"""Size of the beginning of a compressed chunk that may be read separately [byte]."""
_MAX_HEADS = 4096


class ChunkStore:
    """Thread-safe access to the bytes of chunks.

    Args:
        files: Open files of the log.
        threads: Number of threads that load and decode; 1: the caller's thread; None: one per core.
        cache_bytes: Size of the cache [byte]; a single larger chunk is kept as well.
        most_bytes: Upper limit for the cache [byte], also for :meth:`keep`.
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
        """Chunks that were read completely and have the right CRC."""
        self.threads = threads or cores()
        several = self.threads > 1
        self._pool = ThreadPoolExecutor(self.threads, "jaxdet-read") if several else None
        self._heads: OrderedDict[Place, ChunkHead] = OrderedDict()
        self._chunks: OrderedDict[Place, bytes | memoryview] = OrderedDict()
        self._ahead: set[Place] = set()
        self._bytes = 0
        self._lock = Lock()

    def __reduce__(self) -> tuple:
        """Pickle for another process, with a single thread, since processes share the cores."""
        return ChunkStore, (self.files, 1, self.cache_bytes, self._most_bytes)

    def keep(self, nbytes: int) -> None:
        """Enlarge the cache to at least ``nbytes``, up to its limit."""
        self.cache_bytes = min(max(self.cache_bytes, nbytes), self._most_bytes)

    def stop(self) -> None:
        """Stop the threads."""
        if self._pool:
            self._pool.shutdown(cancel_futures=True)

    def close(self) -> None:
        """Stop the threads and close the files."""
        self.stop()
        for file in self.files:
            file.close()

    def check_unchanged(self) -> None:
        """Check that the files have not changed since they were opened.

        Raises:
            InputError: A file has changed.
        """
        for file in self.files:
            file.check_unchanged()

    def map(self, function: Callable[[T], R], items: Sequence[T]) -> Iterable[R]:
        """Apply ``function`` to all items in threads; return the results in order."""
        return (
            self._pool.map(function, items)
            if self._pool and len(items) > 1
            else map(function, items)
        )

    def groups_that_fit(self, places: Iterable[Place]) -> Iterator[list[Place]]:
        """Yield consecutive chunks in groups that fit into the cache."""
        group: list[Place] = []
        total = 0
        for place in places:
            size = self._size(place)
            if group and total + size > self.cache_bytes:
                yield group
                group, total = [], 0
            group.append(place)
            total += size
        if group:
            yield group

    def head(self, place: Place) -> ChunkHead:
        """Return the header of a chunk.

        Raises:
            DamageError: There is no chunk.
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
        """Return the decompressed records of a chunk, checked against its CRC.

        Args:
            place: Chunk.
            ahead: Whether the chunk is only prefetched; it is then kept until it is used.

        Raises:
            DamageError: The chunk can't be read.
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
        """Yield the chunks in order, after decompressing groups of them in threads.

        An unreadable chunk raises a DamageError only when its bytes are used.
        """
        for group in self.groups_that_fit(places):
            for _ in self.map(self._load, [place for place in group if self._is_packed(place)]):
                pass
            yield from group

    def _is_packed(self, place: Place) -> bool:
        try:
            return not self.head(place).is_plain
        except DamageError:
            return False

    def _load(self, place: Place) -> None:
        """Decompress a compressed chunk, which is kept until it is used."""
        with suppress(DamageError):
            self.data(place, ahead=True)

    def _drop_one(self) -> None:
        """Drop the least recently used chunk; chunks prefetched but not yet used come last."""
        used = (place for place in self._chunks if place not in self._ahead)
        place = next(used, next(iter(self._chunks)))
        self._ahead.discard(place)
        self._bytes -= len(self._chunks.pop(place))

    def check(self, place: Place) -> None:
        """Check a chunk against its CRC, if it has one.

        Raises:
            DamageError: The CRC is wrong.
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
        """Return up to ``size`` bytes of a chunk's records, unchecked if the chunk is uncompressed.

        Args:
            place: Chunk.
            offset: Offset in the chunk's records [byte].
            size: Maximum number of bytes.
            whole: Whether a compressed chunk is decompressed completely. Otherwise bytes near its
                start are decompressed separately, without CRC, if the chunk is not in the cache.

        Raises:
            DamageError: The chunk can't be read.
        """
        head = self.head(place)
        if not head.is_plain:
            if not whole and offset + size <= BEGIN_BYTES and place not in self._chunks:
                known = self.files[place.file].chunk_begin(place.position, offset + size)
                if len(known) == offset + size:
                    return memoryview(known)[offset:]
            return memoryview(self.data(place, ahead=True))[offset : offset + size]
        size = min(size, head.uncompressed_size - offset)
        self.files[place.file].check_memory(size, "message")
        start = place.position + head.data_offset
        return memoryview(self.files[place.file].read(start + offset, max(size, 0)))

    def _size(self, place: Place) -> int:
        """Return the size of a chunk, compressed or not, whichever is larger [byte]."""
        try:
            head = self.head(place)
            size = max(head.uncompressed_size, head.data_size)
            return min(size, self.files[place.file].max_bytes)
        except DamageError:
            return 0
