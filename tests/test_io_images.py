"""Decoding of images: encodings, padding, byte orders, JPEG, PNG, compressedDepth, RVL."""

import struct
import tracemalloc

import cv2
import numpy as np
import pytest
import simplejpeg
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from jaxdet.errors import FrameError
from jaxdet.io.compressed import (
    compressed_size,
    decode_compressed_color,
    decode_compressed_depth,
    decode_rvl,
    is_compressed_depth,
)
from jaxdet.io.declarations import ChannelInfo
from jaxdet.io.decode_messages import MessageDecoder
from jaxdet.io.images import decode_color, decode_depth, metres_to_units
from jaxdet.io.messages import CompressedImageMessage, ImageMessage
from tests.io_helpers import STORE, encode_rvl, ros_image

LIMIT = 1 << 20
RANDOM = np.random.default_rng(3)
RGB = RANDOM.integers(0, 256, (6, 8, 3)).astype(np.uint8)
DEPTH = RANDOM.integers(0, 65536, (6, 8)).astype(np.uint16)


def image(pixels: np.ndarray, encoding: str, padding: int = 0, big: bool = False) -> ImageMessage:
    height, width = pixels.shape[:2]
    swapped = pixels.astype(pixels.dtype.newbyteorder(">" if big else "<"))
    rows = np.ascontiguousarray(swapped.reshape(height, -1)).view(np.uint8).reshape(height, -1)
    rows = np.pad(rows, ((0, 0), (0, padding)), constant_values=77)
    return ImageMessage(1, "f", width, height, encoding, rows.shape[1], big, rows.tobytes())


def compressed(data: bytes, form: str) -> CompressedImageMessage:
    return CompressedImageMessage(1, "f", form, data)


def png(pixels: np.ndarray) -> bytes:
    return cv2.imencode(".png", pixels)[1].tobytes()


def color(message: ImageMessage | CompressedImageMessage, limit: int = LIMIT) -> np.ndarray:
    """Return the decoded colour image."""
    row = np.full((*size(message), 3), 99, np.uint8)
    decode = decode_color if isinstance(message, ImageMessage) else decode_compressed_color
    decode(message, row, limit)
    return row


def depth(message: ImageMessage | CompressedImageMessage, limit: int = LIMIT) -> np.ndarray:
    row = np.full(size(message), 99, np.uint16)
    decode = decode_depth if isinstance(message, ImageMessage) else decode_compressed_depth
    decode(message, row, 0.001, limit)
    return row


def size(message: ImageMessage | CompressedImageMessage) -> tuple[int, int]:
    """Return rows and columns; for damaged and huge images those of DEPTH."""
    if isinstance(message, ImageMessage):
        found = message.width, message.height
    else:
        try:
            found = compressed_size(message)
        except FrameError:
            return 6, 8
    width, height = found
    return (height, width) if 0 < width * height <= LIMIT else (6, 8)


def rvl(stream: bytes, height: int, width: int) -> np.ndarray:
    row = np.full((height, width), 99, np.uint16)
    decode_rvl(stream, row)
    return row


@pytest.mark.parametrize("padding", [0, 5])
@pytest.mark.parametrize(
    ("encoding", "pixels", "expected"),
    [
        ("rgb8", RGB, RGB),
        ("bgr8", RGB[..., ::-1], RGB),
        ("8UC3", RGB[..., ::-1], RGB),
        ("rgba8", np.concatenate([RGB, RGB[..., :1]], axis=2), RGB),
        ("bgra8", np.concatenate([RGB[..., ::-1], RGB[..., :1]], axis=2), RGB),
        ("mono8", RGB[..., 0], np.repeat(RGB[..., :1], 3, axis=2)),
        ("8UC1", RGB[..., 0], np.repeat(RGB[..., :1], 3, axis=2)),
    ],
)
def test_colour_of_each_encoding_is_decoded(encoding, pixels, expected, padding):
    np.testing.assert_array_equal(color(image(pixels, encoding, padding)), expected)


