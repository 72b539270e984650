"""Chunks of an MCAP file: decompression within bounds, and the records inside.

``mcap``'s own chunk reader trusts declared sizes and returns short data for a message that
overruns its chunk; here every length is checked before it is used.
"""

import struct
from collections.abc import Iterator
from threading import local
from typing import NamedTuple

import deflate
import lz4.frame
import numpy as np
import zstandard
from mcap.opcode import Opcode

from jaxdet.io.limits import MAX_ODD_RECORDS

RECORD_HEAD = struct.Struct("<BQ")
"""Opcode and length, before every record."""
MESSAGE_HEAD = struct.Struct("<HIQQ")
"""Channel, sequence, log time [ns], publish time [ns]; the payload follows."""
_CHUNK_HEAD = struct.Struct("<QQQII")

PIECE_BYTES = 1 << 18
"""Of a chunk, worked on at a time: they stay in a core's cache."""

_of_thread = local()


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
    """The head of a chunk record whose content is ``length`` bytes long and begins so.

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


def decompress(head: ChunkHead, data: bytes, max_bytes: int) -> bytes | memoryview:
    """The records of a chunk, at most ``max_bytes``, checked against its CRC where it has one.

    Raises:
        DamageError: Unknown compression, a size other than declared, or a wrong CRC.
    """
    if max(head.uncompressed_size, head.data_size) > max_bytes:
        raise DamageError("chunk is larger than --log.max-chunk-mib")
    size, crc = head.uncompressed_size, None
    try:
        if head.compression == "zstd":
            records = _zstd(data, size)
        elif head.compression == "lz4":
            records, crc = _lz4(data, size)
        elif head.is_plain:
            records = data
        else:
            raise DamageError(f"chunk compression {head.compression!a} is unknown")
    except (zstandard.ZstdError, RuntimeError, EOFError, ValueError) as error:
        raise DamageError("chunk can't be decompressed") from error
    if len(records) != size:
        raise DamageError("chunk has another size than declared")
    if head.crc and (crc32(records) if crc is None else crc) != head.crc:
        raise DamageError("chunk has a wrong CRC")
    return records


def crc32(data: bytes | memoryview, start: int = 0) -> int:
    """CRC-32 of bytes, or of those before (their CRC is ``start``) and these."""
    return deflate.crc32(data, start)


def _zstd(data: bytes, size: int) -> bytes:
    """At most ``size + 1`` bytes of all frames; at once where the one frame says its size."""
    try:
        decompressor = _of_thread.zstd
    except AttributeError:
        decompressor = _of_thread.zstd = zstandard.ZstdDecompressor()
    if size and zstandard.frame_content_size(data) == size:
        return decompressor.decompress(data, allow_extra_data=False)
    return decompressor.stream_reader(data, read_across_frames=True).read(size + 1)


def _lz4(data: bytes, size: int) -> tuple[memoryview, int]:
    """At most ``size + 1`` bytes of the first frame, and their CRC.

    In pieces that stay in a core's cache until they are copied and their CRC is known: ``lz4``
    copies all that it returns, and many processes at once wait for memory.
    """
    records = np.empty(size + 1, np.uint8).data
    context, left = lz4.frame.create_decompression_context(), memoryview(data)
    place, crc, end = 0, 0, False
    while not end and place <= size:
        piece, count, end = lz4.frame.decompress_chunk(
            context, left, max_length=min(PIECE_BYTES, size + 1 - place)
        )
        if not count and not piece:
            break  # the frame goes on, but not the data
        records[place : place + len(piece)] = piece
        crc, place, left = crc32(piece, crc), place + len(piece), left[count:]
    return records[:place], crc


def chunk_records(records: bytes | memoryview) -> Iterator[Record]:
    """The records of a decompressed chunk in order.

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
