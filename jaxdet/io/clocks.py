"""Clocks of a log: offsets between the timestamps of its topics, and the start of its time axis.

Messages that arrive together were measured together. The offset between the clocks of two topics is
therefore the difference of their median delays, i.e. of header timestamp minus log time.
"""

import math
from bisect import bisect_left
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from jaxdet.errors import printable
from jaxdet.io.contents import LogContents
from jaxdet.io.moments import EPOCH, MICROSECOND
from jaxdet.io.options import LogOptions
from jaxdet.io.streams import ImageStream
from jaxdet.io.topics import Choice

_LEAST_S = 0.5
"""Minimum offset between different clocks that is corrected [s]. Smaller offsets may also be due to
images that were delayed, odometry that was computed late, or future-dated transforms."""
_LATENCY_S = 0.2
"""Difference of delays [s] that exposure, processing and transport of images explain."""
_SIGMAS, _SIGMA_OF_MAD, _ERROR_OF_MEDIAN = 3, 1.4826, 1.2533
"""Number of standard errors above which a difference is significant; ratio of standard deviation
and median absolute deviation of a normal distribution; ratio of the standard errors of its median
and mean."""
_STEADY = 0.2
"""Maximum median absolute deviation of delays, as a fraction of the offset between clocks."""
_FEW_DELAYS = 5
"""Minimum number of delays from which their spread is estimated."""
_AGREE_NS = 2_000_000
"""Tolerance for timestamps of the same exposure [ns]."""
_YEAR_NS = 365 * 24 * 3600 * 1_000_000_000


class _Difference(NamedTuple):
    """Difference between the median delays of two topics."""

    ns: int
    error_ns: float
    """Standard error of the difference, from the spread of the single delays."""
    num_delays: int
    """Number of delays of the topic with fewer delays."""
    is_steady: bool
    """Whether single delays deviate little from their median, compared with the difference."""

    @property
    def offset_ns(self) -> int:
        """Offset between two clocks [ns]; 0 if it may be the same clock."""
        return self.ns if self.is_steady and abs(self.ns) > _LEAST_S * 1e9 else 0

    @property
    def is_doubtful(self) -> bool:
        """Whether latencies and the spread of the delays don't explain the difference."""
        return abs(self.ns) > _LATENCY_S * 1e9 + _SIGMAS * self.error_ns


class Offset(NamedTuple):
    """Offset of the timestamps of a topic relative to those of depth."""

    ns: int = 0
    text: str = ""
    """Note for the user; empty if there is nothing to report."""


def color_offset(
    contents: LogContents, options: LogOptions, choice: Choice, last_delay_ns: int
) -> Offset:
    """Return the offset of the timestamps of colour relative to depth.

    The offset is 0 if the timestamps of both agree: if log times differ, one topic was only written
    later. The offset is also 0 if the clock of depth was adjusted during the recording, i.e. if the
    last depth image has another delay (timestamp minus log time) than the first ones.
    """
    if options.color_offset_s is not None:
        return Offset(round(options.color_offset_s * 1e9))
    if choice.color == choice.depth:
        return Offset()
    depth, color = contents.streams[choice.depth], contents.streams[choice.color]
    delays = _delays(depth)
    stepped = len(delays) and abs(last_delay_ns - np.median(delays)) > _LEAST_S * 1e9
    if stepped or _stamps_agree(depth, color):
        return Offset()
    found = _difference(_delays(color), _delays(depth)).offset_ns
    return Offset(found, _text(choice.color, found, "--log.color-offset-s")) if found else Offset()


def pose_offset(
    contents: LogContents, options: LogOptions, choice: Choice, sources: list[tuple[str, str]]
) -> Offset:
    """Return the offset of the timestamps of poses relative to depth.

    A difference that is too small for a correction, but not explained by latency and jitter, is
    only reported: log times don't show whether a clock is wrong or poses were computed late.

    ``sources`` has topic and TF frame of each moving transform, or a pose topic and an empty frame.
    The offset is 0 if a source may have the clock of depth; other sources may be future-dated.
    """
    if options.pose_offset_s is not None:
        return Offset(round(options.pose_offset_s * 1e9))
    images = [contents.streams[choice.depth]]
    if choice.color not in ("", choice.depth):
        color = contents.streams[choice.color]
        # If the stamps agree but only depth differs from the poses, depth was written later.
        images += [color] if _stamps_agree(images[0], color) else []
    seen = {key: contents.delays[key].first for key in sources if key in contents.delays}
    delays = {key: np.array([*one.values()], np.int64) for key, one in seen.items() if one}
    found = [[_difference(one, _delays(stream)) for one in delays.values()] for stream in images]
    every = [difference for one in found for difference in one]
    if not every or not all(one.is_doubtful for one in every):
        return Offset()
    topic, least = min(zip(delays, found[0], strict=True), key=lambda item: abs(item[1].ns))
    if not all(one.offset_ns for one in every):
        known = min(one.num_delays for one in every) >= _FEW_DELAYS
        return Offset(0, _doubt(topic[0], least)) if known else Offset()
    return Offset(least.ns, _text(topic[0], least.ns, "--log.pose-offset-s"))


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


def _difference(first: np.ndarray, second: np.ndarray) -> _Difference:
    """Compare the delays of two topics, ``(N,)`` and ``(M,)`` int64 [ns], which may be empty."""
    if not len(first) or not len(second):
        return _Difference(0, 0.0, 0, is_steady=False)
    middles = [int(np.median(delays)) for delays in (first, second)]
    found = middles[0] - middles[1]
    pairs = [*zip((first, second), middles, strict=True)]
    off = [float(np.median(np.abs(delays - middle))) for delays, middle in pairs]
    variance = sum(one**2 / len(delays) for one, (delays, _) in zip(off, pairs, strict=True))
    error_ns = _ERROR_OF_MEDIAN * _SIGMA_OF_MAD * math.sqrt(variance)
    num_delays = min(len(first), len(second))
    return _Difference(found, error_ns, num_delays, is_steady=max(off) <= _STEADY * abs(found))


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


def _doubt(topic: str, found: _Difference) -> str:
    """Return the warning about a difference that is not corrected."""
    way, error_s = "ahead of" if found.ns > 0 else "behind", _SIGMAS * found.error_ns / 1e9
    text = f"{printable(topic)}: by the log times, its timestamps are {abs(found.ns) / 1e9:.2f} s "
    text += (
        f"{way} depth's (within {error_s:.2f} s by their jitter), which is not corrected; if its "
    )
    text += f"clock differs, pass --log.pose-offset-s {found.ns / 1e9:.2f}, or 0 if poses are only "
    return f"{text}published early or late"
