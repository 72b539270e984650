"""What reading a range of frames shows besides the frames; adds up over the ranges of a log."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

_NONE = np.zeros(0, np.int64)


class StreamNotes(NamedTuple):
    """Odd things in the depth images."""

    backward: int = 0
    """Messages with an earlier stamp than the one before them."""
    double: int = 0
    """Stamps equal to the one before."""
    zero: int = 0
    """Stamps that are zero."""
    undecodable: int = 0
    """Messages whose stamp can't be read."""


class Notes(NamedTuple):
    """What reading a range of frames of a log shows that was opened by its index.

    Each depth image of the log is counted in exactly one range of a division of its frames. Of a
    log that was scanned all but ``bad_color`` is known at opening, and the rest is empty.
    """

    depth: StreamNotes = StreamNotes()
    apart_ns: np.ndarray = _NONE
    """``(P,)`` int64, ``|colour - depth|`` of the frames that have a colour image [ns]."""
    recorded_apart_ns: np.ndarray = _NONE
    """``(P,)`` int64, the same of their log times [ns]."""
    without_color: int = 0
    """Frames without a colour image near enough in time."""
    poses: int = 0
    """Frames with a known pose."""
    bad_color: int = 0
    """Colour images that were read and can't be decoded."""
    why_bad_color: str = ""
    """Why the first of them can't."""


def total(notes: Iterable[Notes]) -> Notes:
    """Return the notes of several ranges together."""
    items = list(notes) or [Notes()]
    return Notes(
        depth=StreamNotes(*map(sum, zip(*(item.depth for item in items), strict=True))),
        apart_ns=np.concatenate([item.apart_ns for item in items]),
        recorded_apart_ns=np.concatenate([item.recorded_apart_ns for item in items]),
        without_color=sum(item.without_color for item in items),
        poses=sum(item.poses for item in items),
        bad_color=sum(item.bad_color for item in items),
        why_bad_color=next((item.why_bad_color for item in items if item.why_bad_color), ""),
    )
