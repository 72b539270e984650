"""Mutations of logs: changes to bytes, records, lengths, rows, texts and files."""

import bz2
import re
import sqlite3
import struct
import zlib
from collections.abc import Callable
from contextlib import closing, suppress
from random import Random
from typing import NamedTuple

import lz4.frame
import zstandard

from jaxdet.io import bag
from tests.mcap_bytes import MAGIC, record

Files = dict[str, bytes]
"""Contents of the files of a log, by their paths in its folder."""


class Record(NamedTuple):
    """A record of an MCAP file or of a bag."""

    opcode: int
    start: int
    head: int
    """Number of bytes before the content."""
    size: int
    """Number of bytes of the content."""

    @property
    def end(self) -> int:
        """Position after the content."""
        return self.start + self.head + self.size


def _is_bag(data: bytes) -> bool:
    return data.startswith(bag.MAGIC)


def records(data: bytes) -> list[Record]:
    """Return the records of an intact file."""
    if _is_bag(data):
        size = len(bag.MAGIC)
        each = bag.records(data[size:])
        return [Record(r.op, r.start + size, r.data - r.start, r.size) for r in each]
    found, place = [], len(MAGIC)
    while place + 9 <= len(data) - len(MAGIC):
        opcode, size = struct.unpack_from("<BQ", data, place)
        found.append(Record(opcode, place, 9, size))
        place += 9 + size
    return found


def chunks(data: bytes) -> list[Record]:
    """Return the chunks of an intact file."""
    kind = bag.CHUNK if _is_bag(data) else 6
    return [item for item in records(data) if item.opcode == kind]


def _flip(data: bytearray, random: Random, places: range) -> None:
    for _ in range(random.choice((1, 1, 1, 2, 5))):
        data[random.choice(places)] ^= 1 << random.randrange(8)


def flip_bits(data: bytes, random: Random) -> bytes:
    """Flip bits anywhere."""
    changed = bytearray(data)
    _flip(changed, random, range(len(data)))
    return bytes(changed)


def flip_summary(data: bytes, random: Random) -> bytes:
    """Flip bits after the data section."""
    ends = [item.start for item in records(data) if item.opcode == 15]
    if _is_bag(data):
        ends = [item.end for item in records(data) if item.opcode in (bag.CHUNK, bag.INDEX)][-1:]
    changed = bytearray(data)
    _flip(changed, random, range(ends[0], len(data)))
    return bytes(changed)


def flip_heads(data: bytes, random: Random) -> bytes:
    """Flip bits in the first 60 bytes of a record, its head included."""
    item, changed = random.choice(records(data)), bytearray(data)
    _flip(changed, random, range(item.start, min(item.start + 60, item.end)))
    return bytes(changed)


def cut(data: bytes, random: Random) -> bytes:
    """Truncate the file."""
    return data[: random.randrange(len(data))]


def cut_out(data: bytes, random: Random) -> bytes:
    """Remove some bytes."""
    start = random.randrange(len(data))
    return data[:start] + data[start + random.choice((1, 4, 100, 5000)) :]


def zeros(data: bytes, random: Random) -> bytes:
    """Replace a part by zeros, as if it was never written."""
    start, size = random.randrange(len(data)), random.choice((8, 512, 4096))
    size = min(size, len(data) - start)
    return data[:start] + bytes(size) + data[start + size :]


def drop_record(data: bytes, random: Random) -> bytes:
    """Remove a record."""
    item = random.choice(records(data))
    return data[: item.start] + data[item.end :]


def drop_chunk(data: bytes, random: Random) -> bytes:
    """Remove a chunk, and in half of the cases its message indexes."""
    all_records, index = records(data), bag.INDEX if _is_bag(data) else 7
    known = chunks(data)
    if not known:
        return drop_record(data, random)
    first = last = all_records.index(random.choice(known))
    if random.random() < 0.5:
        while all_records[last + 1].opcode == index:
            last += 1
    return data[: all_records[first].start] + data[all_records[last].end :]


