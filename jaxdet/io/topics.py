"""Selection of the depth and colour topics: by schema, then encoding, then name.

A log without depth is an error. Colour is optional: if it is missing, unreadable or ambiguous, the
log is used without it.

Only the components of names are matched, since drivers add various namespaces (RealSense old and
new, OAK-D, ZED, Azure Kinect, Orbbec).
"""

import re
from collections.abc import Mapping, Sequence
from functools import partial
from typing import NamedTuple

from jaxdet.errors import TopicError, printable
from jaxdet.io.compressed import is_color_file, is_compressed_depth, is_depth_file, is_jpeg
from jaxdet.io.contents import LogContents, TopicInfo
from jaxdet.io.images import is_color_encoding, is_depth_encoding
from jaxdet.io.messages import (
    IMAGE_KINDS,
    CompressedImageMessage,
    ImageMessage,
    Kind,
    kind_of,
    plain_schema_name,
)
from jaxdet.io.namespaces import affinity
from jaxdet.io.options import NO_COLOR, LogOptions
from jaxdet.io.streams import ImageStream

_ALIGNED = ("aligned_depth", "depth_to_rgb", "depth_to_color", "depth_registered")
_COLOR_WORDS = {"color", "colour", "rgb"}
_DEPTH_WORDS = {"depth", "stereo"}
_INFRARED = {"ir", "infra", "infra1"}
"""Words for images with the depth camera's own pixels; infra2 is the other camera of the stereo
pair."""
_NOT_COLOR = {"depth", "confidence", "infra2", "mask"} | _INFRARED
_NOT_DEPTH = {"confidence", "infra2", "amplitude"} | _INFRARED
_OTHER_IMAGES = _COLOR_WORDS | _NOT_DEPTH | {"mask"}
"""Words for other images of a depth camera, if the topic also has the word depth."""
_PICTURES = {"colored", "coloured", "colorized", "colormap", "heatmap", "overlay", "preview"}
_PICTURES |= {"vis", "viz", "visual", "visualization", "visualisation", "display"}
"""Words for pictures of depth for people."""
_DEVICES = {"camera", "cam", "sensor"}
"""Words next to which the word depth is part of a camera's name."""
_DISPARITY_WORDS = {"disparity", "disp", "disparities", "disparityimage"}
_VIDEOS = {
    "foxglove.CompressedVideo": "video",
    "ffmpeg_image_transport_msgs/FFMPEGPacket": "video of FFmpeg",
    "theora_image_transport/Packet": "video (Theora)",
}
_IMAGE_WORDS = (
    _COLOR_WORDS
    | _DEPTH_WORDS
    | {"image", "raw", "rect", "rectified", "mono", "gray", "grey", "rgbd", "data", "sensor"}
    | {"compressed", "compresseddepth", "aligned", "registered", "to", "sw", "hw", "transport"}
    | {"extrinsics", "zstd", "ffmpeg", "theora", "foxglove", "infra2"}
    | _DISPARITY_WORDS
    | _INFRARED
)
"""Words in topics that are not part of a camera's name."""
_CLOUDS = "sensor_msgs/PointCloud2", "foxglove.PointCloud"
_MAX_LISTED = 12
NO_COLOR_TOPIC = "no topic with colour images", "set one with --log.color"
"""Default reason for the missing colour topic, and the remedy."""
_RECORD_DEPTH = "record depth in an encoding listed by jaxdet help logs"
_MANY_MORE = 1.5
"""Ratio of the image counts of two depth topics from which on the unused topic is reported."""


class Candidate(NamedTuple):
    """A topic that may be chosen; smaller ranks are preferred."""

    topic: str
    rank: tuple[int, int, int]
    why: str


