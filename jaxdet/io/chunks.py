"""Chunks of an MCAP file: decompression with a size limit, and the records inside.

The chunk reader of the package ``mcap`` trusts declared sizes, and returns incomplete data for a
message that exceeds its chunk. Here every length is checked before use.
"""

import struct
from collections.abc import Iterator
from contextlib import suppress
from typing import NamedTuple

import deflate
import lz4.frame
import zstandard
from mcap.opcode import Opcode

from jaxdet.io.limits import MAX_ODD_RECORDS

MAGIC = b"\x89MCAP0\r\n"
"""First and last bytes of an MCAP file."""
RECORD_HEAD = struct.Struct("<BQ")
"""Opcode and length, at the start of every record."""
MESSAGE_HEAD = struct.Struct("<HIQQ")
"""Channel, sequence number, log time [ns] and publish time [ns], followed by the payload."""
PAYLOAD_OFFSET = RECORD_HEAD.size + MESSAGE_HEAD.size
"""Offset of a message's payload from the start of its record [byte]."""
_CHUNK_HEAD = struct.Struct("<QQQII")
HEAD_BYTES = 128
"""Number of bytes at the start of a chunk record's content that contain its header."""
MAX_TIME_NS = (1 << 63) - 1
"""Maximum log time [ns]; later times are clipped to it."""

PIECE_BYTES = 1 << 18
"""Number of bytes of a chunk that are processed at a time, to stay in a core's cache."""


class DamageError(Exception):
    """A part of a file is unusable; the message is the reason."""


class ChunkHead(NamedTuple):
    """Header of a chunk record, not yet checked."""

    start_ns: int
    """Log time of the first message [ns]."""
    end_ns: int
    uncompressed_size: int
    crc: int
    """CRC-32 of the records; 0 = none."""
    compression: str
    data_offset: int
    """Offset of the data from the start of the record's content [byte]."""
    data_size: int

    @property
    def is_plain(self) -> bool:
        """Whether the data are uncompressed records."""
        return self.compression in ("", "none")


class Record(NamedTuple):
    """A record inside a chunk."""

    opcode: int
    offset: int
    """Offset of the content in the decompressed chunk [byte]."""
    size: int


def read_chunk_head(content: bytes, length: int) -> ChunkHead:
    """Parse the start of a chunk record, whose content has ``length`` bytes.

    Raises:
        DamageError: The header is invalid.
    """
    try:
        start, end, size, crc, name_size = _CHUNK_HEAD.unpack_from(content)
        if name_size > 64:
            raise DamageError("chunk head is damaged")
        offset = _CHUNK_HEAD.size + name_size
        name = content[_CHUNK_HEAD.size : offset].decode("utf-8", "replace")
        (data_size,) = struct.unpack_from("<Q", content, offset)
    except struct.error as error:
        raise DamageError("chunk head is damaged") from error
    offset += 8
    if offset + data_size > length:
        raise DamageError("chunk data overrun the chunk")
    return ChunkHead(start, end, size, crc, name, offset, data_size)


def decompress(head: ChunkHead, data: bytes | memoryview) -> bytes | memoryview:
    """Decompress the records of a chunk, and check their CRC if there is one.

    Uncompressed records are returned without a copy.

    Raises:
        DamageError: The compression is unknown, the size differs from the declared one, or the CRC
            is wrong.
    """
    size, records = head.uncompressed_size, data
    if not head.is_plain:
        if head.compression not in ("lz4", "zstd"):
            raise DamageError(f"chunk compression {head.compression!a} is unknown")
        try:
            records = _unpacked(head.compression, data, size)
        except (RuntimeError, EOFError, OSError) as error:
            problem = (
                "chunk can't be decompressed, or has a size that differs from the declared one"
            )
            raise DamageError(problem) from error
    if len(records) != size or (not head.crc and not _fills(head.compression, data, size)):
        raise DamageError("chunk has a size that differs from the declared one")
    if head.crc and deflate.crc32(records) != head.crc:
        raise DamageError("chunk has a wrong CRC")
    return records


def decompress_begin(head: ChunkHead, data: bytes, size: int) -> bytes:
    """Decompress at most the first ``size`` bytes of a chunk, unchecked; data may be truncated."""
    with suppress(zstandard.ZstdError, RuntimeError, EOFError):
        if head.compression == "zstd":
            return zstandard.ZstdDecompressor().stream_reader(data).read(size)
        if head.compression == "lz4":
            return lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size)
    return b""


def _unpacked(compression: str, data: bytes | memoryview, size: int) -> memoryview:
    """Decompress ``size`` bytes into a new buffer."""
    import pyarrow as pa

    if not len(data) and not size:
        return memoryview(b"")
    return memoryview(pa.Codec(compression).decompress(data, size)).cast("B")


def _fills(compression: str, data: bytes | memoryview, size: int) -> bool:
    """Return whether data decompress to ``size`` bytes, which pyarrow does not check for lz4."""
    if compression != "lz4" or not len(data):
        return True
    context, left = lz4.frame.create_decompression_context(), memoryview(data)
    found, end = 0, False
    while not end and found <= size:
        piece, count, end = lz4.frame.decompress_chunk(context, left, max_length=PIECE_BYTES)
        found, left = found + len(piece), left[count:]
    return found == size


def chunk_records(records: bytes | memoryview) -> Iterator[Record]:
    """Yield the records of a decompressed chunk in order.

    Raises:
        DamageError: A record exceeds the chunk or is invalid; the records before it are valid.
    """
    position, odd = 0, 0
    while position < len(records):
        if position + RECORD_HEAD.size > len(records):
            raise DamageError("chunk ends inside a record")
        opcode, size = RECORD_HEAD.unpack_from(records, position)
        position += RECORD_HEAD.size
        if position + size > len(records):
            raise DamageError("message is longer than its chunk")
        useful = opcode in (Opcode.MESSAGE, Opcode.CHANNEL, Opcode.SCHEMA)
        odd += not useful or size == 0
        if opcode == 0 or odd > MAX_ODD_RECORDS:
            raise DamageError("chunk has invalid records")
        if useful:
            yield Record(opcode, position, size)
        position += size
