"""Contents of a log from its messages: the first images of each topic, and all small messages.

A transform or pose takes 72 bytes of memory; pixels are not stored.
"""

from contextlib import suppress
from copy import copy

import numpy as np

from jaxdet.errors import FrameError
from jaxdet.io.compressed import is_depth_file, typical_depth
from jaxdet.io.declarations import ChannelInfo
from jaxdet.io.decode_messages import MessageDecoder
from jaxdet.io.file_index import FileIntegrity
from jaxdet.io.images import check_pixels, is_depth_encoding
from jaxdet.io.limits import check_topics
from jaxdet.io.messages import (
    IMAGE_KINDS,
    CameraInfoMessage,
    CompressedImageMessage,
    ImageMessage,
    Kind,
    RgbdMessage,
    TransformMessage,
    kind_of,
)
from jaxdet.io.motion import MotionSamples
from jaxdet.io.namespaces import namespace_of, namespaces_of_camera
from jaxdet.io.streams import (
    NUM_PROBES,
    NUM_TYPICAL,
    PROBE_BYTES,
    FirstImage,
    ImageSize,
    ImageStream,
)
from jaxdet.io.transforms import TransformTree
from jaxdet.io.validity import CalibrationChange, values_of

FIRST_MOTIONS = 64
"""Minimum number of messages read at opening per topic with transforms or poses."""
DEPTH_UNIT_TOPIC = "/option/Depth Units/value"
"""Last part of the topic in which librealsense's recorder stores the metres per depth unit."""


class TopicInfo:
    """Statistics of a topic."""

    def __init__(self, channel: ChannelInfo) -> None:
        self.channel = channel
        self.count = 0
        self.first_ns = (1 << 63) - 1
        self.last_ns = 0
        self.undecodable = 0
        self.why = ""
        """Reason why the first of the ``undecodable`` messages can't be decoded."""
        self.problem = ""
        """Reason why the messages are unusable; empty if they are usable."""

    def add_undecodable(self, why: str) -> None:
        """Count a message that can't be decoded."""
        self.undecodable += 1
        self.why = self.why or why

    @property
    def trouble(self) -> str:
        """Problem with the messages of the topic; empty if there is none."""
        if not self.count:
            return "no messages"
        if self.problem or not self.undecodable:
            return self.problem
        return f"{self.undecodable} of {self.count} messages can't be decoded: {self.why}"


class CalibrationTopic:
    """Calibrations on one topic."""

    def __init__(self) -> None:
        self.first: CameraInfoMessage | None = None
        """First calibration with a focal length, or else the first calibration."""
        self._of_size: dict[ImageSize, CameraInfoMessage] = {}
        self.changes: list[CalibrationChange] = []
        """Changes of the calibration, in file order."""
        self.last_payload = b""

    def add(self, info: CameraInfoMessage, log_ns: int) -> None:
        """Add a calibration message."""
        values = values_of(info)
        if values is not None and (not self.changes or self.changes[-1].values != values):
            self.changes.append(CalibrationChange(info.stamp_ns, log_ns, values))
        if self.first is None or (values is not None and values_of(self.first) is None):
            self.first = info
        for size in info.image_sizes() if values is not None else ():
            self._of_size.setdefault(ImageSize(*size), info)

    def of(self, size: ImageSize | None) -> CameraInfoMessage | None:
        """Return the first calibration for images of this size, or else :attr:`first`."""
        return (size and self._of_size.get(size)) or self.first

    @property
    def frame_id(self) -> str:
        """TF frame of the first calibration; empty if there is none."""
        return self.first.frame_id if self.first else ""


class PoseTrack:
    """Poses of the robot on one topic."""

    def __init__(self, first: TransformMessage) -> None:
        self.parent, self.child = first.parent, first.child
        self.samples = MotionSamples()