class Choice(NamedTuple):
    """Chosen topics, with reasons."""

    camera: str
    """Name of the camera."""
    depth: str
    color: str
    """Colour topic; empty if there is none."""
    aligned_by_name: bool
    reasons: tuple[str, ...]
    why_no_color: tuple[str, str] = ("", "")
    """Reason for the missing colour topic in one clause, and the remedy; both empty otherwise."""
    infrared: bool = False
    """Whether the colour topic is the infrared image of the depth camera."""
    note: str = ""
    """Note on a depth topic with more images than the chosen one; empty if there is none."""


class Choices(NamedTuple):
    """Chosen topics of all cameras of a log, by camera name in order."""

    cameras: Mapping[str, Choice | TopicError]
    """Cameras whose depth can be read, at least one; of several, one with ambiguous depth topics
    has the error."""
    unreadable: Mapping[str, TopicError]
    """Cameras whose depth can't be read; empty if the user sets a topic."""


def choose_topics(contents: LogContents, options: LogOptions) -> Choices:
    """Choose the depth and the colour topic of each camera.

    The log has several cameras if the camera names of its depth topics differ (see
    :func:`camera_name`) and the user sets no topic. Depth topics are preferred in this order: those
    that are aligned to colour, according to their names; raw before compressed images; separate
    images before RGBD messages.

    If depth of only one camera can be read, its colour topic may have a name of no camera: the
    topic with the closest namespace is used, or no topic if several are equally close. If there is
    no colour topic, the infrared image of the depth camera is used.

    Raises:
        TopicError: No topic can be depth; or the log has one camera, and its depth topic is
            ambiguous; or a topic set in the options is unusable.
    """
    depths = _candidates(contents, options.depth, True)
    best = [item.topic for item in _best(depths)]
    prefer_rect = any(is_rectified(topic) or "depth_registered" in topic for topic in best)
    without = options.color == NO_COLOR
    given = None if without else options.color
    colors = [] if without else _candidates(contents, given, False, prefer_rect)
    unreadable = _unreadable(contents)
    if not depths:
        raise _missing(contents, [*unreadable.values()])
    if any(not item.rank[1] for item in depths):  # mono16 may also be a thermal image
        streams = contents.streams
        depths = [d for d in depths if not (d.rank[1] and _is_kind(streams[d.topic], False))]
    if given or options.depth:
        choice = _choose(contents, options, colors, depths)
        return Choices({choice.camera: choice}, {})
    names = {camera_name(depth.topic) for depth in depths}
    unreadable = {name: error for name, error in unreadable.items() if name not in names}
    colors = [item for item in colors if camera_name(item.topic) not in unreadable]
    if len(names) < 2:
        choice = _choose(contents, options, colors, depths)
        return Choices({choice.camera: choice}, unreadable)
    found: dict[str, Choice | TopicError] = {}
    for name in sorted(names):
        color, depth = (
            [item for item in items if camera_name(item.topic) == name]
            for items in (colors, depths)
        )
        try:
            found[name] = _choose(contents, options, color, depth)
        except TopicError as error:
            found[name] = error
    return Choices(found, unreadable)


def camera_name(topic: str) -> str:
    """Return the name of an image topic's camera, i.e. its namespace.

    This is the topic without words that describe image types, for instance ``front`` for
    ``/front/camera/color/image_raw``; ``camera`` if nothing is left.
    """
    parts: list[str] = []
    for part in printable(topic).strip("/").split("/"):
        words = [word for word in part.split("_") if word.lower() not in _IMAGE_WORDS]
        kept = "_".join(words)
        if len(words) < len(part.split("_")) and kept.replace("_", "").isdigit():
            continue  # for example sensor_0 or Color_0
        if kept and not (parts and kept in (parts[-1], f"{parts[-1]}_node")):
            parts.append(kept)  # avoids repetition in camera/camera and zed/zed_node
    return "/".join([part for part in parts if part != "camera"]) or "camera"


def is_color_name(topic: str) -> bool:
    """Return whether a topic's name indicates colour, and not aligned depth."""
    words = _words(topic)
    return bool(words & _COLOR_WORDS) and not words & _DEPTH_WORDS


