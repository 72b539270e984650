"""PNG decoder: equal to OpenCV, errors for damaged and unsupported images."""

import contextlib
import struct
import tracemalloc
import zlib
from itertools import pairwise

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxdet.io.png import MAGIC, decode_png_color, decode_png_depth, read_png_head

RANDOM = np.random.default_rng(5)
KINDS = {"grey": (0, 1), "rgb": (2, 3), "grey alpha": (4, 2), "rgb alpha": (6, 4)}
"""Colour type of PNG and number of samples per pixel, by kind of image."""
NO_DATA = [(b"IEND", b"")]


def predicted(left: int, above: int, corner: int, kind: int) -> int:
    """Return the prediction of a filter, by the specification."""
    if kind < 3:
        return (0, left, above)[kind]
    if kind == 3:
        return (left + above) // 2
    p = left + above - corner
    return min((left, above, corner), key=lambda value: abs(p - value))


def filtered(samples: bytes, height: int, step: int, filters: list[int]) -> bytes:
    """Return the filtered lines of a PNG, using the filters in turns."""
    width = len(samples) // height
    lines = bytearray()
    for v in range(height):
        kind = filters[v % len(filters)]
        lines.append(kind)
        line = samples[v * width : (v + 1) * width]
        above = samples[(v - 1) * width : v * width] if v else bytes(width)
        for i, value in enumerate(line):
            left, corner = (line[i - step], above[i - step]) if i >= step else (0, 0)
            lines.append((value - predicted(left, above[i], corner, kind)) % 256)
    return bytes(lines)


def chunks(items: list[tuple[bytes, bytes]]) -> bytes:
    """Return a PNG file with these chunks."""
    parts = (struct.pack(">I", len(data)) + name + data for name, data in items)
    checks = (struct.pack(">I", zlib.crc32(name + data)) for name, data in items)
    return MAGIC + b"".join(a + b for a, b in zip(parts, checks, strict=True))


def head(width: int, height: int, bits: int, kind: int, *rest: int) -> tuple[bytes, bytes]:
    return b"IHDR", struct.pack(">IIBBBBB", width, height, bits, kind, *(rest or (0, 0, 0)))


def encode(pixels: np.ndarray, filters: list[int], kind: str, pieces: int = 1) -> bytes:
    """Return a PNG of ``(H, W, C)`` uint8 or uint16, with its data in several chunks."""
    height, width = pixels.shape[:2]
    samples = pixels.astype(pixels.dtype.newbyteorder(">")).tobytes()
    lines = filtered(samples, height, pixels.itemsize * pixels.shape[2], filters)
    data = zlib.compress(lines)
    at = [len(data) * i // pieces for i in range(pieces + 1)]
    parts = [(b"IDAT", data[a:b]) for a, b in pairwise(at)]
    first = head(width, height, 8 * pixels.itemsize, KINDS[kind][0])
    return chunks([first, (b"tEXt", b"a\0b"), *parts, *NO_DATA])


def random_pixels(shape: tuple[int, int], kind: str, dtype: type) -> np.ndarray:
    """Return half noise and half smooth pixels, which take all branches of the filters."""
    limit = np.iinfo(dtype).max
    noise = RANDOM.integers(0, limit, (*shape, KINDS[kind][1]), endpoint=True)
    smooth = np.cumsum(RANDOM.integers(0, 3, noise.shape), axis=1)
    return np.where(RANDOM.random(noise.shape) < 0.5, noise, smooth).astype(dtype)


def color(data: bytes) -> np.ndarray:
    """Decode RGB; assert that adjacent memory is unchanged."""
    width, height = read_png_head(data)[:2]
    batch = np.full((3, height, width, 3), 99, np.uint8)
    decode_png_color(data, batch[1])
    assert (batch[::2] == 99).all()
    return batch[1]


def depth(data: bytes) -> np.ndarray:
    width, height = read_png_head(data)[:2]
    batch = np.full((3, height, width), 99, np.uint16)
    decode_png_depth(memoryview(data), batch[1])
    assert (batch[::2] == 99).all()
    return batch[1]


def opencv(data: bytes, mode: int = cv2.IMREAD_COLOR_RGB) -> np.ndarray:
    pixels = cv2.imdecode(np.frombuffer(data, np.uint8), mode)
    assert pixels is not None
    return pixels


@pytest.mark.parametrize("filters", [[0], [1], [2], [3], [4], [4, 3, 2, 1, 0, 3, 1, 4, 2]])
@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (7, 1), (23, 17)])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_and_filter_equals_opencv(kind, dtype, shape, filters):
    pixels = random_pixels(shape, kind, dtype)
    data = encode(pixels, filters, kind, pieces=3)
    np.testing.assert_array_equal(color(data), opencv(data))
    high = (pixels >> 8 * (pixels.itemsize - 1)).astype(np.uint8)
    rgb = high[..., :3] if high.shape[2] > 2 else np.repeat(high[..., :1], 3, axis=2)
    np.testing.assert_array_equal(color(data), rgb)
    if kind == "grey" and dtype is np.uint16:
        np.testing.assert_array_equal(depth(data), pixels[..., 0])
        np.testing.assert_array_equal(depth(data), opencv(data, cv2.IMREAD_UNCHANGED))


