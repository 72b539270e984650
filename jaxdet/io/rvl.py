"""RVL, the lossless depth compression of ROS's ``compressedDepth``.

Source: A. Wilson, *Fast Lossless Depth Image Compression*, ISS 2017.

The stream consists of little-endian 32-bit words of eight nibbles, the most significant first.
Numbers have variable length: three bits per nibble, lowest first, and the top bit of the nibble is
set if more follow. They repeat: a count of zero pixels, a count of non-zero pixels, and for each of
the latter the difference from the previous non-zero pixel, with the sign in the lowest bit.

A number has at most 11 nibbles, and two counts fill at least one pixel, so a stream needs at most
33 nibbles per pixel.
"""

import numpy as np

from jaxdet.io.kernels import launch

_ERRORS = (
    "",
    "RVL stream ends early",
    "RVL run leaves the image",
    "RVL number is longer than 32 bits",
    "RVL value is not 16 bits",
)
"""Error messages by status of the kernel."""


def decode_rvl(data: bytes | memoryview, row: np.ndarray) -> None:
    """Decode an RVL stream.

    Args:
        data: Stream without header; bytes after the last pixel are ignored.
        row: Output ``(H, W)`` uint16, contiguous.

    Raises:
        ValueError: The stream is too short, its counts exceed the image, or a value exceeds uint16.
    """
    status = np.zeros(1, np.int32)
    launch("rvl", np.frombuffer(data, np.uint8), row, status)
    if status[0]:
        raise ValueError(_ERRORS[status[0]])