def is_rectified(topic: str) -> bool:
    """Return whether images are rectified, according to the name of their topic."""
    return any(word.startswith("rect") for word in _words(topic))


def _unreadable(contents: LogContents) -> dict[str, TopicError]:
    """Return the cameras with a depth topic that can't be read, each with the reason.

    Such topics are recognized by name or type. A camera may have another topic that can be read.
    """
    found: dict[str, TopicError] = {}
    for topic, info in sorted(contents.topics.items()):
        stream, reason = contents.streams.get(topic), None
        if _words(topic) & _PICTURES:
            continue
        if stream and stream.probes:
            reason = _why_not_depth(stream)
        elif info.count and _is_depth_topic(info):
            video = _video(info)
            reason = f"{video} is not supported" if video else info.trouble, _RECORD_DEPTH
        if reason:
            error = TopicError(reason[0], path=contents.path, topic=topic, remedy=reason[1])
            found.setdefault(camera_name(topic), error)
    return found


def _choose(
    contents: LogContents,
    options: LogOptions,
    colors: Sequence[Candidate],
    depths: Sequence[Candidate],
) -> Choice:
    """Choose the depth and the colour topic from the candidates."""
    color_best, depth_best = _best(colors), _best(depths)
    if len(depth_best) > 1 and len(color_best) == 1:
        depth_best = _nearest(depth_best, color_best[0].topic)
    if len(depth_best) > 1:
        names = listed([item.topic for item in depth_best])
        problem, remedy = f"several topics may be depth: {names}", "choose one with --log.depth"
        raise TopicError(problem, path=contents.path, remedy=remedy)
    depth = depth_best[0]
    if len(color_best) > 1:
        color_best = _same_view(contents, _nearest(color_best, depth.topic), depth.topic)
    why = "", ""
    if contents.streams[depth.topic].kind is Kind.RGBD and not options.color:
        color_best = [Candidate(depth.topic, depth.rank, "in the same message as depth")]
    infrared = not color_best and not options.color
    if infrared:
        color_best = _infrared(contents, depth.topic)
        infrared = bool(color_best)
    if len(color_best) != 1:
        why = _why_no_color(contents, options, color_best)
    color = color_best[0] if len(color_best) == 1 else None
    reasons = [f"depth: {printable(depth.topic)}, {depth.why}{_others(depths, depth)}"]
    if color:
        reasons.append(f"colour: {printable(color.topic)}, {color.why}{_others(colors, color)}")
    topic, aligned = color.topic if color else "", _says_aligned(depth.topic)
    name = camera_name(depth.topic)
    note = _more_images(contents, depth, depths)
    return Choice(name, depth.topic, topic, aligned, tuple(reasons), why, infrared, note)


def _more_images(contents: LogContents, chosen: Candidate, depths: Sequence[Candidate]) -> str:
    """Return a note if another depth topic has many more images than the chosen one, else ""."""
    most = max(depths, key=lambda item: contents.topics[item.topic].count).topic
    counts = [contents.topics[topic].count for topic in (chosen.topic, most)]
    if counts[1] < _MANY_MORE * counts[0]:
        return ""
    text = f"{printable(most)} has {counts[1]} depth images, but {printable(chosen.topic)}"
    return f"{text}, which is used, has {counts[0]}; --log.depth chooses another topic"


def _why_no_color(
    contents: LogContents, options: LogOptions, several: Sequence[Candidate]
) -> tuple[str, str]:
    """Return why a camera has no colour topic, and the remedy."""
    if options.color == NO_COLOR:
        return "--log.color none", "omit --log.color none"
    if several:
        names = listed([item.topic for item in several])
        return f"several topics may be colour ({names})", "choose one with --log.color"
    if unsupported := _unsupported(contents):
        remedy = "record colour in an encoding listed by jaxdet help logs"
        return f"unsupported: {listed(unsupported)}", remedy
    return NO_COLOR_TOPIC