@pytest.mark.parametrize("encoding", ["yuyv", "yuv422_yuy2", "uyvy", "yuv422"])
def test_yuv_is_decoded(encoding):
    flat = np.full((4, 6, 3), (200, 60, 90), np.uint8)
    y, cr, cb = cv2.cvtColor(flat[:1, :1], cv2.COLOR_RGB2YCrCb)[0, 0].astype(float)
    y, u, v = y * 219 / 255 + 16, (cb - 128) * 224 / 255 + 128, (cr - 128) * 224 / 255 + 128
    pair = (y, u, y, v) if encoding.startswith(("yuyv", "yuv422_")) else (u, y, v, y)
    pixels = np.tile(np.rint(pair).astype(np.uint8).reshape(1, 1, 4), (4, 3, 1)).reshape(4, 6, 2)
    decoded = color(image(pixels, encoding, padding=3))
    np.testing.assert_allclose(decoded.astype(int), flat, atol=3)


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("padding", [0, 3])
@pytest.mark.parametrize("encoding", ["16UC1", "mono16", "32FC1"])
def test_depth_of_each_encoding_is_decoded(encoding, padding, big):
    pixels = (DEPTH * 0.001).astype(np.float32) if encoding == "32FC1" else DEPTH
    message = image(pixels, encoding, padding, big)
    np.testing.assert_array_equal(depth(message), DEPTH)


def test_metres_are_rounded_and_invalid_depth_is_zero():
    metres = np.array([[np.nan, np.inf, -np.inf, 0, -1, 0.0004, 0.0006, 1.2344, 65.535, 65.536]])
    expected = [[0, 0, 0, 0, 0, 0, 1, 1234, 65535, 0]]
    units = np.full((1, 10), 99, np.uint16)
    metres_to_units(metres.astype(np.float32), 0.001, units)
    np.testing.assert_array_equal(units, expected)


@pytest.mark.parametrize(
    "message",
    [
        image(RGB, "of_mars"),
        image(RGB[:5, :, 0], "bayer_rggb8"),
        image(RGB[..., 0], "nv12"),
        image(RGB, "rgb8")._replace(width=9),
        image(RGB, "rgb8")._replace(height=7),
        image(RGB, "rgb8")._replace(width=0),
        image(RGB, "rgb8")._replace(width=1 << 20, height=1 << 20),
        image(RGB[:, :7], "yuyv"),
    ],
)
def test_colour_whose_data_contradicts_its_header_is_an_error(message):
    with pytest.raises(FrameError):
        color(message)


def test_padding_of_the_last_row_is_optional():
    message = image(DEPTH, "16UC1", padding=4)
    cut = message._replace(data=message.data[:-4])
    np.testing.assert_array_equal(depth(cut), DEPTH)


def test_jpeg_and_png_colour_are_decoded():
    smooth = cv2.resize(RGB, (64, 48), interpolation=cv2.INTER_CUBIC)
    jpeg = simplejpeg.encode_jpeg(smooth, quality=100, colorsubsampling="444")
    decoded = color(compressed(jpeg, "rgb8; jpeg compressed bgr8"))
    np.testing.assert_allclose(decoded.astype(int), smooth, atol=4)
    file = png(np.ascontiguousarray(smooth[..., ::-1]))
    np.testing.assert_array_equal(color(compressed(file, "png")), smooth)
    grey = cv2.imencode(".jpg", smooth[..., 0])[1].tobytes()
    assert color(compressed(grey, "jpeg")).shape == (48, 64, 3)


@pytest.mark.parametrize("form", ["16UC1; compressedDepth png", "16UC1; compressedDepth", "16UC1"])
def test_compressed_depth_in_png_is_decoded(form):
    message = compressed(struct.pack("<iff", 0, 0, 0) + png(DEPTH), form)
    assert is_compressed_depth(form, "/d/compressedDepth") and compressed_size(message) == (8, 6)
    np.testing.assert_array_equal(depth(message), DEPTH)


def test_depth_in_plain_16_bit_png_is_decoded():
    message = compressed(png(DEPTH), "png")
    np.testing.assert_array_equal(depth(message), DEPTH)


@pytest.mark.parametrize("codec", ["png", "rvl"])
def test_compressed_depth_of_metres_is_decoded(codec):
    """The encoder stores q = A / z + B, with depths up to 10 m and steps of 1 cm at 1 m."""
    metres = RANDOM.uniform(0.3, 9.0, (6, 8)).astype(np.float32)
    metres[0, :3] = 0
    a = 100.0 * (100.0 + 1)
    b = 1 - a / 10.0
    with np.errstate(divide="ignore"):
        codes = np.where(metres > 0, np.rint(a / metres + b), 0).astype(np.uint16)
    body = png(codes) if codec == "png" else struct.pack("<II", 8, 6) + encode_rvl(codes)
    head = struct.pack("<iff", 0, a, b)
    message = compressed(head + body, f"32FC1; compressedDepth {codec}")
    decoded = depth(message)
    assert not decoded[0, :3].any()
    np.testing.assert_allclose(decoded * 0.001, metres, atol=0.0101)


