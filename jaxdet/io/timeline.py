"""The frames of a log in time: order, pairs, and where each image lies."""

from typing import NamedTuple

import numpy as np

from jaxdet.errors import printable
from jaxdet.io.messages import Kind
from jaxdet.io.notes import Notes, StreamNotes
from jaxdet.io.pairing import pair
from jaxdet.io.store import Place
from jaxdet.io.streams import ImageStream


class FrameTable(NamedTuple):
    """The messages of one stream in the order of their stamps."""

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

    color: FrameTable
    """``n`` messages."""
    depth: FrameTable
    """Their partners, ``n`` messages, with a stamp of -1 where there is none."""
    T_world_camera: np.ndarray | None
    """``(n, 4, 4)`` float64, NaN where unknown; None when the log has no poses."""
    notes: Notes = Notes()
    other_calibration: np.ndarray | None = None
    """``(n,)`` bool, frames to which another calibration belongs than the one used; None: none."""
    chunks: tuple[Place, ...] = ()
    """What this window answers for: chunks that must be as their CRC says."""

    def part(self, first: int, last: int) -> "Window":
        """The frames ``first`` to ``last`` of these.

        What is to be noted goes with the first part, what is to be checked with the last one,
        when most of it has been read.
        """
        rows = slice(first, last)
        color, depth = (FrameTable(*(a[rows] for a in table)) for table in self[:2])
        poses, other = (
            a if a is None else a[rows] for a in (self.T_world_camera, self.other_calibration)
        )
        notes = Notes() if first else self.notes
        chunks = self.chunks if last == len(self.color.stamps_ns) else ()
        return Window(color, depth, poses, notes, other, chunks)


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
        """Colour frames."""
        return len(self.whole.color.stamps_ns)

    def about_ns(self) -> np.ndarray:
        """``(F,)`` int64, the stamps, in order [ns]."""
        return self.whole.color.stamps_ns

    def is_plain(self, number: int) -> bool:
        """False: nothing is read to look at a frame, as all messages have been."""
        return False

    def stamp_ns(self, number: int) -> int:
        """The stamp of a frame [ns]."""
        return int(self.whole.color.stamps_ns[number])

    def window(self, start: int, stop: int) -> Window:
        """The frames ``start`` to ``stop``."""
        return self.whole.part(start, stop)

    def completed(self, T_world_camera: np.ndarray | None, other: np.ndarray) -> "ScannedFrames":
        """The same frames with their poses, and which of them have another calibration."""
        whole = self.whole._replace(T_world_camera=T_world_camera, other_calibration=other)
        poses = 0 if T_world_camera is None else np.isfinite(T_world_camera[:, 0, 0]).sum()
        return self._replace(whole=whole, notes=self.notes._replace(poses=int(poses)))


def order_and_pair(color: ImageStream, depth: ImageStream, tolerance_s: float) -> ScannedFrames:
    """Orders and pairs the messages of a log that was read as a whole.

    The order is by header stamp, then log time, then place in the files. Where all stamps of a
    stream are zero, log times stand for the stamps of both, with a warning. The two images of
    an RGBD message are a pair whatever their stamps.
    """
    warnings = []
    zero = [s for s in (color, depth) if len(s) and not s.column("stamp").any()]
    if zero:
        text = "header stamps are all zero; log times are used for colour and depth"
        warnings.append(f"{printable(zero[0].topic)}: {text}")
    for stream in dict.fromkeys((color, depth)):
        backward = int((np.diff(stream.column("log_time")) < 0).sum())
        warnings += log_time_warnings(stream.topic, backward)
    stamps = "log_time" if zero else "stamp"
    own, color_notes = _table(color, stamps, stamps)
    if color is depth and color.kind is Kind.RGBD:
        partners, _ = _table(depth, stamps, "log_time" if zero else "depth_stamp")
        depth_notes, alone_ns = StreamNotes(), np.zeros(0, np.int64)
    else:
        every, depth_notes = _table(depth, stamps, stamps)
        pairing = pair(own.stamps_ns, every.stamps_ns, tolerance_s)
        partners = every.rows(pairing.depth_of_color)
        alone_ns = every.stamps_ns[pairing.unpaired_depth]
    notes = Notes(color_notes, depth_notes, *apart(own, partners), alone_ns)
    return ScannedFrames(Window(own, partners, None), notes, bool(zero), tuple(warnings))


def apart(color: FrameTable, depth: FrameTable) -> tuple[np.ndarray, np.ndarray, int]:
    """How far apart pairs are by stamp and by log time ``(P,)`` [ns], and how many have no partner.

    Args:
        color: ``n`` messages.
        depth: Their partners, with a stamp of -1 where there is none.
    """
    paired = depth.stamps_ns >= 0
    by_stamp = np.abs(color.stamps_ns - depth.stamps_ns)[paired]
    by_log_time = np.abs(color.log_ns - depth.log_ns)[paired]
    return by_stamp, by_log_time, int((~paired).sum())


def log_time_warnings(topic: str, backward: int) -> list[str]:
    """What is said of a stream of which so many messages come after a later one."""
    text = f"{printable(topic)}: {backward} log times run backward; frames are ordered by stamp"
    return [text] if backward else []


def _table(stream: ImageStream, ordered_by: str, stamps: str) -> tuple[FrameTable, StreamNotes]:
    by, place = stream.column(ordered_by), ("chunk", "offset", "size")
    in_time = np.argsort(stream.column("log_time"), kind="stable")
    order = in_time[np.argsort(by[in_time], kind="stable")]
    notes = StreamNotes(
        backward=int((np.diff(by[in_time]) < 0).sum()),
        double=int((np.diff(by[order]) == 0).sum()),
        zero=int((by == 0).sum()),
    )
    table = FrameTable(
        stream.column(stamps)[order],
        stream.column("file")[order],
        stream.column("decoder")[order],
        np.stack([stream.column(name)[order] for name in place], axis=1),
        stream.column("log_time")[order],
    )
    return table, notes
