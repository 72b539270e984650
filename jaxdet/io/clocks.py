"""Clocks of a log: offsets between the timestamps of its topics, and the start of its time axis.

Messages that arrive together were measured together. The offset between the clocks of two topics is
therefore the difference of their median delays, i.e. of header timestamp minus log time.
"""

from bisect import bisect_left
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from jaxdet.errors import printable
from jaxdet.io.contents import LogContents
from jaxdet.io.moments import EPOCH, MICROSECOND
from jaxdet.io.options import LogOptions
from jaxdet.io.streams import ImageStream

_LEAST_S = 0.5
"""Minimum offset between different clocks [s]. Smaller offsets are explained by delayed images and
future-dated transforms."""
_STEADY = 0.2
"""Maximum deviation of single delays from their median, as a fraction of the offset."""
_AGREE_NS = 2_000_000
"""Tolerance for timestamps of the same exposure [ns]."""
_YEAR_NS = 365 * 24 * 3600 * 1_000_000_000


class Offset(NamedTuple):
    """Offset of the timestamps of a topic relative to those of depth."""

    ns: int = 0
    text: str = ""
    """Note for the user; empty if there is nothing to report."""


def color_offset(
    contents: LogContents,
    options: LogOptions,
    depth_topic: str,
    color_topic: str,
    last_delay_ns: int,
) -> Offset:
    """Return the offset of the timestamps of colour relative to depth.

    If the timestamps of both agree, different log times don't matter: one topic was written later.
    If the clock of depth was adjusted during the recording, there is no constant offset.

    Args:
        contents: Contents of the log.
        options: Options of the user.
        depth_topic: Topic of the depth images.
        color_topic: Topic of the colour images; may be empty.
        last_delay_ns: Timestamp minus log time of the last depth image.
    """
    if options.color_offset_s is not None:
        return Offset(round(options.color_offset_s * 1e9))
    if not color_topic or color_topic == depth_topic:
        return Offset()
    depth, color = contents.streams[depth_topic], contents.streams[color_topic]
    delays = _delays(depth)
    stepped = len(delays) and abs(last_delay_ns - np.median(delays)) > _LEAST_S * 1e9
    if stepped or _stamps_agree(depth, color):
        return Offset()
    found = _difference(_delays(color), _delays(depth))
    return Offset(found, _text(color_topic, found, "--log.color-offset-s")) if found else Offset()


def pose_offset(
    contents: LogContents,
    options: LogOptions,
    depth_topic: str,
    color_topic: str,
    sources: list[tuple[str, str]],
) -> Offset:
    """Return the offset of the timestamps of poses relative to depth.

    Args:
        contents: Contents of the log.
        options: Options of the user.
        depth_topic: Topic of the depth images.
        color_topic: Topic of the colour images; may be empty.
        sources: Topic and TF frame of each moving transform, or a pose topic and an empty frame.
            The offset is 0 if any of them has the clock of depth; the others may be future-dated.
    """
    if options.pose_offset_s is not None:
        return Offset(round(options.pose_offset_s * 1e9))
    depth = contents.streams[depth_topic]
    seen = [contents.delays[key].first for key in sources if key in contents.delays]
    delays = [np.array([*one.values()], np.int64) for one in seen if one]
    found = [_difference(one, _delays(depth)) for one in delays]
    if not found or not all(found):
        return Offset()
    if color_topic and color_topic != depth_topic:
        color = contents.streams[color_topic]
        near = [_difference(one, _delays(color)) for one in delays]
        if _stamps_agree(depth, color) and not all(near):
            return Offset()  # depth was written later
    least = min(found, key=abs)
    return Offset(least, _text(sources[found.index(least)][0], least, "--log.pose-offset-s"))


def first_stamp(
    count: int, stamp_ns: Callable[[int], int], log_ns: Callable[[int], int]
) -> tuple[int, int]:
    """Return the start of a log's time axis [ns], and the number of frames with older timestamps.

    The start is the first timestamp. If the clock was not set at first (timestamps of zero, or
    years before most of the others), the start is the time at which the first image was recorded.

    Args:
        count: Number of frames.
        stamp_ns: Function that returns the timestamp of a frame; timestamps are in order.
        log_ns: Function that returns the log time of a frame.
    """
    if not count:
        return 0, 0
    first, last, middle = stamp_ns(0), stamp_ns(count - 1), 0
    recorded = abs(log_ns(count - 1) - log_ns(0))
    if last - first > _YEAR_NS + recorded:
        middle = stamp_ns(count // 2)
    if first and middle - first <= _YEAR_NS:
        return first, 0
    least = max(1, middle - _YEAR_NS if middle - first > _YEAR_NS else 1)
    before = bisect_left(range(count), least, key=stamp_ns)
    if before == count:
        return 0, 0
    delay = log_ns(before) - log_ns(0)
    return stamp_ns(before) - (delay if first and 0 <= delay < _YEAR_NS else 0), before


def unset_clock_text(topic: str, count: int, first_ns: int) -> str:
    """Return the warning about timestamps from before the clock was set."""
    when = f"{EPOCH + first_ns // 1000 * MICROSECOND:%Y-%m-%d}"
    which = "first stamp is" if count == 1 else f"first {count} stamps are"
    text = f"{printable(topic)}: the {which} years before the others ({when})"
    return f"{text}: the clock was not set yet; --start counts from the first recorded image"


def _delays(stream: ImageStream) -> np.ndarray:
    """Return timestamp minus log time of the first images [ns]; empty if all stamps are zero.

    Repeated images count once, at their first log time.
    """
    first: dict[int, int] = {}
    for image in stream.first:
        first.setdefault(image.stamp_ns, image.stamp_ns - image.log_ns)
    return np.array([*first.values()] if any(first) else [], np.int64)


def _difference(first: np.ndarray, second: np.ndarray) -> int:
    """Return the offset between two clocks from their delays [ns]; 0 if they are the same clock."""
    if not len(first) or not len(second):
        return 0
    middles = [int(np.median(delays)) for delays in (first, second)]
    found = middles[0] - middles[1]
    off = [np.median(np.abs(d - m)) for d, m in zip((first, second), middles, strict=True)]
    steady = max(off) <= _STEADY * abs(found)
    return found if abs(found) > _LEAST_S * 1e9 and steady else 0


def _stamps_agree(depth: ImageStream, color: ImageStream) -> bool:
    """Return whether most of the first images of both topics have equal timestamps."""
    one, other = (
        np.array([image.stamp_ns for image in stream.first], np.int64) for stream in (depth, color)
    )
    if not len(one) or not len(other):
        return False
    apart = np.abs(one[:, None] - other[None]).min(axis=1)
    return bool((apart <= _AGREE_NS).mean() >= 0.5)


def _text(topic: str, offset_ns: int, flag: str) -> str:
    way = "ahead of" if offset_ns > 0 else "behind"
    seconds = abs(offset_ns) / 1e9
    text = f"{printable(topic)}: its clock is {seconds:.3f} s {way} depth's, by the log times"
    return f"{text}; this is corrected ({flag} 0 disables the correction)"