def double_record(data: bytes, random: Random) -> bytes:
    """Duplicate a chunk, or a record if there are no chunks."""
    item = random.choice(chunks(data) or records(data))
    return data[: item.end] + data[item.start : item.end] + data[item.end :]


def swap_records(data: bytes, random: Random) -> bytes:
    """Swap two records."""
    pool = chunks(data) if random.random() < 0.7 and len(chunks(data)) > 1 else records(data)
    one, two = sorted(random.sample(pool, 2), key=lambda item: item.start)
    parts = data[two.start : two.end], data[one.end : two.start], data[one.start : one.end]
    return data[: one.start] + b"".join(parts) + data[two.end :]


def lie_length(data: bytes, random: Random) -> bytes:
    """Change the declared length of a record."""
    item = random.choice(records(data))
    size = max(0, random.choice((0, 1, item.size + 1, item.size - 1, 2**31, 2**63, 2**64 - 1)))
    form, place = struct.Struct("<Q"), item.start + 1
    if _is_bag(data):
        form, place = struct.Struct("<I"), random.choice((item.start, item.start + item.head - 4))
        size = min(size, 2**32 - 1)
    return data[:place] + form.pack(size) + data[place + form.size :]


def lie_numbers(data: bytes, random: Random) -> bytes:
    """Overwrite four or eight bytes anywhere by an extreme number."""
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
    """Change the content of a chunk and update its CRC, as a faulty writer would."""
    found = chunks(data)
    if not found:
        return lie_numbers(data, random)
    item = random.choice(found)
    changer = random.choice((lie_numbers, flip_bits, cut, zeros))
    make = _rewritten_of_bag if _is_bag(data) else _rewritten
    return data[: item.start] + make(data, item, lambda p: changer(p, random)) + data[item.end :]


def _rewritten(data: bytes, item: Record, change: Callable[[bytes], bytes]) -> bytes:
    content = data[item.start + 9 : item.end]
    first, last, _, crc, size = struct.unpack_from("<QQQII", content)
    name = content[32 : 32 + size].decode()
    changed = change(_unpacked(name, content[40 + size :]))
    packed = _packed(name, changed)
    head = struct.pack("<QQQII", first, last, len(changed), zlib.crc32(changed) * bool(crc), size)
    return record(6, head + name.encode() + struct.pack("<Q", len(packed)) + packed)


def _rewritten_of_bag(data: bytes, item: Record, change: Callable[[bytes], bytes]) -> bytes:
    fields = bag.read_record(data, item.start).fields
    name = fields[b"compression"].decode()
    changed = change(_unpacked(name, data[item.start + item.head : item.end]))
    fields[b"size"], packed = struct.pack("<I", len(changed)), _packed(name, changed)
    parts = [key + b"=" + value for key, value in fields.items()]
    head = b"".join(struct.pack("<I", len(part)) + part for part in parts)
    return struct.pack("<I", len(head)) + head + struct.pack("<I", len(packed)) + packed


def _unpacked(name: str, data: bytes) -> bytes:
    if name == "zstd":
        return zstandard.ZstdDecompressor().decompressobj().decompress(data)
    if name == "bz2":
        return bz2.decompress(data)
    return lz4.frame.decompress(data) if name == "lz4" else data


def _packed(name: str, data: bytes) -> bytes:
    if name == "zstd":
        return zstandard.compress(data, 1)
    if name == "bz2":
        return bz2.compress(data)
    return lz4.frame.compress(data) if name == "lz4" else data


_VALUES = (None, "text", b"", b"\0" * 9, -1, 0, 3, 99, 1 << 40, (1 << 63) - 1, 1.5, float("inf"))


