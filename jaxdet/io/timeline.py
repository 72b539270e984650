"""Frames in time: the nearest colour images, and where each image lies."""

from typing import NamedTuple

import numpy as np

from jaxdet.errors import printable
from jaxdet.io.notes import Notes
from jaxdet.io.records import IndexedMessages
from jaxdet.io.store import Place


class FrameTable(NamedTuple):
    """The images of some frames."""

    stamps_ns: np.ndarray
    """Header stamps, ``(N,)`` int64; log times if all header stamps are zero; -1: no image."""
    size: np.ndarray
    """Bytes of the payloads, ``(N,)`` int64."""
    messages: IndexedMessages
    """Where the images are; any message if there is no image."""

    @property
    def log_ns(self) -> np.ndarray:
        """Log times, ``(N,)`` int64 [ns]."""
        return self.messages.log_ns

    def rows(self, which: slice) -> "FrameTable":
        """Return the images of some of the frames."""
        return FrameTable(self.stamps_ns[which], self.size[which], self.messages.rows(which))


class Window(NamedTuple):
    """Some frames in a row, ``n`` of them."""

    depth: FrameTable
    """Their depth images, in the order of the stamps."""
    color: FrameTable | None
    """Their nearest colour images, within the tolerance; None if the log has no colour."""
    T_world_camera: np.ndarray | None
    """``(n, 4, 4)`` float64, NaN where unknown; None when the log has no poses."""
    notes: Notes = Notes()
    other_calibration: np.ndarray | None = None
    """``(n,)`` bool, frames to which another calibration belongs than the one used; None: none."""
    chunks: tuple[Place, ...] = ()
    """What this window answers for: chunks that must be as their CRC says."""
    color_chunks: tuple[Place, ...] = ()
    """The same, where colour is decoded."""

    def part(self, first: int, last: int) -> "Window":
        """Return the frames ``first`` to ``last`` of these.

        What is to be noted goes with the first part, what is to be checked with the last one,
        when most of it has been read.
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
    """Return the number of the nearest other stamp for each stamp, ``(n,)`` int64, -1 = none.

    A tie goes to the earlier one, and of equal ones to the first.

    Args:
        stamps_ns: ``(n,)`` int64 [ns].
        others_ns: ``(m,)`` int64, sorted [ns].
        tolerance_s: Greatest difference [s].

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
) -> tuple[np.ndarray, np.ndarray, int]:
    """Return how far images are apart by stamp and by log time, and frames without colour.

    Args:
        depth: Images of ``n`` frames.
        color: Their colour images.
        color_offset_ns: How far colour's clock is ahead of depth's.
    """
    if color is None:
        return np.zeros(0, np.int64), np.zeros(0, np.int64), len(depth.stamps_ns)
    there = color.stamps_ns >= 0
    by_stamp = np.abs(color.stamps_ns - color_offset_ns - depth.stamps_ns)[there]
    by_log_time = np.abs(color.log_ns - depth.log_ns)[there]
    return by_stamp, by_log_time, int((~there).sum())


def log_time_warnings(topic: str, backward: int) -> list[str]:
    """Return a warning about messages that come after a later one."""
    text = f"{printable(topic)}: {backward} log times run backward; images are ordered by stamp"
    return [text] if backward else []
