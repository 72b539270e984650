"""First messages of an image topic."""

from collections import Counter
from contextlib import suppress
from typing import NamedTuple

from jaxdet.errors import FrameError
from jaxdet.io.compressed import compressed_size
from jaxdet.io.messages import CompressedImageMessage, ImageMessage, Kind, RgbdMessage
from jaxdet.io.zstd_images import is_zstd, read_zstd_head

NUM_PROBES = 8
"""Number of first messages examined per topic with images or calibrations."""
NUM_TYPICAL = 1
"""Number of depth images per topic that are decoded at opening to check the depth unit."""
PROBE_BYTES = 1 << 16
"""Size of the part of a compressed image that is kept for its header [byte]."""


class ImageSize(NamedTuple):
    """Width and height [pixel]."""

    width: int
    height: int


class FirstImage(NamedTuple):
    """Times and size of one of the first messages, even if the message can't be decoded."""

    stamp_ns: int
    """Header timestamp [ns], for RGBD that of depth; the log time if it can't be decoded."""
    log_ns: int
    size: int
    """Size of the payload [byte]."""


class ImageStream:
    """The first messages of one image topic."""

    def __init__(self, topic: str, kind: Kind) -> None:
        self.topic, self.kind = topic, kind
        self.first: list[FirstImage] = []
        """First ``NUM_PROBES`` messages."""
        self.probes: list[ImageMessage | CompressedImageMessage | RgbdMessage] = []
        """First ``NUM_PROBES`` decodable messages, without pixels."""
        self.typical: list[float] = []
        """Median values of the first ``NUM_TYPICAL`` depth images, in the unit of the image."""

    def images(self, depth: bool) -> list[ImageMessage | CompressedImageMessage]:
        """Return the first depth or colour images, without pixels."""
        return [
            (probe.depth if depth else probe.color) if isinstance(probe, RgbdMessage) else probe
            for probe in self.probes
        ]

    def first_image(self, depth: bool) -> ImageMessage | CompressedImageMessage | None:
        """Return the first depth or colour image.

        The result is None if none of the first messages can be decoded.
        """
        return next(iter(self.images(depth)), None)

    def frame_id(self, depth: bool) -> str:
        """Return the TF frame of the first image; empty if unknown."""
        image = self.first_image(depth)
        return image.frame_id if image else ""

    def encoding(self, depth: bool) -> str:
        """Return the encoding or format of the first image; empty if unknown."""
        image = self.first_image(depth)
        if isinstance(image, CompressedImageMessage):
            return image.format
        return image.encoding if image else ""

    @property
    def has_floats(self) -> bool:
        """Whether the depth images are 32FC1, compressed or not."""
        image, text = self.first_image(True), self.encoding(True)
        if isinstance(image, CompressedImageMessage) and is_zstd(image.format):
            head = read_zstd_head(image.data)
            text = head.encoding if head else ""
        return text.partition(";")[0].strip().lower() == "32fc1"

    def size(self, depth: bool) -> ImageSize | None:
        """Return the most common size of the first images, without decoding; None if unknown."""
        sizes: Counter[ImageSize] = Counter()
        for image in self.images(depth):
            if isinstance(image, ImageMessage):
                sizes[ImageSize(image.width, image.height)] += 1
                continue
            with suppress(FrameError):
                sizes[ImageSize(*compressed_size(image))] += 1
        return max(sizes, key=sizes.__getitem__, default=None)