def change_rows(data: bytes, random: Random) -> bytes:
    """Change rows, columns or tables of an SQLite file, as a faulty writer would."""
    with closing(sqlite3.connect(":memory:")) as file:
        file.deserialize(data)
        tables = ["messages", "messages", "messages", "topics", "message_definitions", "metadata"]
        table = random.choice(tables)
        columns = [row[1] for row in file.execute(f"PRAGMA table_info({table})")]
        ids = [row[0] for row in file.execute(f"SELECT rowid FROM {table}")]
        column, value, row = random.choice(columns), random.choice(_VALUES), random.choice(ids)
        one = f"UPDATE {table} SET {column} = ? WHERE rowid = ?"
        with suppress(sqlite3.Error):  # constraints of a column may reject the value
            how = random.randrange(10)
            if how == 0:
                file.execute(f"DROP TABLE {table}")
            elif how == 1:
                file.execute(f"DELETE FROM {table} WHERE rowid = ?", (row,))
            elif how == 2:
                file.execute(f"ALTER TABLE {table} RENAME COLUMN {column} TO other")
            elif how == 3:
                file.execute(f"UPDATE {table} SET {column} = ?", (value,))
            elif how == 4 and column == "data":
                more = random.randrange(10_000)
                change = f"UPDATE {table} SET data = substr(data, 1, {more}) || zeroblob({more})"
                file.execute(f"{change} WHERE rowid = ?", (row,))
            else:
                file.execute(one, (value, row))
        file.commit()
        return file.serialize()


def swap_pages(data: bytes, random: Random) -> bytes:
    """Swap two pages of an SQLite file, or overwrite one by another."""
    pages = [data[place : place + 4096] for place in range(0, len(data), 4096)]
    one, two = random.randrange(1, len(pages)), random.randrange(1, len(pages))
    pages[one], pages[two] = pages[two], random.choice((pages[one], pages[two]))
    return b"".join(pages)


_NUMBER = (b"nan", b"inf", b"-1", b"0", b"1e39", b"1e999999999", b"9" * 5000, b"x", b"null", b"[]")


def change_word(data: bytes, random: Random) -> bytes:
    """Replace a word of a text file; flip bits of an image."""
    words = re.findall(rb"[\w./+-]+|[^\w./+-]+", data)
    if data.startswith((b"\x89PNG", b"\xff\xd8")) or not words:
        return flip_bits(data, random)
    words[random.randrange(len(words))] = random.choice(_NUMBER)
    return b"".join(words)


def drop_file(files: Files, random: Random) -> Files:
    """Remove a file, or its content."""
    name = random.choice(sorted(files))
    if random.random() < 0.3:
        return {**files, name: b""}
    return {key: data for key, data in files.items() if key != name}


def rename_file(files: Files, random: Random) -> Files:
    """Give a file the name of another one, or an unexpected name."""
    name, other = random.choice(sorted(files)), random.choice(sorted(files))
    odd = ("x.png", "rgb/x.png", "depth/.png", "rgb/1e9.png", "rgb/9999999999999.5.png", "a.json")
    other = random.choice((other, *odd))
    kept = {key: data for key, data in files.items() if key != name}
    return {**kept, other: files[name]}


Mutation = Callable[[Files, Random], Files]


def _of_a_file(change: Callable[[bytes, Random], bytes]) -> Mutation:
    def changed(files: Files, random: Random) -> Files:
        name = random.choice(sorted(files))
        return {**files, name: change(files[name], random) if files[name] else b"x"}

    return changed


def _named(*makers: Callable[[bytes, Random], bytes]) -> dict[str, Mutation]:
    return {make.__name__: _of_a_file(make) for make in makers}


_BYTES = _named(flip_bits, cut, cut_out, zeros, lie_numbers)
_RECORDS = _named(
    flip_summary,
    flip_heads,
    drop_record,
    drop_chunk,
    double_record,
    swap_records,
    lie_length,
    rewrite,
)
_WHOLE: dict[str, Mutation] = {make.__name__: make for make in (drop_file, rename_file)}
MUTATIONS: dict[str, dict[str, Mutation]] = {
    ".mcap": _BYTES | _RECORDS,
    ".bag": _BYTES | _RECORDS,
    ".db3": _BYTES | _named(change_rows, swap_pages),
    "": _BYTES | _named(change_word) | _WHOLE,
}
"""Mutations by name, for each suffix of logs; image folders have no suffix."""
WRITER_IS_WRONG = {"rewrite", "change_rows"}
"""Mutations after which CRCs and counts still agree with the content of the file."""
