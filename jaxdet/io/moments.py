"""Moments as a user gives them; loads nothing, as options are made of them."""

import re
from datetime import UTC, datetime, timedelta
from typing import NamedTuple

from jaxdet.errors import ConfigError

_SECONDS = re.compile(r"(\d{1,12}(?:\.\d*)?|\.\d+)s?", re.ASCII)
"""Of more digits there is no such time; stamps in milliseconds are none either."""
_NANOSECONDS = re.compile(r"\d{16,19}", re.ASCII)
"""As seconds after the begin of a log they would be 30 million years."""
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
MICROSECOND = timedelta(microseconds=1)


class Moment(NamedTuple):
    """A point in time, of the log or absolute."""

    ns: int
    is_stamp: bool
    """A header stamp; else counted from the log's first depth image."""

    def stamp_ns(self, first_ns: int) -> int:
        """Return the moment as a header stamp [ns] of a log whose first is ``first_ns``."""
        return self.ns if self.is_stamp else first_ns + self.ns


def parse_moment(text: str, flag: str) -> Moment:
    """Parse a moment: ``12.5``, ``90s``, ``2024-05-01T10:00:00Z``, or a stamp in nanoseconds.

    Args:
        text: Seconds after the log's first depth image; or a header stamp, as ISO 8601 (without
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
    return Moment((time - EPOCH) // MICROSECOND * 1000, True)
