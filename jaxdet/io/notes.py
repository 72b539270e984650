"""What reading a range of frames tells beside the frames; adds up over the ranges of a log."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

_NONE = np.zeros(0, np.int64)


class StreamNotes(NamedTuple):
    """Odd things in one stream of images."""

    backward: int = 0
    """Messages with an earlier stamp than the one before them."""
    double: int = 0
    """Stamps equal to the one before."""
    zero: int = 0
    """Stamps that are zero."""
    undecodable: int = 0
    """Messages whose stamp can't be read."""


class Notes(NamedTuple):
    """What is known of a range of frames of a log that was opened by its index.

    Each message of the log is counted in exactly one range of a division of its frames. Of a
    log that was scanned all of it is known at opening, and the notes are empty.
    """

    color: StreamNotes = StreamNotes()
    depth: StreamNotes = StreamNotes()
    apart_ns: np.ndarray = _NONE
    """``(P,)`` int64, ``|colour - depth|`` of the pairs [ns]."""
    recorded_apart_ns: np.ndarray = _NONE
    """``(P,)`` int64, the same of their log times [ns]."""
    unpaired_color: int = 0
    unpaired_depth_ns: np.ndarray = _NONE
    """``(U,)`` int64, stamps of the depth frames without a colour frame [ns]."""
    poses: int = 0
    """Frames with a known pose."""


def total(notes: Iterable[Notes]) -> Notes:
    """The notes of several ranges together."""
    items = list(notes) or [Notes()]
    return Notes(
        color=StreamNotes(*map(sum, zip(*(item.color for item in items), strict=True))),
        depth=StreamNotes(*map(sum, zip(*(item.depth for item in items), strict=True))),
        apart_ns=np.concatenate([item.apart_ns for item in items]),
        recorded_apart_ns=np.concatenate([item.recorded_apart_ns for item in items]),
        unpaired_color=sum(item.unpaired_color for item in items),
        unpaired_depth_ns=np.concatenate([item.unpaired_depth_ns for item in items]),
        poses=sum(item.poses for item in items),
    )
