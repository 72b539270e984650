"""Frames in time: nearest colour images, positions of the images in the files, and observations.

The observations (notes) of several ranges of frames can be added up.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from jaxdet.io.file_index import IndexedMessages, Place

_NONE = np.zeros(0, np.int64)


class StreamNotes(NamedTuple):
    """Irregularities of the depth images."""

    backward: int = 0
    """Number of messages with an earlier timestamp than the previous one."""
    double: int = 0
    """Number of timestamps equal to the previous one."""
    undecodable: int = 0
    """Number of messages whose timestamp can't be read."""


class Notes(NamedTuple):
    """Observations from a range of frames of a log.

    If the frames of a log are divided into ranges, each depth image is counted in exactly one of
    them. The description of a log that was read completely at opening already contains everything
    except ``bad_color``.
    """

    depth: StreamNotes = StreamNotes()
    apart_ns: np.ndarray = _NONE
    """``|colour - depth|`` of the frames with a colour image, ``(P,)`` int64 [ns]."""
    without_color: int = 0
    """Number of frames without a colour image within the tolerance."""
    poses: int = 0
    """Number of frames with a known pose."""
    bad_color: int = 0
    """Number of colour images that could not be decoded."""
    why_bad_color: str = ""
    """Reason why the first of the ``bad_color`` images could not be decoded."""


class FrameTable(NamedTuple):
    """Images of consecutive frames."""

    stamps_ns: np.ndarray
    """Header timestamps, or log times if all header timestamps are zero, ``(N,)`` int64 [ns]; -1:
    no image."""
    size: np.ndarray
    """Payload sizes, ``(N,)`` int64 [byte]."""
    messages: IndexedMessages
    """Positions of the images; arbitrary if there is no image."""

    @property
    def log_ns(self) -> np.ndarray:
        """Log times, ``(N,)`` int64 [ns]."""
        return self.messages.log_ns

    def rows(self, which: slice) -> "FrameTable":
        """Return a range of the images."""
        return FrameTable(self.stamps_ns[which], self.size[which], self.messages.rows(which))


class Window(NamedTuple):
    """A range of ``n`` consecutive frames."""

    depth: FrameTable
    """Depth images in order of timestamps."""
    color: FrameTable | None
    """Nearest colour images within the tolerance; None if the log has no colour."""
    T_world_camera: np.ndarray | None
    """Poses ``(n, 4, 4)`` float64, NaN if unknown; None if the log has no poses."""
    notes: Notes = Notes()
    other_calibration: np.ndarray | None = None
    """Frames whose calibration differs from that in use, ``(n,)`` bool; None: no frame."""
    chunks: tuple[Place, ...] = ()
    """Chunks whose CRC must be checked for this window."""
    color_chunks: tuple[Place, ...] = ()
    """Chunks that must also be checked if colour is decoded."""

    def part(self, first: int, last: int) -> "Window":
        """Return the frames from ``first`` to ``last``, exclusive.

        The notes are in the first part only, and the chunks to check in the last part, when most of
        their bytes have been read.
        """
        rows = slice(first, last)
        depth, color = self.depth.rows(rows), self.color and self.color.rows(rows)
        poses, other = (
            a if a is None else a[rows] for a in (self.T_world_camera, self.other_calibration)
        )
        notes = Notes() if first else self.notes
        is_last = last == len(self.depth.stamps_ns)
        chunks = (self.chunks, self.color_chunks) if is_last else ()
        return Window(depth, color, poses, notes, other, *chunks)


def nearest(stamps_ns: np.ndarray, others_ns: np.ndarray, tolerance_s: float) -> np.ndarray:
    """Return the index of the nearest other timestamp of each timestamp, ``(n,)``, -1 = none.

    In a tie the earlier timestamp is used, and of equal timestamps the first.

    Args:
        stamps_ns: Timestamps ``(n,)`` int64 [ns].
        others_ns: Other timestamps ``(m,)`` int64, sorted [ns].
        tolerance_s: Maximum difference [s].

    >>> nearest(np.array([0, 50, 90]), np.array([40, 60]), 3e-8).tolist()
    [-1, 0, 1]
    """
    if not len(others_ns):
        return np.full(len(stamps_ns), -1, np.int64)
    after = np.minimum(np.searchsorted(others_ns, stamps_ns), len(others_ns) - 1)
    before = np.maximum(after - 1, 0)
    closer = np.abs(others_ns[after] - stamps_ns) < np.abs(stamps_ns - others_ns[before])
    found = others_ns[np.where(closer, after, before)]
    near = np.abs(found - stamps_ns) <= round(tolerance_s * 1e9)
    return np.where(near, np.searchsorted(others_ns, found), -1)


def apart(
    depth: FrameTable, color: FrameTable | None, color_offset_ns: int = 0
) -> tuple[np.ndarray, int]:
    """Return timestamp gaps to colour [ns], and the number of frames without colour.

    The clock of colour is ahead of that of depth by ``color_offset_ns``.
    """
    if color is None:
        return np.zeros(0, np.int64), len(depth.stamps_ns)
    there = color.stamps_ns >= 0
    gaps = np.abs(color.stamps_ns - color_offset_ns - depth.stamps_ns)[there]
    return gaps, int((~there).sum())


def total(notes: Iterable[Notes]) -> Notes:
    """Add up the notes of several ranges."""
    items = list(notes) or [Notes()]
    return Notes(
        depth=StreamNotes(*map(sum, zip(*(item.depth for item in items), strict=True))),
        apart_ns=np.concatenate([item.apart_ns for item in items]),
        without_color=sum(item.without_color for item in items),
        poses=sum(item.poses for item in items),
        bad_color=sum(item.bad_color for item in items),
        why_bad_color=next((item.why_bad_color for item in items if item.why_bad_color), ""),
    )
