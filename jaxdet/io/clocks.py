"""Clocks of a log: how far the stamps of its topics are apart, and where its seconds begin.

What a recorder receives together was measured together, so the log times say how far the clocks of
two topics differ: by the difference of their medians of header stamp less log time.
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
"""Clocks that differ by less are one clock: images are delayed, and transforms dated ahead."""
_STEADY = 0.2
"""Share of the difference by which single delays may be off their median."""
_AGREE_NS = 2_000_000
"""Stamps of one exposure are equal to within this."""
_YEAR_NS = 365 * 24 * 3600 * 1_000_000_000


class Offset(NamedTuple):
    """How far a topic's stamps are ahead of depth's."""

    ns: int = 0
    text: str = ""
    """What to tell of it; empty if nothing is to be told."""


def color_offset(
    contents: LogContents,
    options: LogOptions,
    depth_topic: str,
    color_topic: str,
    last_delay_ns: int,
) -> Offset:
    """Return how far colour's stamps are ahead of depth's.

    Where the stamps of both agree, their log times don't matter: one was written later. Where the
    clock of depth was set while the log was recorded, there is no one offset.

    Args:
        contents: The log's.
        options: What the user says.
        depth_topic: Topic of the depth images.
        color_topic: Topic of the colour images; may be empty.
        last_delay_ns: Stamp less log time of the last depth image.
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
    """Return how far the stamps of poses are ahead of depth's.

    Args:
        contents: The log's.
        options: What the user says.
        depth_topic: Topic of the depth images.
        color_topic: Topic of the colour images; may be empty.
        sources: Topic and frame of each transform that moves, or a topic with poses and nothing.
            One of them that is of depth's clock is enough: others may be dated ahead.
    """
    if options.pose_offset_s is not None:
        return Offset(round(options.pose_offset_s * 1e9))
    depth = contents.streams[depth_topic]
    seen = [contents.delays[key].first for key in sources if key in contents.delays]
    delays = [np.array(one, np.int64) for one in seen if one]
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
    """Return from when the seconds of a log count [ns], and how many frames have older stamps.

    That is the first stamp, but for those of a clock that was not set yet: zeros, and stamps years
    before most of the others. Then it is when the first image was recorded.

    Args:
        count: Frames.
        stamp_ns: The stamp of a frame; they are in order.
        log_ns: The log time of a frame.
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
    """Return the warning about stamps of a clock that was not set yet."""
    when = f"{EPOCH + first_ns // 1000 * MICROSECOND:%Y-%m-%d}"
    which = "first stamp is" if count == 1 else f"first {count} stamps are"
    text = f"{printable(topic)}: the {which} years before the others ({when})"
    return f"{text}: the clock was not set yet; --start counts from when the first was recorded"


def _delays(stream: ImageStream) -> np.ndarray:
    """Return header stamp less log time of the first images [ns]; none if a stamp is zero."""
    if not any(image.stamp_ns for image in stream.first):
        return np.zeros(0, np.int64)
    return np.array([image.stamp_ns - image.log_ns for image in stream.first], np.int64)


def _difference(first: np.ndarray, second: np.ndarray) -> int:
    """Return the difference of two clocks by their delays [ns]; 0 where they are one."""
    if not len(first) or not len(second):
        return 0
    middles = [int(np.median(delays)) for delays in (first, second)]
    found = middles[0] - middles[1]
    off = [np.median(np.abs(d - m)) for d, m in zip((first, second), middles, strict=True)]
    steady = max(off) <= _STEADY * abs(found)
    return found if abs(found) > _LEAST_S * 1e9 and steady else 0


def _stamps_agree(depth: ImageStream, color: ImageStream) -> bool:
    """Return whether most of the first images of both have the same stamps."""
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
    text = f"{printable(topic)}: by the log times its clock is {seconds:.3f} s {way} depth's"
    return f"{text}; that is allowed for, {flag} 0 takes the stamps as they are"
