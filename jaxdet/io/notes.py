"""Observations made while reading frames; those of several ranges can be added up."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

_NONE = np.zeros(0, np.int64)


class StreamNotes(NamedTuple):
    """Irregularities of the depth images."""

    backward: int = 0
    """Number of messages with an earlier timestamp than the previous one."""
    double: int = 0
    """Number of timestamps equal to the previous one."""
    zero: int = 0
    """Number of timestamps of zero."""
    undecodable: int = 0
    """Number of messages whose timestamp can't be read."""


class Notes(NamedTuple):
    """Observations from a range of frames of a log that was opened by its index.

    If the frames of a log are divided into ranges, each depth image is counted in exactly one of
    them. For a log that was scanned, everything except ``bad_color`` is known at opening, and the
    other fields are empty.
    """

    depth: StreamNotes = StreamNotes()
    apart_ns: np.ndarray = _NONE
    """``|colour - depth|`` of the frames with a colour image, ``(P,)`` int64 [ns]."""
    recorded_apart_ns: np.ndarray = _NONE
    """Absolute difference between the log times of the colour and the depth image of each of these
    frames, ``(P,)`` int64 [ns]."""
    without_color: int = 0
    """Number of frames without a colour image within the tolerance."""
    poses: int = 0
    """Number of frames with a known pose."""
    bad_color: int = 0
    """Number of colour images that could not be decoded."""
    why_bad_color: str = ""
    """Reason why the first of the ``bad_color`` images could not be decoded."""


def total(notes: Iterable[Notes]) -> Notes:
    """Add up the notes of several ranges."""
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
