"""What can happen to a file: its bytes, its records, its lengths and what its messages say."""

import struct
import zlib
from collections.abc import Callable
from random import Random
from typing import NamedTuple

import lz4.frame
import zstandard

from tests.mcap_bytes import MAGIC, record


class Record(NamedTuple):
    """A record of a file."""

    opcode: int
    start: int
    size: int
    """Of its content."""

    @property
    def end(self) -> int:
        """After its content."""
        return self.start + 9 + self.size


def records(data: bytes) -> list[Record]:
    """The records of an unbroken file."""
    found, place = [], len(MAGIC)
    while place + 9 <= len(data) - len(MAGIC):
        opcode, size = struct.unpack_from("<BQ", data, place)
        found.append(Record(opcode, place, size))
        place += 9 + size
    return found


def chunks(data: bytes) -> list[Record]:
    """Its chunks."""
    return [item for item in records(data) if item.opcode == 6]


def _flip(data: bytearray, random: Random, places: range) -> None:
    for _ in range(random.choice((1, 1, 1, 2, 5))):
        data[random.choice(places)] ^= 1 << random.randrange(8)


def flip_bits(data: bytes, random: Random) -> bytes:
    """Bits anywhere."""
    changed = bytearray(data)
    _flip(changed, random, range(len(data)))
    return bytes(changed)


def flip_summary(data: bytes, random: Random) -> bytes:
    """Bits behind the data."""
    ends = [item.start for item in records(data) if item.opcode == 15]
    changed = bytearray(data)
    _flip(changed, random, range(ends[0], len(data)))
    return bytes(changed)


def flip_heads(data: bytes, random: Random) -> bytes:
    """Bits of a record's head and the first bytes of what it holds."""
    item, changed = random.choice(records(data)), bytearray(data)
    _flip(changed, random, range(item.start, min(item.start + 60, item.end)))
    return bytes(changed)


def cut(data: bytes, random: Random) -> bytes:
    """The file ends early."""
    return data[: random.randrange(len(data))]


def cut_out(data: bytes, random: Random) -> bytes:
    """Some bytes are missing."""
    start = random.randrange(len(data))
    return data[:start] + data[start + random.choice((1, 4, 100, 5000)) :]


def zeros(data: bytes, random: Random) -> bytes:
    """A part was never written."""
    start, size = random.randrange(len(data)), random.choice((8, 512, 4096))
    size = min(size, len(data) - start)
    return data[:start] + bytes(size) + data[start + size :]


def drop_record(data: bytes, random: Random) -> bytes:
    """A record is missing."""
    item = random.choice(records(data))
    return data[: item.start] + data[item.end :]


def drop_chunk(data: bytes, random: Random) -> bytes:
    """A chunk is missing, perhaps with its message indexes."""
    all_records = records(data)
    which = [i for i, item in enumerate(all_records) if item.opcode == 6]
    if not which:
        return drop_record(data, random)
    first = last = random.choice(which)
    if random.random() < 0.5:
        while all_records[last + 1].opcode == 7:
            last += 1
    return data[: all_records[first].start] + data[all_records[last].end :]


def double_record(data: bytes, random: Random) -> bytes:
    """A record is there twice."""
    item = random.choice(chunks(data) or records(data))
    return data[: item.end] + data[item.start : item.end] + data[item.end :]


def swap_records(data: bytes, random: Random) -> bytes:
    """Two records change places."""
    pool = chunks(data) if random.random() < 0.7 and len(chunks(data)) > 1 else records(data)
    one, two = sorted(random.sample(pool, 2), key=lambda item: item.start)
    parts = data[two.start : two.end], data[one.end : two.start], data[one.start : one.end]
    return data[: one.start] + b"".join(parts) + data[two.end :]


def lie_length(data: bytes, random: Random) -> bytes:
    """A record's length is another one."""
    item = random.choice(records(data))
    size = random.choice((0, 1, item.size + 1, item.size - 1, 2**31, 2**63, 2**64 - 1))
    return data[: item.start + 1] + struct.pack("<Q", max(size, 0)) + data[item.start + 9 :]


def lie_numbers(data: bytes, random: Random) -> bytes:
    """Four or eight bytes anywhere become a number that is dangerous."""
    form = random.choice(("<I", "<Q", "<d"))
    odd: dict[str, tuple[int | float, ...]] = {
        "<I": (0, 1, 0x7FFFFFFF, 0xFFFFFFFF, 0x10000),
        "<Q": (0, 1 << 32, 1 << 63, (1 << 64) - 1),
        "<d": (float("nan"), float("inf"), 1e39, -1e14, 1e-45),
    }
    value = struct.pack(form, random.choice(odd[form]))
    start = random.randrange(len(data) - 8)
    return data[:start] + value + data[start + len(value) :]


def rewrite(data: bytes, random: Random) -> bytes:
    """What is in a chunk changes and the chunk's CRC with it: the writer itself is wrong."""
    found = chunks(data)
    if not found:
        return lie_numbers(data, random)
    item = random.choice(found)
    content = data[item.start + 9 : item.end]
    first, last, _, crc, size = struct.unpack_from("<QQQII", content)
    name = content[32 : 32 + size].decode()
    packed = content[40 + size :]
    plain = _unpacked(name, packed)
    changer = random.choice((lie_numbers, flip_bits, cut, zeros))
    changed = changer(plain, random)
    packed = _packed(name, changed)
    head = struct.pack("<QQQII", first, last, len(changed), zlib.crc32(changed) * bool(crc), size)
    new = head + name.encode() + struct.pack("<Q", len(packed)) + packed
    return data[: item.start] + record(6, new) + data[item.end :]


def _unpacked(name: str, data: bytes) -> bytes:
    if name == "zstd":
        return zstandard.ZstdDecompressor().decompressobj().decompress(data)
    return lz4.frame.decompress(data) if name == "lz4" else data


def _packed(name: str, data: bytes) -> bytes:
    if name == "zstd":
        return zstandard.compress(data, 1)
    return lz4.frame.compress(data) if name == "lz4" else data


MUTATIONS: dict[str, Callable[[bytes, Random], bytes]] = {
    make.__name__: make
    for make in (
        flip_bits,
        flip_summary,
        flip_heads,
        cut,
        cut_out,
        zeros,
        drop_record,
        drop_chunk,
        double_record,
        swap_records,
        lie_length,
        lie_numbers,
        rewrite,
    )
}
WRITER_IS_WRONG = {"rewrite"}
"""Mutations after which the file is as its CRCs say."""
