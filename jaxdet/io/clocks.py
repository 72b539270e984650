"""Clocks of a log: adjustments of a topic's clock, and offsets between the clocks of two topics.

Messages that arrive together were measured together. The delays of a topic, i.e. header timestamp
minus log time, are therefore constant except for latency. If they form groups that are far apart,
the clock was set or adjusted during the recording. The offset between the clocks of two topics is
the difference of their median delays.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxdet.errors import printable
from jaxdet.io.message_fields import MAX_STAMP_S
from jaxdet.io.moments import EPOCH, MICROSECOND
from jaxdet.io.streams import NUM_PROBES

MIN_STEP_NS = 500_000_000
"""Minimum difference between clocks that is corrected [ns]. Smaller ones may also be due to images
that were delayed, odometry that was computed late, or future-dated transforms."""
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
_MAX_GROUPS = 16
"""Maximum number of groups of delays that are compared; the largest ones are used."""
_MIN_SHARE = 0.05
"""Minimum fraction of a topic's timestamps from which on their clock may be the right one."""
_YEAR_NS = 365 * 24 * 3600 * 1_000_000_000
_MAX_NS = MAX_STAMP_S * 1_000_000_000
"""Largest timestamp [ns]; damaged times may differ by more than 64 bits."""


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
        return self.ns if self.is_steady and MIN_STEP_NS < abs(self.ns) <= _MAX_NS else 0

    @property
    def is_doubtful(self) -> bool:
        """Whether latencies and the spread of the delays don't explain the difference."""
        return abs(self.ns) > _LATENCY_S * 1e9 + _SIGMAS * self.error_ns


class Offset(NamedTuple):
    """Offset of the timestamps of a topic relative to those of depth."""

    ns: int = 0
    text: str = ""
    """Note for the user; empty if there is nothing to report."""


class Clock(NamedTuple):
    """Timestamps of a topic, without the adjustments of its clock."""

    topic: str
    stamps_ns: np.ndarray
    """Timestamps in order of arrival, ``(N,)`` int64 [ns]."""
    delays_ns: np.ndarray
    """First delays of the messages whose timestamps are unchanged, ``(M,)`` int64 [ns]."""
    shifts_ns: tuple[int, ...] = ()
    """Time by which each group of timestamps was moved [ns]."""
    text: str = ""
    """Warning for the user; empty if no timestamp was moved, or only as on another topic."""


