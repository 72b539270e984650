"""The messages of one image topic: where they lie, and what the first of them look like."""

from array import array
from collections import Counter
from typing import NamedTuple

import numpy as np

from jaxdet.errors import FrameError
from jaxdet.io.compressed import compressed_size
from jaxdet.io.decode_messages import MessageDecoder
from jaxdet.io.messages import CompressedImageMessage, ImageMessage, Kind, RgbdMessage

COLUMNS = ("stamp", "depth_stamp", "log_time", "file", "decoder", "chunk", "offset", "size")
"""What is kept of an image message, all int64; stamps and log time in ns."""
NUM_PROBES = 8
"""How many of a stream's first messages are looked at."""
PROBE_BYTES = 1 << 16
"""How much of a compressed image is kept of these, for its head."""


class ImageSize(NamedTuple):
    """Width and height [pixel]."""

    width: int
    height: int


class ImageStream:
    """The messages of one image topic."""

    def __init__(self, topic: str, kind: Kind) -> None:
        self.topic, self.kind = topic, kind
        self.decoders: list[MessageDecoder] = []
        self.probes: list[ImageMessage | CompressedImageMessage | RgbdMessage] = []
        """The first few messages, without their pixels."""
        self._columns = {name: array("q") for name in COLUMNS}

    def __len__(self) -> int:
        return len(self._columns["stamp"])

    def add(self, values: tuple[int, ...]) -> None:
        """Adds a message, as ``COLUMNS``."""
        for column, value in zip(self._columns.values(), values, strict=True):
            column.append(value)

    def column(self, name: str) -> np.ndarray:
        """``(N,)`` int64, in the order of the files."""
        return np.array(self._columns[name], np.int64)


def image_sizes(stream: ImageStream, depth: bool) -> Counter[ImageSize]:
    """The sizes of a stream's first images, without decoding them."""
    sizes: Counter[ImageSize] = Counter()
    for probe in stream.probes:
        image = probe if not isinstance(probe, RgbdMessage) else None
        if isinstance(probe, RgbdMessage):
            image = probe.depth if depth else probe.color
        if isinstance(image, ImageMessage):
            sizes[ImageSize(image.width, image.height)] += 1
        elif image is not None:
            try:
                sizes[ImageSize(*compressed_size(image))] += 1
            except FrameError:
                continue
    return sizes


def first_image(stream: ImageStream, depth: bool) -> ImageMessage | CompressedImageMessage | None:
    """A stream's first image, without its pixels; None when none of the first can be decoded."""
    for probe in stream.probes:
        if isinstance(probe, RgbdMessage):
            return probe.depth if depth else probe.color
        return probe
    return None