def _video(info: TopicInfo) -> str | None:
    """Return the type of video of a topic; None if its messages are not video."""
    return _VIDEOS.get(plain_schema_name(info.channel.schema_name))


def _infrared(contents: LogContents, depth_topic: str) -> list[Candidate]:
    """Return the infrared image with the depth camera's pixels, if any."""
    name = camera_name(depth_topic)
    found = []
    for topic, stream in sorted(contents.streams.items()):
        if not _words(topic) & _INFRARED or camera_name(topic) != name:
            continue
        if stream.kind is not Kind.RGBD and (_is_kind(stream, False) or _is_kind(stream, True)):
            rank = 0, int(stream.kind is Kind.COMPRESSED), 0
            found.append(Candidate(topic, rank, "infrared, since there is no colour"))
    return _best(sorted(found, key=lambda item: (item.rank, item.topic)))[:1]


def listed(names: Sequence[str]) -> str:
    """Join the first names; append the number of others."""
    more = f", and {len(names) - _MAX_LISTED} more" if len(names) > _MAX_LISTED else ""
    return ", ".join(printable(name) for name in names[:_MAX_LISTED]) + more


def _words(topic: str) -> set[str]:
    return set(re.split(r"[/_]", topic.lower()))


def _says_aligned(topic: str) -> bool:
    return any(name in topic.lower() for name in _ALIGNED)


def _is_named(topic: str) -> bool:
    """Return whether the images of a topic must be depth, according to its name."""
    if not _says_aligned(topic) and _words(topic) & _OTHER_IMAGES:
        return False
    parts = map(_words, topic.split("/"))
    return any("depth" in words and not words & _DEVICES for words in parts)


def _candidates(
    contents: LogContents, override: str | None, depth: bool, prefer_rect: bool = False
) -> list[Candidate]:
    if override:
        return [_overridden(contents, override, depth)]
    make = _depth_candidate if depth else partial(_color_candidate, prefer_rect=prefer_rect)
    found = [
        candidate
        for stream in contents.streams.values()
        if not _is_eye(stream.topic, contents) and (candidate := make(stream)) is not None
    ]
    return sorted(found, key=lambda item: (item.rank, item.topic))


def _is_eye(topic: str, contents: LogContents) -> bool:
    """Return whether a topic is the left or right image of a ZED that also has an rgb topic."""
    color = re.sub("/(left|right)/", "/rgb/", topic)
    return color != topic and color in contents.streams


def _overridden(contents: LogContents, topic: str, depth: bool) -> Candidate:
    what, flag = ("depth", "--log.depth") if depth else ("colour", "--log.color")
    stream = contents.streams.get(topic)
    if depth and stream is not None and (reason := _why_not_depth(stream)):
        raise TopicError(reason[0], path=contents.path, topic=topic, remedy=reason[1])
    if stream is None:
        known = contents.topics.get(topic)
        reason = (known and known.trouble) or "the topic has no images"
        streams = sorted(contents.streams.items())
        names = [name for name, one in streams if not one.probes or _is_kind(one, depth)]
        remedy = f"set {flag} to one of: {listed(names) or f'none, the log has no {what} images'}"
        raise TopicError(reason, path=contents.path, topic=topic, remedy=remedy)
    mistaken = not depth and _is_kind(stream, True) and bool(_words(topic) & _DEPTH_WORDS)
    if stream.probes and stream.kind is not Kind.RGBD and (mistaken or not _is_kind(stream, depth)):
        encoding = printable(stream.encoding(depth))
        problem = f"encoding {encoding!r} is not a supported {what} encoding"
        if mistaken:
            problem = f"the topic has depth images ({encoding}), not colour"
        raise TopicError(problem, path=contents.path, topic=topic, remedy=f"change {flag}")
    return Candidate(topic, (0, 0, 0), f"set by {flag}")