@pytest.mark.parametrize("shape", [(1, 40), (16, 16), (15, 33), (17, 31), (33, 15), (50, 70)])
def test_depth_of_any_size_and_filters_equals_opencv(shape):
    """The decoder processes sixteen lines together, each delayed by a pixel."""
    for _ in range(20):
        pixels = random_pixels(shape, "grey", np.uint16)
        data = encode(pixels, RANDOM.integers(0, 5, shape[0]).tolist(), "grey")
        np.testing.assert_array_equal(depth(data), pixels[..., 0])


@pytest.mark.parametrize("level", [0, 1, 9])
def test_images_written_by_opencv_are_decoded(level):
    rows = np.linspace(400, 9000, 480)[:, None] + RANDOM.normal(0, 8, (480, 640))
    pixels = np.where(RANDOM.random(rows.shape) < 0.1, 0, rows).astype(np.uint16)
    data = cv2.imencode(".png", pixels, [cv2.IMWRITE_PNG_COMPRESSION, level])[1].tobytes()
    np.testing.assert_array_equal(depth(data), pixels)


def test_ancillary_chunks_are_ignored():
    pixels = random_pixels((5, 6), "rgb", np.uint8)
    first, text, *rest = split(encode(pixels, [4], "rgb"))
    extra = [(b"gAMA", struct.pack(">I", 45455)), (b"tRNS", bytes(6)), (b"PLTE", bytes(9))]
    data = chunks([first, text, *extra, *rest]) + b"and more"
    np.testing.assert_array_equal(color(data), pixels)


def split(data: bytes) -> list[tuple[bytes, bytes]]:
    """Return the chunks of a file."""
    found, at = [], len(MAGIC)
    while at < len(data):
        size = int.from_bytes(data[at : at + 4])
        found.append((data[at + 4 : at + 8], data[at + 8 : at + 8 + size]))
        at += size + 12
    return found


LINES = bytes(6 * (1 + 2 * 8))
"""Lines of a 16-bit grey image of 8x6 zeros, each with its filter."""
GREY16 = head(8, 6, 16, 0)
"""Header of a grey image of 8x6 pixels with 16 bits."""


