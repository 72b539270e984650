"""Parts of MCAP files that no writer would write, made byte by byte."""

import struct
import zlib
from pathlib import Path

import zstandard

MAGIC = b"\x89MCAP0\r\n"


def text(value: str | bytes) -> bytes:
    data = value.encode() if isinstance(value, str) else value
    return struct.pack("<I", len(data)) + data


def record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def header() -> bytes:
    return record(1, text("ros2") + text("tests"))


def schema(number: int, name: str, data: bytes, encoding: str = "ros2msg") -> bytes:
    return record(3, struct.pack("<H", number) + text(name) + text(encoding) + text(data))


def channel(number: int, topic: str, schema_id: int, encoding: str = "cdr") -> bytes:
    ids = struct.pack("<HH", number, schema_id)
    return record(4, ids + text(topic) + text(encoding) + struct.pack("<I", 0))


def message(channel_id: int, log_ns: int, payload: bytes) -> bytes:
    return record(5, struct.pack("<HIQQ", channel_id, 0, log_ns, log_ns) + payload)


def chunk(records: bytes, first_ns: int = 0, last_ns: int = 0, crc: bool = True) -> bytes:
    """Return a chunk compressed by zstd."""
    packed = zstandard.compress(records, 3)
    head = struct.pack("<QQQI", first_ns, last_ns, len(records), zlib.crc32(records) if crc else 0)
    return record(6, head + text("zstd") + struct.pack("<Q", len(packed)) + packed)


def end() -> bytes:
    return record(15, bytes(4)) + record(2, struct.pack("<QQI", 0, 0, 0)) + MAGIC


def without_end(path: Path) -> bytes:
    """Return the magic and the records of an MCAP file before the end of its data section."""
    data = path.read_bytes()
    start = struct.unpack_from("<Q", data, len(data) - 8 - 20)[0]
    return data[: start - 13]