def read_clock(
    topic: str,
    stamps_ns: np.ndarray,
    log_ns: np.ndarray,
    num_first: int,
    shifts_ns: Sequence[int] = (),
    content: np.ndarray | None = None,
) -> Clock:
    """Return the timestamps of a topic as if its clock had never been set or adjusted.

    The timestamps whose delays are closest to 0 are right. Other groups of delays are moved to them
    if this makes the intervals between timestamps more even; otherwise the messages were recorded
    late, or the log times are wrong. Timestamps of zero are replaced by log times.

    Args:
        topic: Name of the topic.
        stamps_ns: Header timestamps in order of arrival, ``(N,)`` int64 [ns].
        log_ns: Log times ``(N,)`` int64 [ns].
        num_first: Number of messages whose delays are returned; more are not read by the index.
        shifts_ns: Shifts of another topic; they are used instead of estimates near them, since all
            clocks of a robot are usually adjusted together.
        content: Content of the messages, ``(N, K)``. Messages with equal timestamps and content
            count once, at their first log time; None: all messages differ.
    """
    if not stamps_ns.any():
        return Clock(topic, stamps_ns, stamps_ns[:0])
    content = np.arange(len(stamps_ns))[:, None] if content is None else content
    keys = np.column_stack([stamps_ns, content]) * (stamps_ns != 0)[:, None]
    _, index, inverse = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    stamps, inverse = stamps_ns[index], inverse.reshape(-1)
    arrival = np.argsort(index)
    delays = np.empty_like(stamps)
    delays[arrival] = stamps[arrival] - _without_jumps(log_ns[index[arrival]])
    order = np.argsort(delays, kind="stable")
    ends = np.flatnonzero(np.diff(delays[order]) > MIN_STEP_NS) + 1
    groups = sorted(np.split(order, ends), key=len, reverse=True)[:_MAX_GROUPS]
    levels = [int(delays[group[len(group) // 2]]) for group in groups]
    is_rare = [len(group) < _MIN_SHARE * len(stamps) for group in groups]
    right = min(range(len(groups)), key=lambda n: (is_rare[n], abs(levels[n])))
    moved, shifts, texts = stamps.copy(), [], []
    for level, group in zip(levels, groups, strict=True):
        shift = levels[right] - level
        shift = next((one for one in shifts_ns if abs(one - shift) <= MIN_STEP_NS), shift)
        low, high = (int(end) + shift for end in (stamps[group].min(), stamps[group].max()))
        if not shift or low < 0 or high > _MAX_NS:
            continue
        trial = moved.copy()
        trial[group] += shift
        if _unevenness(moved) - _unevenness(trial) > abs(shift) / 2:
            moved = trial
            shifts.append(shift)
            texts.append(_group_text(stamps_ns[np.isin(inverse, group)], shift))
    found = moved[inverse]
    unset = (stamps_ns == 0) & (found != 0)
    found[unset] = np.clip(log_ns[unset] + levels[right], 0, _MAX_NS)
    first = arrival[np.isin(arrival, groups[right])][: int((index < num_first).sum())]
    text = ""
    if not set(shifts) <= set(shifts_ns):
        text = f"{printable(topic)}: of {len(stamps_ns)} timestamps, {' and '.join(texts)}, by the "
        text += "log times: its clock was set or adjusted during the recording; these timestamps "
        text += "are moved, as are those of other topics with this clock"
    return Clock(topic, found, delays[first], tuple(shifts), text)


def jumps(log_ns: np.ndarray) -> np.ndarray:
    """Return after which of the log times in file order the recorder's clock was adjusted.

    A pause of the recording is not a jump, unless it is longer than a year.

    Args:
        log_ns: Log times ``(N,)`` int64 [ns].

    Returns:
        ``(N - 1,)`` bool.
    """
    steps = np.diff(log_ns)
    return (steps < -MIN_STEP_NS) | (steps > _YEAR_NS)


def find_offset(
    given_s: float | None, flag: str, images: Sequence[Clock], sources: Sequence[Clock]
) -> Offset:
    """Return the offset of the timestamps of colour or poses relative to depth.

    The offset is 0 if the timestamps of both agree: if log times differ, one topic was only written
    later. A difference that is too small for a correction, but not explained by latency and jitter,
    is only reported: log times don't show whether a clock is wrong or messages were published late.

    Args:
        given_s: Offset from the options [s].
        flag: Name of the option.
        images: Clocks of depth, and of other images if their timestamps may agree.
        sources: Clock of colour, of the pose topic, or of each moving transform. The offset is 0 if
            one of them may have the clock of depth; others may be future-dated.
    """
    if given_s is not None:
        return Offset(round(given_s * 1e9))
    # If the stamps agree but only depth differs from the others, depth was written later.
    images = [images[0], *(one for one in images[1:] if _stamps_agree(images[0], one))]
    sources = [one for one in sources if len(one.delays_ns)]
    found = [[_difference(one.delays_ns, two.delays_ns) for one in sources] for two in images]
    every = [difference for one in found for difference in one]
    if not every or not all(one.is_doubtful for one in every):
        return Offset()
    clock, least = min(zip(sources, found[0], strict=True), key=lambda item: abs(item[1].ns))
    seconds, way = abs(least.ns) / 1e9, "ahead of" if least.ns > 0 else "behind"
    text = f"{printable(clock.topic)}: "
    if any(_stamps_agree(images[0], one) for one in sources):
        text += "its messages and depth images with equal timestamps were recorded "
        text += f"{seconds:.1f} s apart (median); if their timestamps are from two clocks, "
        text += "messages of another time are used"
        return Offset(0, text if abs(least.ns) > MIN_STEP_NS else "")
    if all(one.offset_ns for one in every):
        text += f"its clock is {seconds:.3f} s {way} depth's, by the log times; this is corrected "
        return Offset(least.ns, f"{text}({flag} 0 disables the correction)")
    if min(one.num_delays for one in every) < _FEW_DELAYS:
        return Offset()
    text += f"by the log times, its timestamps are {seconds:.2f} s {way} depth's (within "
    text += f"{_SIGMAS * least.error_ns / 1e9:.2f} s by their jitter), which is not corrected; if "
    text += f"its clock differs, pass {flag} {least.ns / 1e9:.2f}, or 0 if its messages are only "
    return Offset(0, f"{text}published early or late")


def _without_jumps(log_ns: np.ndarray) -> np.ndarray:
    """Return log times in file order as if the recorder's clock had always been as at the end."""
    steps = np.diff(log_ns)
    odd = jumps(log_ns)
    if not odd.any():
        return log_ns
    usual = int(np.clip(np.median(steps), 0, _YEAR_NS))
    times = np.cumsum(np.append(0, np.where(odd, usual, steps)))
    return times + (log_ns[-1:] - times[-1:])


def _unevenness(stamps_ns: np.ndarray) -> float:
    """Return the sum of the deviations of all intervals between timestamps from their median."""
    intervals = np.diff(np.sort(stamps_ns))
    return float(np.abs(intervals - np.median(intervals)).sum()) if len(intervals) else 0.0


def _group_text(stamps_ns: np.ndarray, shift_ns: int) -> str:
    """Return the description of timestamps that are moved, ``(N,)`` int64 [ns]."""
    are = f"{len(stamps_ns)} {'is' if len(stamps_ns) == 1 else 'are'}"
    if not stamps_ns.any():
        return f"{are} zero"
    way = "before" if shift_ns > 0 else "after"
    if abs(shift_ns) < _YEAR_NS:
        return f"{are} {abs(shift_ns) / 1e9:.3f} s {way} the others"
    when = f"{EPOCH + int(stamps_ns[0]) // 1000 * MICROSECOND:%Y-%m-%d}"
    return f"{are} years {way} the others ({when})"


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


def _stamps_agree(depth: Clock, color: Clock) -> bool:
    """Return whether most of the first images of both topics have equal timestamps."""
    one, other = (clock.stamps_ns[:NUM_PROBES] for clock in (depth, color))
    if not len(one) or not len(other):
        return False
    apart = np.abs(one[:, None] - other[None]).min(axis=1)
    return bool((apart <= _AGREE_NS).mean() >= 0.5)
