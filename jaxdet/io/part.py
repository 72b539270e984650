"""A part of a log: the frames between two moments."""

from collections.abc import Iterable

import numpy as np

from jaxdet.errors import InputError
from jaxdet.io.moments import EPOCH, MICROSECOND, parse_moment


def find_part(
    stamps_ns: np.ndarray, start: str | None, stop: str | None, every: int, path: str
) -> range:
    """The numbers of the frames from one moment to another.

    Seconds count from the first stamp that is not zero.

    Args:
        stamps_ns: ``(F,)`` int64, of the log's frames, in order [ns].
        start: See :func:`jaxdet.io.moments.parse_moment`; None: the log's begin.
        stop: Likewise, the first moment that is not in the part; None: after the last frame.
        every: Only multiples of this number.
        path: The log's, for errors.

    Raises:
        InputError: There is no frame.
    """
    count = len(stamps_ns)
    if not count:
        return range(0)
    begin_ns = first_told(stamps_ns)
    ends = [0, count]
    for side, text in enumerate((start, stop)):
        if text is not None:
            wanted = parse_moment(text, "").stamp_ns(begin_ns)
            ends[side] = int(np.searchsorted(stamps_ns, wanted))
    found = range(-(-ends[0] // every) * every, ends[1], every)
    if not found:
        asked = f"--start {start}" * (start is not None), f"--stop {stop}" * (stop is not None)
        each = f"--every {every}" if every > 1 else ""
        asked = " ".join(part for part in (*asked, each) if part)
        remedy = f"its {count} colour frames are {_span(begin_ns, int(stamps_ns[-1]))}"
        raise InputError(f"no colour frame is in {asked}", path=path, remedy=remedy)
    return found


def first_told(stamps_ns: Iterable[int]) -> int:
    """The first stamp that is not zero [ns]; 0 where all are."""
    return next((int(ns) for ns in stamps_ns if ns), 0)


def _span(first_ns: int, last_ns: int) -> str:
    times = [EPOCH + ns // 1000 * MICROSECOND for ns in (first_ns, last_ns)]
    texts = [f"{time:%Y-%m-%dT%H:%M:%S.%f}"[:-3] + "Z" for time in times]
    return f"from 0 to {(last_ns - first_ns) / 1e9:.3f} s, {texts[0]} to {texts[1]}"
