"""RVL, the lossless depth code of ROS's ``compressedDepth``.

Source: A. Wilson, *Fast Lossless Depth Image Compression*, ISS 2017.

The stream is little-endian 32-bit words of eight nibbles, the most significant first. Numbers
are variable-length: three bits a nibble, lowest first, the nibble's top bit says that more
follow. They are, over and over: a count of zero pixels, a count of non-zero pixels, and for
each of these the difference to the non-zero pixel before it, with the sign in the lowest bit.
"""

import numpy as np

_MAX_NIBBLES = 11
"""Nibbles in the longest number, 32 bits."""


def decode_rvl(data: bytes | memoryview, height: int, width: int) -> np.ndarray:
    """The image ``(height, width)`` uint16 in an RVL stream.

    Args:
        data: The stream, without any header.
        height: Rows [pixel].
        width: Columns [pixel]; the caller has checked that the size is plausible.

    Raises:
        ValueError: The stream is short, its counts overrun the image, or a value leaves uint16.
    """
    numbers = _numbers(np.frombuffer(data, np.uint8))
    pixels = np.zeros(height * width, np.int64)
    counts, starts, at, position = [], [], 0, 0
    size, available = height * width, len(numbers)
    while position < size:
        if at + 2 > available:
            raise ValueError("RVL stream ends early")
        zeros, filled = int(numbers[at]), int(numbers[at + 1])
        position += zeros
        if position + filled > size or zeros + filled == 0:
            raise ValueError("RVL run leaves the image")
        counts.append(filled)
        starts.append((position, at + 2))
        position += filled
        at += 2 + filled
    if at > available:
        raise ValueError("RVL stream ends early")
    count = np.array(counts, np.int64)
    start = np.array(starts, np.int64).reshape(-1, 2)
    within = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    code = numbers[np.repeat(start[:, 1], count) + within]
    pixels[np.repeat(start[:, 0], count) + within] = np.cumsum((code >> 1) ^ -(code & 1))
    if pixels.size and (pixels.min() < 0 or pixels.max() > 0xFFFF):
        raise ValueError("RVL value is not 16 bits")
    return pixels.astype(np.uint16).reshape(height, width)


def _numbers(data: np.ndarray) -> np.ndarray:
    """All numbers of a stream ``(N,)`` int64; the zero padding at its end gives extra ones."""
    words = data[: len(data) // 4 * 4].reshape(-1, 4)[:, ::-1].reshape(-1)
    nibbles = np.stack([words >> 4, words & 15], axis=1).reshape(-1)
    last = np.flatnonzero(nibbles < 8)
    first = np.concatenate([[0], last[:-1] + 1]) if len(last) else last
    length = last - first + 1
    if len(last) and length.max() > _MAX_NIBBLES:
        raise ValueError("RVL number is longer than 32 bits")
    numbers = (nibbles[first] & 7).astype(np.int64) if len(last) else np.zeros(0, np.int64)
    for place in range(1, int(length.max(initial=0))):
        long = np.flatnonzero(length > place)
        part = (nibbles[first[long] + place] & 7).astype(np.int64)
        numbers[long] |= part << (3 * place)
    return numbers