class LogContents:
    """Contents of a log, without the pixels of its images; ``path`` is for errors."""

    def __init__(self, path: str) -> None:
        self.path = path
        self.topics: dict[str, TopicInfo] = {}
        self.streams: dict[str, ImageStream] = {}
        self.calibrations: dict[str, CalibrationTopic] = {}
        self.extrinsics: dict[str, np.ndarray] = {}
        """First extrinsics per topic, ``(4, 4)`` float64."""
        self.depth_units: dict[str, float] = {}
        """First value on each :data:`DEPTH_UNIT_TOPIC`, by topic [m]."""
        self.poses: dict[str, PoseTrack] = {}
        self.trees: dict[str, TransformTree] = {}
        """Transforms by namespace."""
        self.tree = TransformTree(path)
        """Transforms of the camera's robot, see :meth:`of_camera`."""
        self.integrity: list[FileIntegrity] = []
        self.warnings: list[str] = []
        self.notes: list[str] = []
        """Remarks that need no action."""

    def of_camera(self, topic: str) -> "LogContents":
        """Return a copy with the transforms of the robot whose camera has this depth topic."""
        own, others = namespaces_of_camera(self.trees, topic, self.streams)
        found = copy(self)
        found.tree = TransformTree.joined(
            [self.trees[name] for name in own], [self.trees[name] for name in others]
        )
        return found

    @property
    def has_static(self) -> bool:
        """Whether there are static transforms."""
        return any(tree.has_static for tree in self.trees.values())

    @property
    def tracks(self) -> dict[str, MotionSamples]:
        """Samples of each pose topic."""
        return {name: track.samples for name, track in self.poses.items()}


