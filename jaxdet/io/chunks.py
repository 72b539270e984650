"""Chunks of an MCAP file: decompression within bounds, and the records inside.

``mcap``'s own chunk reader trusts declared sizes and returns short data for a message that
overruns its chunk; here every length is checked before it is used.
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
"""How an MCAP file begins and ends."""
RECORD_HEAD = struct.Struct("<BQ")
"""Opcode and length, before every record."""
MESSAGE_HEAD = struct.Struct("<HIQQ")
"""Channel, sequence, log time [ns], publish time [ns]; the payload follows."""
PAYLOAD_OFFSET = RECORD_HEAD.size + MESSAGE_HEAD.size
"""From where a message's record begins to its payload."""
_CHUNK_HEAD = struct.Struct("<QQQII")
MAX_TIME_NS = (1 << 63) - 1
"""Log times beyond this count as this [ns]."""

PIECE_BYTES = 1 << 18
"""Of a chunk, worked on at a time: they stay in a core's cache."""


class DamageError(Exception):
    """A part of a file can't be used; the text says why."""


class ChunkHead(NamedTuple):
    """What a chunk record says of itself; none of it is checked yet."""

    start_ns: int
    """Log time of its first message."""
    end_ns: int
    uncompressed_size: int
    crc: int
    """0 = none."""
    compression: str
    data_offset: int
    """Where its data begin, from the start of the record's content."""
    data_size: int
    length: int = 0
    """Of the record's content, by its own word."""

    @property
    def is_plain(self) -> bool:
        """Whether its data are the records themselves."""
        return self.compression in ("", "none")


class Record(NamedTuple):
    """A record inside a chunk."""

    opcode: int
    offset: int
    """Where its content begins in the decompressed chunk."""
    size: int


def read_chunk_head(content: bytes, length: int) -> ChunkHead:
    """Return the head of a chunk record with ``length`` bytes of content, which begins so.

    Raises:
        DamageError: It doesn't fit.
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
    return ChunkHead(start, end, size, crc, name, offset, data_size, length)


def decompress(head: ChunkHead, data: bytes | memoryview) -> bytes | memoryview:
    """Return the records of a chunk, checked against its CRC if it has one.

    Those of a packed chunk are in memory of their own, others are ``data``.

    Raises:
        DamageError: Unknown compression, a size other than declared, or a wrong CRC.
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
    """Return up to ``size`` bytes of a packed chunk's records, unchecked; data may be cut off."""
    with suppress(zstandard.ZstdError, RuntimeError, EOFError):
        if head.compression == "zstd":
            return zstandard.ZstdDecompressor().stream_reader(data).read(size)
        if head.compression == "lz4":
            return lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size)
    return b""


def _unpacked(compression: str, data: bytes | memoryview, size: int) -> memoryview:
    """``size`` bytes that are decompressed to where they stay."""
    import pyarrow as pa

    if not len(data) and not size:
        return memoryview(b"")
    return memoryview(pa.Codec(compression).decompress(data, size)).cast("B")


def _fills(compression: str, data: bytes | memoryview, size: int) -> bool:
    """Return whether packed data are ``size`` bytes; for lz4, pyarrow does not report that."""
    if compression != "lz4" or not len(data):
        return True
    context, left = lz4.frame.create_decompression_context(), memoryview(data)
    found, end = 0, False
    while not end and found <= size:
        piece, count, end = lz4.frame.decompress_chunk(context, left, max_length=PIECE_BYTES)
        found, left = found + len(piece), left[count:]
    return found == size


def chunk_records(records: bytes | memoryview) -> Iterator[Record]:
    """Return the records of a decompressed chunk in order.

    Raises:
        DamageError: A record overruns the chunk or can't be one; those before it are good.
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
            raise DamageError("chunk holds what is no record")
        if useful:
            yield Record(opcode, position, size)
        position += size
