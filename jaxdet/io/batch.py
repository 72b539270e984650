"""The frames of a log, decoded: some of them as arrays, or one by one."""

from collections.abc import Iterator, Sequence
from itertools import chain
from typing import NamedTuple

import numpy as np

from jaxdet.errors import FrameStatus
from jaxdet.io.notes import Notes, total
from jaxdet.types import Frames

_PER_FRAME = ("number", "stamp_ns", "color_stamp_ns", "valid")
"""Of :class:`jaxdet.types.Frames`, what is small, without the poses."""


class LogFrame(NamedTuple):
    """A frame of a log, decoded."""

    number: int
    """Number of the depth image in the log, from 0."""
    depth: np.ndarray
    """``(Hd, Wd)`` uint16 [depth units], 0 = no measurement; zeros where it can't be decoded."""
    color: np.ndarray | None
    """``(H, W, 3)`` uint8, RGB, the nearest colour image; None if none was read."""
    status: FrameStatus
    """``ok``, or why the frame can't be used."""
    error: str
    """One line on that; empty if it is ok."""
    stamp_ns: int
    """Depth header stamp."""
    color_stamp_ns: int
    """Colour header stamp, -1 = none."""
    T_world_camera: np.ndarray | None
    """``(4, 4)`` float64, depth optical frame to world, NaN where unknown; None: no poses."""

    def __repr__(self) -> str:
        high, wide = self.depth.shape
        sizes = f"depth {wide}x{high}"
        if self.color is not None:
            sizes += f", colour {self.color.shape[1]}x{self.color.shape[0]}"
        return f"<LogFrame {self.number}: {self.status}, {sizes}, {self.stamp_ns} ns>"


class Batch(NamedTuple):
    """Decoded frames, and what became of each."""

    frames: Frames
    """Padded to the batch size. Padding has zero images, ``valid`` False, ``number`` and stamps -1;
    so has the depth image of a frame that can't be decoded. ``color_stamp_ns`` is -1 also where
    the colour image was read and can't be decoded."""
    status: tuple[FrameStatus, ...]
    """One for each requested frame; at most the batch size."""
    errors: tuple[str, ...]
    """One line for each of them, empty if the status is OK."""
    notes: Notes = Notes()
    """What else was seen, for :meth:`Log.described`."""
    decoding_s: float = 0.0
    """How long its images were decoded [s]; the rest of the time they were read."""
    camera_frame: str = ""
    """Name of the depth camera's optical frame; empty if the log has none."""
    world_frame: str = ""
    """Name of the frame that poses are in; empty if there are none."""
    log_time_ns: np.ndarray | None = None
    """When the log received the depth image of each of them, int64 [ns]; None: of no log."""
    color_frame: str = ""
    """Name of the colour camera's optical frame; empty if the log has none."""
    nearest_color_ns: np.ndarray | None = None
    """Header stamp of the colour image that belongs to each of them, int64 [ns], -1 = none; the
    same whether colour was read or not. None: of no log."""

    def one_by_one(self) -> Iterator[LogFrame]:
        """Return the frames without the padding."""
        frames, poses = self.frames, self.frames.T_world_camera
        color, stamps = frames.color, frames.color_stamp_ns
        for row, (status, error) in enumerate(zip(self.status, self.errors, strict=True)):
            stamp = -1 if stamps is None else int(stamps[row])
            yield LogFrame(
                int(frames.number[row]),
                frames.depth[row],
                None if color is None or stamp < 0 else color[row],
                status,
                error,
                int(frames.stamp_ns[row]),
                stamp,
                None if poses is None else poses[row],
            )

    def without_images(self) -> "Batch":
        """Return the batch without images and padding; the rest stays when memory is reused."""
        count, frames = len(self.status), self.frames
        poses = frames.T_world_camera
        known = {name: _rows(getattr(frames, name), count) for name in _PER_FRAME}
        small = {"color": None, "depth": frames.depth[:0].copy()}
        return self._replace(
            frames=frames._replace(**known, **small, T_world_camera=_rows(poses, count))
        )

    @classmethod
    def joined(cls, parts: Sequence["Batch"]) -> "Batch":
        """Batches of a log as one; they are :meth:`without_images`, and at least one."""
        frames = [part.frames for part in parts]
        names = (*_PER_FRAME, "T_world_camera")
        known = {name: _joined([getattr(item, name) for item in frames]) for name in names}
        return parts[0]._replace(
            frames=frames[0]._replace(**known),
            status=tuple(chain.from_iterable(part.status for part in parts)),
            errors=tuple(chain.from_iterable(part.errors for part in parts)),
            notes=total(part.notes for part in parts),
            decoding_s=sum(part.decoding_s for part in parts),
            log_time_ns=_joined([part.log_time_ns for part in parts]),
            nearest_color_ns=_joined([part.nearest_color_ns for part in parts]),
        )


def _rows(values: np.ndarray | None, count: int) -> np.ndarray | None:
    return None if values is None else values[:count]


def _joined(columns: Sequence[np.ndarray | None]) -> np.ndarray | None:
    known = [column for column in columns if column is not None]
    return np.concatenate(known) if known else None
