"""Decoding of JPEG to RGB, with a limit on the work per image.

Source: ITU-T T.81. A file may have any number of scans of a few bytes, each of which covers the
whole image, so a file of a megabyte could keep a decoder busy for hours.
"""

import numpy as np
import simplejpeg

MAGIC = b"\xff\xd8"
MOST_SCANS = 64
"""Maximum number of scans. Encoders write up to 12, or one per component without interleaving."""
_SAMPLE_BYTES, _FREE_BYTES = 4, 1 << 20
"""Maximum file size: bytes per sample (the longest codes need less), plus a constant for text and
previews."""
_START_OF_SCAN = 0xDA
_FRAMES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}
"""Markers of frame headers."""
_SEQUENTIAL = {0xC0, 0xC1, 0xC9}


def jpeg_size(data: bytes | memoryview) -> tuple[int, int]:
    """Return width and height [pixel] from the file header.

    Raises:
        ValueError: The file is damaged.
    """
    height, width = simplejpeg.decode_jpeg_header(data)[:2]
    return int(width), int(height)


def decode_jpeg(data: memoryview, row: np.ndarray) -> None:
    """Decode a JPEG to RGB; grey is repeated in the three channels.

    Args:
        data: Contents of the file.
        row: Output ``(H, W, 3)`` uint8, contiguous, with the size in the file header.

    Raises:
        ValueError: The file is damaged, or would need excessive work for an image of this size.
    """
    if len(data) > _SAMPLE_BYTES * row.size + _FREE_BYTES:
        raise ValueError(f"{len(data)} bytes are too many for its size")
    if not _has_one_scan(data):
        scans = bytes(data).count(bytes((0xFF, _START_OF_SCAN)))
        if scans > MOST_SCANS:
            raise ValueError(f"it has {scans} scans, but at most {MOST_SCANS} are decoded")
    simplejpeg.decode_jpeg(data, colorspace="RGB", buffer=row)


def _has_one_scan(data: memoryview) -> bool:
    """Return whether the first scan has all components; the decoder then stops after it."""
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
