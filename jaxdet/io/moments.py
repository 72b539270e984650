"""Time arguments of the command line, without heavy imports, since the options use this module."""

import re
from datetime import UTC, datetime, timedelta
from typing import NamedTuple

from jaxdet.errors import ConfigError

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
