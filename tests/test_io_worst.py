"""Images that take longest to decode: their time is bounded by their size."""

import struct
import time
import zlib
from collections.abc import Callable
from functools import cache

import cv2
import numpy as np
import pytest

from benchmarks.feed_logs import encode_rvl
from jaxdet.io.compressed import decode_rvl
from jaxdet.io.jpeg import MOST_SCANS, decode_jpeg
from jaxdet.io.png import MAGIC, decode_png_color

H, W = 240, 320
MOST_TIMES = 300
"""Maximum decoding time relative to a plain image, which takes 0.6 to 2.4 ms at 640x480."""
Decode = Callable[[memoryview, np.ndarray], None]


def color(height: int = H) -> np.ndarray:
    v, u = np.mgrid[:height, :W]
    return np.stack([u // 2, v // 2, (u + v) // 4], axis=2).astype(np.uint8)


def png(height: int, idat: list[bytes]) -> bytes:
    def chunk(name: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
        )

    head = struct.pack(">IIBBBBB", W, height, 8, 2, 0, 0, 0)
    parts = [chunk(b"IDAT", data) for data in idat]
    return MAGIC + chunk(b"IHDR", head) + b"".join(parts) + chunk(b"IEND", b"")


def bits(*fields: tuple[int, int]) -> list[int]:
    """Return the bits of numbers, lowest first, from pairs of number and bit count."""
    return [value >> i & 1 for value, count in fields for i in range(count)]


def empty_blocks(count: int) -> bytes:
    """Return empty deflate blocks of 90 bits, each with its own codes."""
    lengths = [int(symbol in (1, 18)) for symbol in (16, 17, 18, *[0] * 14, 1)]
    codes = (1, 1), (138 - 11, 7), (1, 1), (118 - 11, 7), (0, 1), (0, 1)
    kind = (0, 1), (2, 2), (0, 5), (0, 5), (14, 4)
    block = bits(*kind, *((length, 3) for length in lengths), *codes, (0, 1))
    return np.packbits(np.array(block * 8, np.uint8).reshape(-1, 8)[:, ::-1], axis=1).tobytes() * (
        count // 8
    )


def lines(height: int) -> bytes:
    filtered = np.concatenate([np.full((height, 1), 4), np.zeros((height, 3 * W))], axis=1)
    return zlib.compress(filtered.astype(np.uint8).tobytes(), 1)


def worst_png(height: int, share: float = 1.2) -> bytes:
    """Return a PNG with as many empty blocks as are accepted."""
    plain = lines(height)
    many = int(share * height * (1 + 3 * W)) * 8 // 90 // 8 * 8
    return png(height, [plain[:2] + empty_blocks(many) + plain[2:]])


def worst_rvl(height: int) -> bytes:
    """Return RVL with numbers of 11 nibbles, which code no zeros, one pixel, and no difference."""
    numbers = [[8] * 10 + [0], [9] + [8] * 9 + [0], [8] * 10 + [0]]
    nibbles = np.array([n for number in numbers for n in number] * (height * W), np.uint32)
    nibbles = np.pad(nibbles, (0, -len(nibbles) % 8)).reshape(-1, 8)
    return (nibbles << np.arange(28, -1, -4, dtype=np.uint32)).sum(1).astype("<u4").tobytes()


def worst_jpeg(height: int, scans: int = MOST_SCANS) -> bytes:
    """Return a progressive JPEG of noise that repeats the last scan."""
    noise = np.random.default_rng(0).integers(0, 256, (height, W, 3), np.uint8)
    how = [cv2.IMWRITE_JPEG_PROGRESSIVE, 1, cv2.IMWRITE_JPEG_QUALITY, 95]
    data = cv2.imencode(".jpg", noise, how)[1].tobytes()
    last = data.rindex(b"\xff\xda")
    return data[:last] + data[last:-2] * (scans - data.count(b"\xff\xda") + 1) + data[-2:]


@cache
def plain(height: int, kind: str) -> bytes:
    if kind == "rvl":
        return encode_rvl(np.full((height, W), 1500, np.uint16) + np.arange(W, dtype=np.uint16))
    return cv2.imencode(kind, color(height))[1].tobytes()


def seconds(decode: Decode, data: bytes, height: int) -> float:
    """Return the shortest CPU time of a few trials in this thread [s]."""
    shape = (height, W) if decode is decode_rvl else (height, W, 3)
    row, times = np.zeros(shape, np.uint16 if decode is decode_rvl else np.uint8), []
    for _ in range(4):
        start = time.thread_time()
        try:
            decode(memoryview(data), row)
        except ValueError as error:
            assert "progression" in str(error)  # raised after all scans
        times.append(time.thread_time() - start)
    return min(times)


@pytest.mark.parametrize(
    ("decode", "worst", "kind"),
    [
        (decode_rvl, worst_rvl, "rvl"),
        (decode_png_color, worst_png, ".png"),
        (decode_jpeg, worst_jpeg, ".jpg"),
    ],
)
def test_decoding_time_is_linear_in_the_size_of_the_worst_images(decode, worst, kind):
    seconds(decode, plain(H, kind), H)
    small, large = (seconds(decode, worst(height), height) for height in (H, 4 * H))
    assert small < MOST_TIMES * seconds(decode, plain(H, kind), H)
    assert large < 10 * small  # four times the pixels


@pytest.mark.parametrize(
    ("decode", "data", "text"),
    [
        (decode_png_color, worst_png(H, 2.0), "bytes are too many for its size"),
        (decode_png_color, png(H, [b""] * 10_000 + [lines(H)]), "too many chunks"),
        (decode_jpeg, worst_jpeg(H, 1000)[: 1 << 20], "scans, but at most 64"),
        (decode_jpeg, plain(H, ".jpg") + bytes(3 << 20), "bytes are too many for its size"),
    ],
)
def test_images_with_excessive_work_are_refused_at_once(decode, data, text):
    start = time.perf_counter()
    with pytest.raises(ValueError, match=text):
        decode(memoryview(data), np.zeros((H, W, 3), np.uint8))
    assert time.perf_counter() - start < 0.5


def test_jpegs_with_a_scan_per_component_are_decoded():
    """Some encoders do not interleave components."""
    plain = cv2.imencode(".jpg", color(), [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[1].tobytes()
    row = np.zeros((H, W, 3), np.uint8)
    decode_jpeg(memoryview(plain), row)
    assert np.abs(row.astype(int) - color()[..., ::-1]).mean() < 3


def test_jpeg_scans_after_one_with_all_components_do_not_count():
    """The decoder stops after a scan with all components; a preview may follow."""
    filled = plain(H, ".jpg").replace(b"\xff\xc0", b"\xff\xff\xc0", 1)  # fill before a marker
    row = np.zeros((H, W, 3), np.uint8)
    decode_jpeg(memoryview(filled + b"\xff\xda" * (MOST_SCANS + 1)), row)
    assert np.abs(row.astype(int) - color()[..., ::-1]).mean() < 3
