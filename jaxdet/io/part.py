"""A part of a log: the frames between two moments, found with few looks at the log."""

from bisect import bisect_left
from collections.abc import Callable

import numpy as np

from jaxdet.errors import InputError
from jaxdet.io.moments import EPOCH, MICROSECOND, parse_moment


def find_part(
    begin_ns: int,
    about_ns: np.ndarray,
    stamp_ns: Callable[[int], int],
    start: str | None,
    stop: str | None,
    every: int,
    path: str,
) -> range:
    """Return the numbers of the frames from one moment to another.

    Args:
        begin_ns: From when seconds count [ns], see :func:`jaxdet.io.clocks.first_stamp`.
        about_ns: ``(F,)`` int64, a time of each of the log's frames, in order [ns], which differs
            by about the same from all stamps: it says where to look first.
        stamp_ns: The stamp of a frame by its number [ns]; they are in order.
        start: See :func:`jaxdet.io.moments.parse_moment`; None: the log's begin.
        stop: Likewise, the first moment that is not in the part; None: after the last frame.
        every: Only multiples of this number.
        path: The log's, for errors.

    Raises:
        InputError: There is no frame.
    """
    count = len(about_ns)
    if not count:
        return range(0)
    ends = [0, count]
    for side, text in enumerate((start, stop)):
        if text is not None:
            wanted = parse_moment(text, "").stamp_ns(begin_ns)
            ends[side] = _first_from(wanted, begin_ns, about_ns, stamp_ns)
    found = range(-(-ends[0] // every) * every, ends[1], every)
    if not found:
        asked = f"--start {start}" * (start is not None), f"--stop {stop}" * (stop is not None)
        each = f"--every {every}" if every > 1 else ""
        asked = " ".join(part for part in (*asked, each) if part)
        remedy = f"its {count} depth images are {_span(begin_ns, stamp_ns(count - 1))}"
        raise InputError(f"no depth image is in {asked}", path=path, remedy=remedy)
    return found


def _first_from(
    wanted: int, begin_ns: int, about_ns: np.ndarray, stamp_ns: Callable[[int], int]
) -> int:
    """Return the first frame with a stamp of ``wanted`` or later; reads few, and near ones."""
    count = len(about_ns)
    guess = int(np.searchsorted(about_ns, wanted - begin_ns + int(about_ns[0])))
    low = high = min(guess, count - 1)
    step = 1
    while low > 0 and stamp_ns(low) >= wanted:
        low, step = max(0, low - step), 2 * step
    step = 1
    while high < count and stamp_ns(high) < wanted:
        high, step = min(count, high + step), 2 * step
    return bisect_left(range(count), wanted, low, high, key=stamp_ns)


def _span(first_ns: int, last_ns: int) -> str:
    times = [EPOCH + ns // 1000 * MICROSECOND for ns in (first_ns, last_ns)]
    texts = [f"{time:%Y-%m-%dT%H:%M:%S.%f}"[:-3] + "Z" for time in times]
    return f"from 0 to {(last_ns - first_ns) / 1e9:.3f} s, {texts[0]} to {texts[1]}"
