"""JPEG files to RGB, with no more work than the image is worth.

Source: ITU-T T.81. A file may have any number of scans, of a few bytes each, and each goes over the
whole image: a megabyte could keep a decoder busy for hours.
"""

import numpy as np
import simplejpeg

MAGIC = b"\xff\xd8"
MOST_SCANS = 64
"""Of an image; encoders write up to 12, and one for each component where they don't interleave."""
_SAMPLE_BYTES, _FREE_BYTES = 4, 1 << 20
"""Most of a file: so much for each sample, which no code exceeds, and for text and previews."""
_START_OF_SCAN = 0xDA
_FRAMES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}
"""Markers that say what the image is."""
_SEQUENTIAL = {0xC0, 0xC1, 0xC9}


def jpeg_size(data: bytes | memoryview) -> tuple[int, int]:
    """Return width and height [pixel] by the head.

    Raises:
        ValueError: It is damaged.
    """
    height, width = simplejpeg.decode_jpeg_header(data)[:2]
    return int(width), int(height)


def decode_jpeg(data: memoryview, row: np.ndarray) -> None:
    """Decode to RGB; grey is repeated.

    Args:
        data: The file.
        row: ``(H, W, 3)`` uint8, contiguous, written to; of the size that the head says.

    Raises:
        ValueError: It is damaged, or asks for more work than an image of this size is worth.
    """
    if len(data) > _SAMPLE_BYTES * row.size + _FREE_BYTES:
        raise ValueError(f"{len(data)} bytes are too many for its size")
    if not _has_one_scan(data):
        scans = bytes(data).count(bytes((0xFF, _START_OF_SCAN)))
        if scans > MOST_SCANS:
            raise ValueError(f"it has {scans} scans, but at most {MOST_SCANS} are decoded")
    simplejpeg.decode_jpeg(data, colorspace="RGB", buffer=row)


def _has_one_scan(data: memoryview) -> bool:
    """Return whether the first scan is all of the image, after which a decoder stops."""
    place, components = len(MAGIC), 0
    while place + 10 <= len(data) and data[place] == 0xFF:
        marker = data[place + 1]
        if marker == 0xFF:  # fill
            place += 1
            continue
        if marker == _START_OF_SCAN:
            return components == data[place + 4]
        if marker in _FRAMES:
            if marker not in _SEQUENTIAL:
                return False
            components = data[place + 9]
        place += 2 + int.from_bytes(data[place + 2 : place + 4])
    return False
