"""Selection of the frames between two times, by bisection."""

from bisect import bisect_left
from collections.abc import Callable

from jaxdet.errors import InputError
from jaxdet.io.moments import EPOCH, MICROSECOND, parse_moment


def find_part(
    begin_ns: int,
    count: int,
    stamp_ns: Callable[[int], int],
    start: str | None,
    stop: str | None,
    every: int,
    path: str,
) -> range:
    """Return the numbers of the frames in a time range.

    Args:
        begin_ns: Start of the log's time axis [ns].
        count: Number of frames.
        stamp_ns: Function that returns the timestamp of a frame [ns]; timestamps are in order.
        start: Start time, see :func:`jaxdet.io.moments.parse_moment`; None: the start of the log.
        stop: End time, exclusive, in the same forms; None: the end of the log.
        every: Only multiples of this number are selected.
        path: Path of the log, for errors.

    Raises:
        InputError: No frame is selected.
    """
    if not count:
        return range(0)
    ends = [0, count]
    for side, text in enumerate((start, stop)):
        if text is not None:
            wanted = parse_moment(text, "").stamp_ns(begin_ns)
            ends[side] = bisect_left(range(count), wanted, key=stamp_ns)
    found = range(-(-ends[0] // every) * every, ends[1], every)
    if not found:
        asked = f"--start {start}" * (start is not None), f"--stop {stop}" * (stop is not None)
        each = f"--every {every}" if every > 1 else ""
        asked = " ".join(part for part in (*asked, each) if part)
        remedy = f"the log has {count} depth images {_span(begin_ns, stamp_ns(count - 1))}"
        raise InputError(f"no depth image matches {asked}", path=path, remedy=remedy)
    return found


def _span(first_ns: int, last_ns: int) -> str:
    times = [EPOCH + ns // 1000 * MICROSECOND for ns in (first_ns, last_ns)]
    texts = [f"{time:%Y-%m-%dT%H:%M:%S.%f}"[:-3] + "Z" for time in times]
    return f"from 0 to {(last_ns - first_ns) / 1e9:.3f} s, {texts[0]} to {texts[1]}"