class ContentsBuilder:
    """Collects the messages of one file after the other.

    Args:
        contents: Contents to add to.
        use_tf: Whether transforms are used.
        images: Whether images are added and messages counted; False for other splits of the
            recording, from which only calibrations and static transforms are read.
    """

    def __init__(self, contents: LogContents, use_tf: bool, images: bool = True) -> None:
        self.contents, self.use_tf, self.images = contents, use_tf, images
        self._motions_seen: dict[str, int] = {}
        self._decoders: dict[ChannelInfo, MessageDecoder | None] = {}

    def decoder(self, channel: ChannelInfo) -> MessageDecoder | None:
        """Return the decoder of a channel; None if its messages are unused or not decodable."""
        self._topic(channel)
        return self._decoders[channel] if channel in self._decoders else self._decoder(channel)

    def wants(self, decoder: MessageDecoder) -> bool:
        """Return whether messages of this decoder are used."""
        if decoder.kind in IMAGE_KINDS:
            return self.images
        if decoder.kind is Kind.NUMBER:
            return decoder.channel.topic.endswith(DEPTH_UNIT_TOPIC)
        return self.use_tf or decoder.kind is not Kind.TRANSFORM

    def count(self, channel: ChannelInfo, messages: int, first_ns: int, last_ns: int) -> None:
        """Count messages without reading them."""
        if self.images:
            topic = self._topic(channel)
            topic.count += messages
            topic.first_ns = min(topic.first_ns, first_ns)
            topic.last_ns = max(topic.last_ns, last_ns)

    def take(self, decoder: MessageDecoder, log_ns: int, payload: memoryview) -> None:
        """Add a message of a kind that is used; the pixels of images are not kept."""
        topic = decoder.channel.topic
        try:
            if decoder.kind in IMAGE_KINDS:
                self._image(topic, decoder, log_ns, payload)
            else:
                self._small(topic, decoder, payload, log_ns)
        except FrameError as error:
            self.contents.topics[topic].add_undecodable(error.problem)

    def is_probe(self, decoder: MessageDecoder) -> bool:
        """Return whether to decode a topic's next image: one of the first, or an RGBD message."""
        stream = self.contents.streams.get(decoder.channel.topic)
        return decoder.kind is Kind.RGBD or stream is None or len(stream.probes) < NUM_PROBES

    def _topic(self, channel: ChannelInfo) -> TopicInfo:
        topics = self.contents.topics
        if channel.topic not in topics:
            check_topics(len(topics) + 1, self.contents.path)
            topics[channel.topic] = TopicInfo(channel)
        return topics[channel.topic]

    def _decoder(self, channel: ChannelInfo) -> MessageDecoder | None:
        decoder = None
        if kind_of(channel.schema_name) is not None:
            try:
                decoder = MessageDecoder(channel)
            except ValueError as error:
                self.contents.topics[channel.topic].problem = str(error)
        self._decoders[channel] = decoder
        return decoder

    def _image(self, topic: str, decoder: MessageDecoder, log_ns: int, payload: memoryview) -> None:
        stream = self.contents.streams.get(topic)
        if stream is None:
            stream = self.contents.streams[topic] = ImageStream(topic, decoder.kind)
        # An image that can't be decoded remains a frame, with its log time as timestamp.
        stamp = log_ns
        try:
            stamp = decoder.stamp_ns(payload)
            stamp = self._probe(stream, decoder, payload, log_ns)
        finally:
            if len(stream.first) < NUM_PROBES:
                stream.first.append(FirstImage(stamp, log_ns, len(payload)))

    def _probe(
        self, stream: ImageStream, decoder: MessageDecoder, payload: memoryview, log_ns: int
    ) -> int:
        message = decoder.decode(payload)
        if isinstance(message, RgbdMessage):
            for name, info in (("rgb", message.color_info), ("depth", message.depth_info)):
                self._calibrations(f"{stream.topic} ({name})").add(info, log_ns)
            if len(stream.probes) < NUM_PROBES:
                for image in (message.color, message.depth):
                    check_pixels(image)
                _see_depth(stream, message.depth)
                color, depth = (one._replace(data=b"") for one in (message.color, message.depth))
                stream.probes.append(message._replace(color=color, depth=depth))
            return message.depth.stamp_ns
        assert isinstance(message, ImageMessage | CompressedImageMessage)
        _see_depth(stream, message)
        if isinstance(message, ImageMessage):
            check_pixels(message)
            stream.probes.append(message._replace(data=b""))
        else:
            stream.probes.append(message._replace(data=bytes(message.data[:PROBE_BYTES])))
        return message.stamp_ns

    def _calibrations(self, topic: str) -> CalibrationTopic:
        return self.contents.calibrations.setdefault(topic, CalibrationTopic())

    def _small(self, topic: str, decoder: MessageDecoder, payload: memoryview, log_ns: int) -> None:
        if decoder.kind is Kind.INFO:
            known = self._calibrations(topic)
            rest = decoder.after_stamp(payload)
            if rest != known.last_payload:
                message = decoder.decode(payload)
                assert isinstance(message, CameraInfoMessage)
                known.add(message, log_ns)
                known.last_payload = rest
        elif decoder.kind is Kind.EXTRINSICS:
            message = decoder.decode(payload)
            assert isinstance(message, np.ndarray)
            self.contents.extrinsics.setdefault(topic, message)
        elif decoder.kind is Kind.NUMBER:
            message = decoder.decode(payload)
            assert isinstance(message, float)
            self.contents.depth_units.setdefault(topic, message)
        else:
            self._motions(topic, decoder, payload, log_ns)

    def _motions(
        self, topic: str, decoder: MessageDecoder, payload: memoryview, log_ns: int
    ) -> None:
        motions = decoder.motions(payload)
        seen = self._motions_seen[topic] = self._motions_seen.get(topic, 0) + 1
        first = seen <= FIRST_MOTIONS
        if decoder.kind is Kind.TRANSFORM:
            if decoder.is_static or self.images:
                trees, new = self.contents.trees, TransformTree(self.contents.path)
                tree = trees.setdefault(namespace_of(topic), new)
                how = decoder.is_static, decoder.is_foxglove, topic, log_ns
                tree.add(motions, *how, is_first=first)
        elif self.images:
            poses = self.contents.poses
            for item in motions:
                if topic not in poses:
                    poses[topic] = PoseTrack(item)
                sample = item.stamp_ns, item.translation, item.rotation, log_ns
                poses[topic].samples.add(*sample, is_first=first)


def image_stamps(decoder: MessageDecoder, payload: memoryview) -> tuple[int, int]:
    """Return the timestamps of depth and colour in a message [ns]; equal for a single image.

    Raises:
        FrameError: The message can't be decoded.
    """
    stamp = decoder.stamp_ns(payload)
    if decoder.kind is Kind.RGBD:
        with suppress(FrameError):
            message = decoder.decode(payload)
            assert isinstance(message, RgbdMessage)
            return message.depth.stamp_ns, message.color.stamp_ns
    return stamp, stamp


def _see_depth(stream: ImageStream, image: ImageMessage | CompressedImageMessage) -> None:
    """Add the median of the image to those of the stream if it is one of the first with depth."""
    if isinstance(image, ImageMessage):
        is_depth = is_depth_encoding(image.encoding)
    else:
        is_depth = is_depth_file(image, stream.topic)
    if is_depth and len(stream.typical) < NUM_TYPICAL:
        with suppress(FrameError):  # damage is reported when the frames are read
            value = typical_depth(image)
            stream.typical += [value] if np.isfinite(value) else []
