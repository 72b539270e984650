"""MCAP files as log files."""

from threading import local

from mcap.opcode import Opcode

from jaxdet.io.chunks import (
    HEAD_BYTES,
    MAGIC,
    RECORD_HEAD,
    ChunkHead,
    DamageError,
    decompress,
    decompress_begin,
    read_chunk_head,
)
from jaxdet.io.container import LogFile
from jaxdet.io.file_index import FileIndex
from jaxdet.io.mcap_index import read_mcap_index
from jaxdet.io.mcap_scan import rebuild_mcap_index

_BEGIN_BYTES = 192 << 10
"""Number of bytes of a compressed chunk that contain its first zstd block."""
_LARGE_BYTES = 1 << 18
"""Size of a chunk from which on it saves time to decompress only its start [byte]."""
_PACKED_BYTES = 16 << 20
"""Maximum size of a compressed chunk that is read into its thread's buffer."""
_of_thread = local()


class McapFile(LogFile):
    """An MCAP file; chunks are identified by the position of their record's content.

    A message record outside of chunks is treated as an uncompressed chunk with a single record.
    """

    magic = MAGIC

    def read_index(self) -> FileIndex:
        """Read the file's own index, see :meth:`LogFile.read_index`."""
        return read_mcap_index(self)

    def rebuild_index(self) -> FileIndex:
        """Rebuild the index by a scan, see :meth:`LogFile.rebuild_index`."""
        return rebuild_mcap_index(self)

    def chunk_head(self, position: int) -> ChunkHead:
        """Return the header of the chunk or message record whose content starts at ``position``.

        Raises:
            DamageError: There is no such record.
        """
        start = position - RECORD_HEAD.size
        known = self.read(start, min(RECORD_HEAD.size + HEAD_BYTES, self.size - start))
        opcode, length = RECORD_HEAD.unpack_from(known)
        if opcode == Opcode.MESSAGE and length <= self.size - position:
            size = RECORD_HEAD.size + length
            return ChunkHead(0, 0, size, 0, "", -RECORD_HEAD.size, size)
        if opcode != Opcode.CHUNK:
            raise DamageError("no chunk at the expected position")
        return read_chunk_head(known[RECORD_HEAD.size :][:length], length)

    def chunk_begin(self, position: int, size: int) -> bytes:
        """Return the first records of a chunk, see :meth:`LogFile.chunk_begin`."""
        head = self.chunk_head(position)
        if head.uncompressed_size < _LARGE_BYTES:
            return b""
        data = self.read(position + head.data_offset, min(head.data_size, _BEGIN_BYTES))
        return decompress_begin(head, data, size)

    def chunk(self, position: int) -> bytes | memoryview:
        """Return the decompressed chunk whose record's content starts at ``position``.

        Raises:
            DamageError: The chunk is no longer readable.
        """
        head = self.chunk_head(position)
        self.check_memory(max(head.uncompressed_size, head.data_size))
        start = position + head.data_offset
        if head.is_plain:
            return decompress(head, self.read(start, head.data_size))
        data = _packed_memory(head.data_size)
        self.read_into(start, data)
        return decompress(head, data)


def _packed_memory(size: int) -> memoryview:
    """Return a buffer for a compressed chunk, valid until the thread's next call.

    The buffer is reused because it stays in a core's cache.
    """
    memory: bytearray = getattr(_of_thread, "memory", bytearray())
    if len(memory) < size:
        memory = bytearray(size)
        if size <= _PACKED_BYTES:
            _of_thread.memory = memory
    return memoryview(memory)[:size]
