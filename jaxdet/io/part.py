"""A part of a log: moments as the user gives them, and the frames between two of them."""

import re
from bisect import bisect_left
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import NamedTuple

import numpy as np

from jaxdet.errors import ConfigError, InputError

_SECONDS = re.compile(r"(\d+\.?\d*|\.\d+)(s?)", re.ASCII)
_NANOSECONDS = re.compile(r"\d{16,19}", re.ASCII)
"""As seconds after the begin of a log they would be 30 million years."""
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_MICROSECOND = timedelta(microseconds=1)


class Moment(NamedTuple):
    """A point in time, of the log or absolute."""

    ns: int
    is_stamp: bool
    """A header stamp; else counted from the first colour frame of the log."""

    def stamp_ns(self, first_ns: int) -> int:
        """As a header stamp [ns], where the log's first is ``first_ns``."""
        return self.ns if self.is_stamp else first_ns + self.ns


def parse_moment(text: str, flag: str) -> Moment:
    """Reads a moment: ``12.5``, ``90s``, ``2024-05-01T10:00:00Z``, or a stamp in nanoseconds.

    Args:
        text: Seconds after the log's first colour frame; or a header stamp, as ISO 8601 (without
            a zone UTC) or as an integer of 16 to 19 digits [ns].
        flag: Where it was given, for errors.

    Raises:
        ConfigError: It is none of these.
    """
    if _NANOSECONDS.fullmatch(str(text)):
        return Moment(int(text), True)
    if match := _SECONDS.fullmatch(str(text)):
        return Moment(round(float(match[1]) * 1e9), False)
    try:
        time = datetime.fromisoformat(str(text))
    except ValueError:
        forms = "12.5, 90s, 2024-05-01T10:00:00Z or 1714557600000000000 (ns)"
        raise ConfigError(f"{flag} {text!r} is no time", remedy=f"give it as {forms}") from None
    time = time if time.tzinfo else time.replace(tzinfo=UTC)
    return Moment((time - _EPOCH) // _MICROSECOND * 1000, True)


def find_part(
    about_ns: np.ndarray,
    stamp_ns: Callable[[int], int],
    start: str | None,
    stop: str | None,
    every: int,
    path: str,
) -> range:
    """The numbers of the frames from one moment to another.

    Args:
        about_ns: ``(F,)`` int64, a time of each of the log's frames, in order [ns], which differs
            by about the same from all stamps: it says where to look first.
        stamp_ns: The stamp of a frame by its number [ns]; they are in order.
        start: See :func:`parse_moment`; None: the log's begin.
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
            wanted = parse_moment(text, "").stamp_ns(stamp_ns(0))
            ends[side] = _first_from(wanted, about_ns, stamp_ns)
    found = range(-(-ends[0] // every) * every, ends[1], every)
    if not found:
        asked = f"--start {start}" * (start is not None), f"--stop {stop}" * (stop is not None)
        each = f"--every {every}" if every > 1 else ""
        asked = " ".join(part for part in (*asked, each) if part)
        remedy = f"its {count} colour frames are {_span(stamp_ns(0), stamp_ns(count - 1))}"
        raise InputError(f"no colour frame is in {asked}", path=path, remedy=remedy)
    return found


def _first_from(wanted: int, about_ns: np.ndarray, stamp_ns: Callable[[int], int]) -> int:
    """The first frame whose stamp is ``wanted`` or later; looks at few, and those near by."""
    count = len(about_ns)
    guess = int(np.searchsorted(about_ns, wanted - stamp_ns(0) + int(about_ns[0])))
    low = high = min(guess, count - 1)
    step = 1
    while low > 0 and stamp_ns(low) >= wanted:
        low, step = max(0, low - step), 2 * step
    step = 1
    while high < count and stamp_ns(high) < wanted:
        high, step = min(count, high + step), 2 * step
    return bisect_left(range(count), wanted, low, high, key=stamp_ns)


def _span(first_ns: int, last_ns: int) -> str:
    times = [_EPOCH + ns // 1000 * _MICROSECOND for ns in (first_ns, last_ns)]
    texts = [f"{time:%Y-%m-%dT%H:%M:%S.%f}"[:-3] + "Z" for time in times]
    return f"from 0 to {(last_ns - first_ns) / 1e9:.3f} s, {texts[0]} to {texts[1]}"
