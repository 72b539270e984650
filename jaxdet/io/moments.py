"""Times of the command line, and selection of the frames between two of them.

The options use this module, so it has no heavy imports.
"""

import re
from bisect import bisect_left
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import NamedTuple

from jaxdet.errors import ConfigError, InputError

_SECONDS = re.compile(r"(\d{1,12}(?:\.\d*)?|\.\d+)s?", re.ASCII)
"""Seconds with up to 12 digits; longer numbers are not valid, in particular not milliseconds."""
_NANOSECONDS = re.compile(r"\d{16,19}", re.ASCII)
"""Timestamps [ns]; their 16 to 19 digits distinguish them from seconds."""
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
MICROSECOND = timedelta(microseconds=1)


class Moment(NamedTuple):
    """A point in time, relative to the start of a log or absolute."""

    ns: int
    is_stamp: bool
    """Whether ``ns`` is a header timestamp, not a time since the log's first depth image."""

    def stamp_ns(self, first_ns: int) -> int:
        """Return the moment as a header timestamp [ns] for a log that starts at ``first_ns``."""
        return self.ns if self.is_stamp else first_ns + self.ns


def parse_moment(text: str, flag: str) -> Moment:
    """Parse a time: ``12.5``, ``90s``, ``2024-05-01T10:00:00Z``, or a timestamp in nanoseconds.

    Args:
        text: Seconds since the log's first depth image, or a header timestamp: in ISO 8601 (UTC by
            default) or as an integer with 16 to 19 digits [ns].
        flag: Name of the flag, for errors.

    Raises:
        ConfigError: The text is not a valid time.
    """
    if _NANOSECONDS.fullmatch(str(text)):
        return Moment(int(text), True)
    if match := _SECONDS.fullmatch(str(text)):
        return Moment(round(float(match[1]) * 1e9), False)
    try:
        time = datetime.fromisoformat(str(text))
    except ValueError:
        forms = "12.5, 90s, 2024-05-01T10:00:00Z or 1714557600000000000 (ns)"
        problem = f"{flag}: invalid time {text!r}"
        raise ConfigError(problem, remedy=f"use a form like {forms}") from None
    time = time if time.tzinfo else time.replace(tzinfo=UTC)
    return Moment((time - EPOCH) // MICROSECOND * 1000, True)


def find_part(
    count: int,
    stamp_ns: Callable[[int], int],
    start: str | None,
    stop: str | None,
    every: int,
    path: str,
) -> range:
    """Return the numbers of the frames in a time range.

    Args:
        count: Number of frames, at least 1.
        stamp_ns: Function that returns the timestamp of a frame [ns]; timestamps are in order.
        start: Start time, see :func:`parse_moment`; None: the start of the log.
        stop: End time, exclusive, in the same forms; None: the end of the log.
        every: Only multiples of this number are selected.
        path: Path of the log, for errors.

    Raises:
        InputError: No frame is selected.
    """
    ends = [0, count]
    for side, text in enumerate((start, stop)):
        if text is not None:
            wanted = parse_moment(text, "").stamp_ns(stamp_ns(0))
            ends[side] = bisect_left(range(count), wanted, key=stamp_ns)
    found = range(-(-ends[0] // every) * every, ends[1], every)
    if not found:
        flags = f"--start {start}" if start is not None else ""
        flags += f" --stop {stop}" if stop is not None else ""
        flags += f" --every {every}" if every > 1 else ""
        begin_ns, last_ns = stamp_ns(0), stamp_ns(count - 1)
        times = [EPOCH + ns // 1000 * MICROSECOND for ns in (begin_ns, last_ns)]
        first, last = (f"{time:%Y-%m-%dT%H:%M:%S.%f}"[:-3] + "Z" for time in times)
        remedy = f"the log has {count} depth images from 0 to {(last_ns - begin_ns) / 1e9:.3f} s, "
        problem = f"no depth image matches {flags.lstrip()}"
        raise InputError(problem, path=path, remedy=f"{remedy}{first} to {last}")
    return found