def _is_kind(stream: ImageStream, depth: bool) -> bool:
    image = stream.first_image(depth)
    if stream.kind is Kind.RGBD:
        return True
    if isinstance(image, ImageMessage):
        return is_depth_encoding(image.encoding) if depth else is_color_encoding(image.encoding)
    if image is None:
        return False
    is_depth = is_depth_file(image, stream.topic)
    return is_depth if depth else not is_depth and is_color_file(image)


def _why_not_depth(stream: ImageStream) -> tuple[str, str] | None:
    """Return why images are not depth though their topic or format suggests it, with the remedy.

    The result is None if the images may be depth.
    """
    image, is_named = stream.first_image(True), _is_named(stream.topic)
    of_disparity = "disparity" in stream.topic.lower() or _words(stream.topic) & _DISPARITY_WORDS
    if of_disparity and stream.kind in (Kind.IMAGE, Kind.COMPRESSED):
        remedy = "record the depth image, or stereo_msgs/DisparityImage (it has focal length and "
        return "the topic has disparity in pixels, not depth in metres", f"{remedy}baseline)"
    if isinstance(image, CompressedImageMessage) and is_jpeg(image):
        if not is_named and not is_compressed_depth(image.format, stream.topic):
            return None
        problem = "depth was recorded as JPEG (8 bits, lossy), so its distances are lost"
        remedy = "record the compressedDepth topic, or set the format of image_transport's "
        return problem, f"{remedy}compressed transport to png (now {image.format.strip()!a})"
    if is_named and image is not None and not _is_kind(stream, True):
        encoding = printable(stream.encoding(True))
        problem = f"encoding {encoding!r} is not a supported depth encoding"
        if stream.kind is Kind.COMPRESSED:
            problem = f"the files (format {encoding!r}) are not in a supported depth format"
        return problem, _RECORD_DEPTH
    return None


def _is_depth_topic(info: TopicInfo) -> bool:
    """Return whether all messages of a topic must be depth, according to its type and name."""
    kind = kind_of(info.channel.schema_name)
    is_image = kind in IMAGE_KINDS or _video(info) is not None
    return kind is Kind.DISPARITY or (is_image and _is_named(info.channel.topic))


def _depth_candidate(stream: ImageStream) -> Candidate | None:
    if _why_not_depth(stream):
        return None
    words = _words(stream.topic)
    named = bool(words & _DEPTH_WORDS)
    other = bool(words & (_NOT_DEPTH | _COLOR_WORDS)) and not named
    if not _is_kind(stream, True) or other or "confidence" in words:
        return None
    if stream.kind is Kind.RGBD:
        return Candidate(stream.topic, (2, 0, 0), "an RGBD message")
    if stream.kind is Kind.DISPARITY:
        return Candidate(stream.topic, (3, 0, 0), "depth from disparity, focal length and baseline")
    aligned = _says_aligned(stream.topic)
    rank = (0 if aligned else 1, 0 if named else 1, int(stream.kind is Kind.COMPRESSED))
    encoding = printable(stream.encoding(True))
    why = "aligned to colour by its name" if aligned else "matched by encoding"
    return Candidate(stream.topic, rank, f"{why} ({encoding})")


def _color_candidate(stream: ImageStream, prefer_rect: bool) -> Candidate | None:
    words = _words(stream.topic)
    if stream.kind is Kind.RGBD:
        return Candidate(stream.topic, (3, 0, 0), "an RGBD message")
    if not _is_kind(stream, False) or words & _NOT_COLOR or _why_not_depth(stream):
        return None
    encoding = stream.encoding(False)
    named = bool(words & _COLOR_WORDS)
    if _is_kind(stream, True) and not named:
        return None  # 16-bit images may be thermal, confidence or depth
    grey = encoding.lower() in ("mono8", "8uc1", "mono16", "16uc1")
    tier = 2 if grey else 0 if named else 1
    is_other = is_rectified(stream.topic) != prefer_rect
    rank = tier, int(stream.kind is Kind.COMPRESSED), int(is_other)
    why = "matched by name" if named else "matched by encoding"
    return Candidate(stream.topic, rank, f"{why} ({printable(encoding)})")