@given(
    hnp.arrays(
        np.uint16,
        hnp.array_shapes(min_dims=2, max_dims=2, max_side=12),
        elements=st.integers(0, 65535) | st.just(0),
    )
)
def test_rvl_images_survive_a_round_trip(pixels):
    np.testing.assert_array_equal(rvl(encode_rvl(pixels), *pixels.shape), pixels)


def test_an_rvl_stream_written_by_hand_is_decoded():
    """Two zeros, 5 and 3 are coded as counts 2 and 2, differences +5 (10) and -2 (3)."""
    nibbles = [2, 2, 0b1010, 1, 3, 0, 0, 0]
    word = sum(nibble << (28 - 4 * place) for place, nibble in enumerate(nibbles))
    stream = struct.pack("<I", word)
    np.testing.assert_array_equal(rvl(stream, 2, 2), [[0, 0], [5, 3]])


def slow_rvl(stream: bytes, size: int) -> list[int] | None:
    """Decode nibble by nibble; return None if the stream is not an image of this size."""
    words = struct.unpack(f"<{len(stream) // 4}I", stream[: len(stream) // 4 * 4])
    nibbles = [word >> shift & 15 for word in words for shift in range(28, -1, -4)]
    numbers, value, place = [], 0, 0
    for nibble in nibbles:
        value |= (nibble & 7) << place
        place += 3
        if nibble < 8 or place > 33:
            numbers.append(value if nibble < 8 and place <= 33 else None)
            value = place = 0
    source, pixels, pixel = iter(numbers), [], 0
    try:
        while len(pixels) < size:
            zeros, filled = next(source), next(source)
            if not zeros + filled or len(pixels) + zeros + filled > size:
                return None
            pixels += [0] * zeros
            for _ in range(filled):
                code = next(source)
                pixel += code >> 1 ^ -(code & 1)
                if not 0 <= pixel <= 65535:
                    return None
                pixels.append(pixel)
    except (StopIteration, TypeError):
        return None
    return pixels


def assert_rvl(stream: bytes, height: int, width: int) -> None:
    """Assert that RVL is decoded or refused as by :func:`slow_rvl`, and writes only its image."""
    expected = slow_rvl(stream, height * width)
    batch = np.full((3, height, width), 99, np.uint16)
    if expected is None:
        with pytest.raises(ValueError, match="RVL"):
            decode_rvl(stream, batch[1])
    else:
        decode_rvl(stream, batch[1])
        np.testing.assert_array_equal(batch[1].reshape(-1), expected)
    assert (batch[::2] == 99).all()


@given(st.binary(max_size=64), st.integers(1, 20), st.integers(1, 20))
def test_rvl_of_any_bytes_is_an_image_or_an_error(data, height, width):
    assert_rvl(data, height, width)


@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([0, 255, 256, 257, 3000, 65535 - 257, 65535 - 255, 65535]),
    st.sampled_from([2, 5, 40, 300, 5000]),
    st.lists(st.integers(0, 1 << 16), max_size=3),
)
def test_rvl_of_images_with_changed_bits_is_an_image_or_an_error(seed, start, step, places):
    random = np.random.default_rng(seed)
    steps = random.integers(-step, step + 1, 240)
    pixels = np.clip(start + np.cumsum(steps), 0, 65535) * (random.random(240) > 0.1)
    stream = bytearray(encode_rvl(pixels.astype(np.uint16).reshape(12, 20)))
    assert_rvl(bytes(stream), 12, 20)
    for place in places:
        stream[place // 8 % len(stream)] ^= 1 << place % 8
    assert_rvl(bytes(stream), 12, 20)
    assert_rvl(bytes(stream), 11, 20)
    assert_rvl(bytes(stream), 13, 20)


def test_bytes_after_an_rvl_image_are_ignored_quickly():
    encoded = encode_rvl(np.full((120, 160), 700, np.uint16))
    rvl(encoded, 120, 160)  # loads the decoder
    stream = encoded + bytes(64 << 20)
    tracemalloc.start()
    try:
        assert (rvl(stream, 120, 160) == 700).all()
        assert tracemalloc.get_traced_memory()[1] < 200_000
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("encoding", ["rgb8", "bgr8", "rgba8", "bgra8", "mono8", "yuyv", "uyvy"])
def test_colour_is_written_only_to_its_row_of_the_batch(encoding):
    channels = {"rgb8": 3, "bgr8": 3, "rgba8": 4, "bgra8": 4, "mono8": 1}.get(encoding, 2)
    pixels = RANDOM.integers(0, 256, (6, 8, channels)).astype(np.uint8)
    batch = np.full((3, 6, 8, 3), 99, np.uint8)
    decode_color(image(pixels, encoding, padding=3), batch[1], LIMIT)
    np.testing.assert_array_equal(batch[1], color(image(pixels, encoding)))
    assert (batch[::2] == 99).all()


def test_images_of_another_size_than_the_calibration_are_refused():
    jpeg = compressed(simplejpeg.encode_jpeg(RGB), "jpeg")
    for message in (image(RGB, "rgb8"), jpeg, compressed(png(RGB), "png")):
        decode = decode_color if isinstance(message, ImageMessage) else decode_compressed_color
        with pytest.raises(FrameError, match="colour image is 8x6, but the calibration is for 8x5"):
            decode(message, np.zeros((5, 8, 3), np.uint8), LIMIT)
    huge = struct.pack("<iffII", 0, 0, 0, 5700, 5700) + bytes(99)
    rvl = compressed(huge, "16UC1; compressedDepth rvl")
    for message, size in ((rvl, "5700x5700"), (compressed(png(DEPTH), "png"), "8x6")):
        error = f"depth image is {size}, but the calibration is for 160x120"
        with pytest.raises(FrameError, match=error):
            decode_compressed_depth(message, np.zeros((120, 160), np.uint16), 0.001, 1 << 26)


@pytest.mark.parametrize("little", [False, True])
def test_pixels_of_cdr_messages_are_not_copied(little):
    """Fields are read by the schema, with texts of any length; pixels are a view."""
    name = "sensor_msgs/msg/Image"
    text = STORE.generate_msgdef(name, ros_version=2)[0]
    decoder = MessageDecoder(ChannelInfo("/c", "cdr", name, "ros2msg", text.encode()))
    for frame in ("", "f", "ü" * 5000):
        message = ros_image(RGB, "rgb8", 5_000_000_007, frame)
        payload = bytes(STORE.serialize_cdr(message, name, little_endian=little))
        found = decoder.decode(memoryview(payload))
        assert isinstance(found, ImageMessage)
        assert found[:7] == (5_000_000_007, frame, 8, 6, "rgb8", 24, False)
        assert isinstance(found.data, memoryview) and bytes(found.data) == RGB.tobytes()
        assert np.shares_memory(np.asarray(found.data), np.frombuffer(payload, np.uint8))
        np.testing.assert_array_equal(color(found), RGB)


def test_compressed_images_with_wrong_or_truncated_data_are_refused():
    big = struct.pack("<iff", 0, 0, 0) + struct.pack("<II", 1 << 31, 1 << 31) + b"\0" * 8
    with pytest.raises(FrameError, match="max-pixels"):
        depth(compressed(big, "16UC1; compressedDepth rvl"))
    for data, form in (
        (png(DEPTH)[:-30], "png"),
        (b"", "png"),
        (struct.pack("<iff", 0, 0, 0), "16UC1; compressedDepth rvl"),
        (struct.pack("<iffII", 0, 0, 0, 8, 6), "16UC1; compressedDepth rvl"),
        (png(RGB), "png"),
    ):
        with pytest.raises(FrameError):
            depth(compressed(data, form))
    jpeg = simplejpeg.encode_jpeg(np.ascontiguousarray(np.tile(RGB, (8, 8, 1))))
    for data in (jpeg[: len(jpeg) // 2], jpeg[:10], b"RIFFxxxxWEBP", png(DEPTH)[:20]):
        with pytest.raises(FrameError):
            color(compressed(data, "jpeg"))
    with pytest.raises(FrameError, match="max-pixels"):
        color(compressed(jpeg, "jpeg"), 10)