def damaged() -> dict[str, tuple[list[tuple[bytes, bytes]], str]]:
    """Return damaged chunks and the expected error, by name."""
    data = (b"IDAT", zlib.compress(LINES))
    bomb = (b"IDAT", zlib.compress(bytes(64 << 20), 9))
    wrong = (b"IDAT", zlib.compress(b"\5" + LINES[1:]))
    sum_wrong = (b"IDAT", data[1][:-1] + bytes([data[1][-1] ^ 1]))
    return {
        "bomb": ([GREY16, bomb, *NO_DATA], "too many"),
        "one byte more": ([GREY16, (b"IDAT", zlib.compress(LINES + b"\0")), *NO_DATA], "too many"),
        "short": ([GREY16, (b"IDAT", zlib.compress(LINES[:-1])), *NO_DATA], "fewer pixels"),
        "no data": ([GREY16, *NO_DATA], "inflated"),
        "noise": ([GREY16, (b"IDAT", RANDOM.bytes(90)), *NO_DATA], "inflated"),
        "sum": ([GREY16, sum_wrong, *NO_DATA], "inflated"),
        "filter": ([GREY16, wrong, *NO_DATA], "filter"),
        "no end": ([GREY16, data], "ends early"),
        "second head": ([GREY16, head(8, 5, 16, 0), data, *NO_DATA], "IHDR"),
        "critical": ([GREY16, (b"XXXX", b""), data, *NO_DATA], "XXXX"),
        "interlaced": ([head(8, 6, 16, 0, 0, 0, 1), data, *NO_DATA], "interlaced"),
        "palette": ([head(8, 6, 8, 3), (b"PLTE", bytes(9)), data, *NO_DATA], "palettes|grey"),
        "four bits": ([head(8, 6, 4, 0), data, *NO_DATA], "8 bits|grey"),
        "other size": ([head(8, 7, 16, 0), data, *NO_DATA], "8x7"),
        "huge": ([head(1 << 30, 1 << 30, 16, 0), data, *NO_DATA], "1073741824x"),
    }


@pytest.mark.parametrize("name", damaged())
def test_damaged_and_unsupported_images_are_refused_in_bounded_memory(name):
    items, problem = damaged()[name]
    data = chunks(items)
    for decode, row in (
        (decode_png_depth, np.zeros((6, 8), np.uint16)),
        (decode_png_color, np.zeros((6, 8, 3), np.uint8)),
    ):
        tracemalloc.start()
        try:
            with pytest.raises(ValueError, match=problem):
                decode(data, row)
            assert tracemalloc.get_traced_memory()[1] < len(data) + 100_000
        finally:
            tracemalloc.stop()


def test_depth_of_another_pixel_type_is_refused():
    for kind, dtype in (("grey", np.uint8), ("rgb", np.uint16), ("grey alpha", np.uint16)):
        data = encode(random_pixels((6, 8), kind, dtype), [0], kind)
        with pytest.raises(ValueError, match="16-bit grey"):
            depth(data)


def test_any_truncation_and_any_changed_bit_is_detected():
    pixels = random_pixels((6, 8), "grey", np.uint16)
    data = encode(pixels, [1, 4], "grey")
    row = np.zeros((6, 8), np.uint16)
    for size in range(len(data)):
        with pytest.raises(ValueError):
            decode_png_depth(data[:size], row)
    for bit in range(8 * len(data)):
        changed = bytearray(data)
        changed[bit // 8] ^= 1 << bit % 8
        with pytest.raises(ValueError):
            decode_png_depth(changed, row)


@given(
    st.sampled_from(list(KINDS)),
    st.sampled_from([1, 2]),
    st.integers(1, 12),
    st.integers(1, 12),
    st.randoms(use_true_random=False),
)
def test_random_lines_are_decoded_as_by_opencv(kind, size, height, width, random):
    """No encoder writes such lines; their checksum is right."""
    count = KINDS[kind][1] * size * width
    lines = b"".join(bytes([random.randrange(5)]) + random.randbytes(count) for _ in range(height))
    first = head(width, height, 8 * size, KINDS[kind][0])
    data = chunks([first, (b"IDAT", zlib.compress(lines)), *NO_DATA])
    np.testing.assert_array_equal(color(data), opencv(data))


@given(st.binary(max_size=80), st.lists(st.integers(0, 400), max_size=4))
def test_random_bytes_are_an_error_or_decoded_as_by_opencv(noise, places):
    row = np.zeros((6, 8), np.uint16)
    stream = bytearray(zlib.compress(LINES[:50] + noise + LINES[50 + len(noise) :]))
    for place in places:
        stream[place % len(stream)] ^= 1 << place % 8
    data = chunks([GREY16, (b"IDAT", bytes(stream)), *NO_DATA])
    with contextlib.suppress(ValueError):
        decode_png_depth(data, row)
        np.testing.assert_array_equal(row, opencv(data, cv2.IMREAD_UNCHANGED))
    for garbage in (noise, MAGIC + noise, data[:33] + noise):
        with contextlib.suppress(ValueError):
            decode_png_depth(garbage, row)