def _best(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Return the candidates with the smallest rank."""
    return [item for item in candidates if item.rank == candidates[0].rank]


def _nearest(candidates: Sequence[Candidate], topic: str) -> list[Candidate]:
    best = max(affinity(item.topic, topic) for item in candidates)
    return [item for item in candidates if affinity(item.topic, topic) == best]


def _same_view(
    contents: LogContents, colors: Sequence[Candidate], depth_topic: str
) -> Sequence[Candidate]:
    """Return the colour topics with the TF frame and image size of depth; if there are none, all.

    A ZED, for instance, publishes both eyes next to each other, and an OAK-D a small preview.
    """
    depth = contents.streams[depth_topic]
    views = {item: contents.streams[item.topic] for item in colors}
    view = depth.frame_id(True), depth.size(True)
    same = [item for item, one in views.items() if (one.frame_id(False), one.size(False)) == view]
    return same if same and view[0] else colors


def _missing(contents: LogContents, unreadable: Sequence[TopicError]) -> TopicError:
    if not contents.streams and any(name.startswith("/jaxdet/") for name in contents.topics):
        problem, remedy = "an export of jaxdet, without images", "pass the original log"
        return TopicError(problem, path=contents.path, remedy=remedy)
    if unreadable:
        first, *more = unreadable
        problem = f"no topic with depth images: {first.problem}"
        others = [f"{error.topic}: {error.problem}" for error in more[:_MAX_LISTED]]
        problem = "; ".join([problem, *others])
        return TopicError(problem, path=contents.path, topic=first.topic, remedy=first.remedy)
    names = []
    topics = sorted(contents.topics.items(), key=lambda it: (it[0] not in contents.streams, it))
    for name, info in topics:
        kind = "" if info.problem else info.channel.schema_name or "no schema"
        encoding = contents.streams[name].encoding(False) if name in contents.streams else ""
        names.append(f"{name} ({', '.join(filter(None, (kind, encoding, info.trouble)))})")
    known = f"the log has the topics {listed(names)}"
    if unsupported := _unsupported(contents):
        known = f"unsupported: {listed(unsupported)}; {known}"
    remedy = f"{_RECORD_DEPTH}, or pass --log.depth TOPIC"
    schemas = {name: plain_schema_name(info.channel.schema_name) for name, info in topics}
    if clouds := [name for name, schema in schemas.items() if schema in _CLOUDS]:
        known = f"PointCloud2 ({listed(clouds)}) is not supported; {known}"
        remedy = "record the depth images from which the clouds were computed"
    silent = [name for name, info in topics if not info.count]
    if len(silent) == len(topics):
        known = "; ".join(["the log has no messages", *([known] if names else [])])
        remedy = "copy or record the log again"
    elif depths := [name for name in silent if _is_depth_topic(contents.topics[name])]:
        known = f"no messages on {listed(depths)}; {known}"
        remedy = "record again while the driver of the camera runs"
    return TopicError(f"no topic with depth images; {known}", path=contents.path, remedy=remedy)


def _unsupported(contents: LogContents) -> list[str]:
    """Return the images that are neither colour nor depth: encoding or kind of video, and topic."""
    found = []
    for topic, info in sorted(contents.topics.items()):
        stream, kind = contents.streams.get(topic), _video(info)
        if stream and stream.probes and not (_is_kind(stream, True) or _is_kind(stream, False)):
            kind = f"{stream.encoding(False)!a}"
        if kind and not _is_named(topic):
            found.append(f"{kind} of {topic}")
    return found


def _others(candidates: Sequence[Candidate], chosen: Candidate) -> str:
    names = [item.topic for item in candidates if item.topic != chosen.topic]
    return f"; preferred over {listed(names)}" if names else ""
