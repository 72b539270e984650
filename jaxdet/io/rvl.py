"""RVL, the lossless depth code of ROS's ``compressedDepth``.

Source: A. Wilson, *Fast Lossless Depth Image Compression*, ISS 2017.

The stream is little-endian 32-bit words of eight nibbles, the most significant first. Numbers
are variable-length: three bits a nibble, lowest first, the nibble's top bit says that more
follow. They are, over and over: a count of zero pixels, a count of non-zero pixels, and for
each of these the difference to the non-zero pixel before it, with the sign in the lowest bit.

A number has at most 11 nibbles and two counts fill at least one pixel, so no stream takes more than
33 nibbles a pixel, whatever follows.
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
"""By the kernel's status."""


def decode_rvl(data: bytes | memoryview, row: np.ndarray) -> None:
    """Decode an RVL stream.

    Args:
        data: The stream, without any header; what follows the last pixel is not read.
        row: ``(H, W)`` uint16, contiguous, written to.

    Raises:
        ValueError: The stream is short, its counts overrun the image, or a value leaves uint16.
    """
    status = np.zeros(1, np.int32)
    launch("rvl", np.frombuffer(data, np.uint8), row, status)
    if status[0]:
        raise ValueError(_ERRORS[status[0]])
