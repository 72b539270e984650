"""The frames of a log in time: order, nearest colour images, and where each image lies."""

from typing import NamedTuple

import numpy as np

from jaxdet.errors import printable
from jaxdet.io.messages import Kind
from jaxdet.io.notes import Notes, StreamNotes
from jaxdet.io.store import Place
from jaxdet.io.streams import ImageStream


class FrameTable(NamedTuple):
    """The messages of one stream, for depth in the order of their stamps."""

    stamps_ns: np.ndarray
    """``(N,)`` int64, header stamps, or log times where the header stamps are all zero."""
    file: np.ndarray
    """``(N,)`` int64, number of the log's file."""
    decoder: np.ndarray
    """``(N,)`` int64, number of the stream's decoder."""
    place: np.ndarray
    """``(N, 3)`` int64, as :class:`jaxdet.io.container.Location`."""
    log_ns: np.ndarray
    """``(N,)`` int64, log times."""

    def rows(self, numbers: np.ndarray) -> "FrameTable":
        """The messages of some numbers; of -1 one with a stamp of -1."""
        rows = FrameTable(*(column[numbers] for column in self))
        return rows._replace(stamps_ns=np.where(numbers < 0, -1, rows.stamps_ns))


class Window(NamedTuple):
    """Some frames in a row, ``n`` of them."""

    depth: FrameTable
    """``n`` messages."""
    color: FrameTable | None
    """Their nearest colour images, ``n`` messages, with a stamp of -1 where there is none near
    enough; None where the log has no colour."""
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
        """The frames ``first`` to ``last`` of these.

        What is to be noted goes with the first part, what is to be checked with the last one,
        when most of it has been read.
        """
        rows = slice(first, last)
        depth = FrameTable(*(column[rows] for column in self.depth))
        color = self.color and FrameTable(*(column[rows] for column in self.color))
        poses, other = (
            a if a is None else a[rows] for a in (self.T_world_camera, self.other_calibration)
        )
        notes = Notes() if first else self.notes
        is_last = last == len(self.depth.stamps_ns)
        chunks = (self.chunks, self.color_chunks) if is_last else ()
        return Window(depth, color, poses, notes, other, *chunks)


class ScannedFrames(NamedTuple):
    """The frames of a log that was read as a whole."""

    whole: Window
    """All of them."""
    notes: Notes
    """What is to be said of all of them."""
    by_log_time: bool
    """Whether the stamps are log times."""
    warnings: tuple[str, ...]

    @property
    def num_frames(self) -> int:
        """Depth images."""
        return len(self.whole.depth.stamps_ns)

    def about_ns(self) -> np.ndarray:
        """``(F,)`` int64, the stamps, in order [ns]."""
        return self.whole.depth.stamps_ns

    def is_plain(self, number: int) -> bool:
        """False: nothing is read to look at a frame, as all messages have been."""
        return False

    def stamp_ns(self, number: int) -> int:
        """The stamp of a frame [ns]."""
        return int(self.whole.depth.stamps_ns[number])

    def log_ns(self, number: int) -> int:
        """The log time of a frame [ns]."""
        return int(self.whole.depth.log_ns[number])

    def window(self, start: int, stop: int) -> Window:
        """The frames ``start`` to ``stop``."""
        return self.whole.part(start, stop)

    def completed(self, T_world_camera: np.ndarray | None, other: np.ndarray) -> "ScannedFrames":
        """The same frames with their poses, and which of them have another calibration."""
        whole = self.whole._replace(T_world_camera=T_world_camera, other_calibration=other)
        poses = 0 if T_world_camera is None else np.isfinite(T_world_camera[:, 0, 0]).sum()
        return self._replace(whole=whole, notes=self.notes._replace(poses=int(poses)))


def order_frames(
    depth: ImageStream, color: ImageStream | None, tolerance_s: float, color_offset_ns: int = 0
) -> ScannedFrames:
    """Order the depth images of a log that was read as a whole, each with its nearest colour image.

    The order is by header stamp, then log time, then place in the files. Where all stamps of a
    stream are zero, log times stand for its stamps, and decide which colour image is nearest. The
    two images of an RGBD message belong together whatever their stamps. Colour's clock is
    ``color_offset_ns`` ahead of depth's.
    """
    streams = dict.fromkeys(stream for stream in (depth, color) if stream is not None)
    warnings: list[str] = []
    zero = [stream for stream in streams if len(stream) and not stream.column("stamp").any()]
    for stream in streams:
        if stream in zero:
            text = "header stamps are all zero; log times are used"
            warnings.append(f"{printable(stream.topic)}: {text}")
        backward = int((np.diff(stream.column("log_time")) < 0).sum())
        warnings += log_time_warnings(stream.topic, backward)
    own, stream_notes = _table(depth, "log_time" if depth in zero else "stamp")
    partners = None
    if color is depth and depth.kind is Kind.RGBD:
        stamps = own.stamps_ns if zero else _table(depth, "stamp", "color_stamp")[0].stamps_ns
        partners = own._replace(stamps_ns=stamps)
    elif color is not None:
        every, _ = _table(color, "log_time" if zero else "stamp")
        about = own.log_ns if zero else own.stamps_ns + color_offset_ns
        partners = every.rows(nearest(about, every.stamps_ns, tolerance_s))
    notes = Notes(stream_notes, *apart(own, partners, color_offset_ns))
    whole = Window(own, partners, None)
    return ScannedFrames(whole, notes, depth in zero, tuple(warnings))


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
    """How far apart images are by stamp and by log time ``(P,)`` [ns]; frames without colour.

    Args:
        depth: ``n`` messages.
        color: Their colour images, with a stamp of -1 where there is none.
        color_offset_ns: How far colour's clock is ahead of depth's.
    """
    if color is None:
        return np.zeros(0, np.int64), np.zeros(0, np.int64), len(depth.stamps_ns)
    there = color.stamps_ns >= 0
    by_stamp = np.abs(color.stamps_ns - color_offset_ns - depth.stamps_ns)[there]
    by_log_time = np.abs(color.log_ns - depth.log_ns)[there]
    return by_stamp, by_log_time, int((~there).sum())


def log_time_warnings(topic: str, backward: int) -> list[str]:
    """A line on a stream with messages that come after a later one."""
    text = f"{printable(topic)}: {backward} log times run backward; images are ordered by stamp"
    return [text] if backward else []


def _table(stream: ImageStream, by: str, stamps: str = "") -> tuple[FrameTable, StreamNotes]:
    times, place = stream.column(by), ("chunk", "offset", "size")
    in_time = np.argsort(stream.column("log_time"), kind="stable")
    order = in_time[np.argsort(times[in_time], kind="stable")]
    notes = StreamNotes(
        backward=int((np.diff(times[in_time]) < 0).sum()),
        double=int((np.diff(times[order]) == 0).sum()),
        zero=int((times == 0).sum()),
    )
    table = FrameTable(
        stream.column(stamps or by)[order],
        stream.column("file")[order],
        stream.column("decoder")[order],
        np.stack([stream.column(name)[order] for name in place], axis=1),
        stream.column("log_time")[order],
    )
    return table, notes
