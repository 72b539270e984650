"""Decoded frames of a log: batches of arrays, or single frames."""

from collections.abc import Iterator, Sequence
from itertools import chain
from typing import NamedTuple

import numpy as np

from jaxdet.errors import FrameStatus
from jaxdet.io.timeline import Notes, total
from jaxdet.types import Frames

_PER_FRAME = ("number", "stamp_ns", "color_stamp_ns", "valid")
"""Per-frame fields of :class:`jaxdet.types.Frames`, except images and poses."""


class LogFrame(NamedTuple):
    """A decoded frame of a log."""

    number: int
    """Number of the depth image in the log, from 0."""
    depth: np.ndarray
    """Depth image ``(Hd, Wd)`` uint16 [depth units], 0 = no measurement; all 0 if it can't be
    decoded."""
    color: np.ndarray | None
    """Nearest colour image ``(H, W, 3)`` uint8, RGB; None if there is no colour image."""
    status: FrameStatus
    """``ok``, or the reason why the frame is unusable."""
    error: str
    """Explanation of the status in one line; empty if it is ok."""
    stamp_ns: int
    """Timestamp in the header of the depth image [ns]."""
    color_stamp_ns: int
    """Timestamp in the header of the colour image [ns], -1 = none."""
    T_world_camera: np.ndarray | None
    """Pose of the depth optical frame in the world, ``(4, 4)`` float64, NaN if unknown; None if the
    log has no poses."""

    def __repr__(self) -> str:
        high, wide = self.depth.shape
        sizes = f"depth {wide}x{high}"
        if self.color is not None:
            sizes += f", colour {self.color.shape[1]}x{self.color.shape[0]}"
        return f"<LogFrame {self.number}: {self.status}, {sizes}, {self.stamp_ns} ns>"


class Batch(NamedTuple):
    """A batch of decoded frames and their status."""

    frames: Frames
    """Frames, padded to the batch size. Padding has zero images, ``valid`` False, and -1 as number
    and timestamps. The depth image of a frame that can't be decoded is zero, too.
    ``color_stamp_ns`` is also -1 if the colour image can't be decoded."""
    status: tuple[FrameStatus, ...]
    """Status of each requested frame; at most the batch size."""
    errors: tuple[str, ...]
    """Explanation of each status in one line; empty if it is OK."""
    notes: Notes = Notes()
    """Observations from reading the frames, for :meth:`Log.described`."""
    decoding_s: float = 0.0
    """Time spent on decoding images [s]; the rest of the time was spent on reading."""
    camera_frame: str = ""
    """Name of the depth camera's optical frame; empty if the log does not name it."""
    world_frame: str = ""
    """Name of the world frame of the poses; empty if there are no poses."""
    log_time_ns: np.ndarray | None = None
    """Log time of the depth image of each frame, int64 [ns]; None if the frames have no log."""
    color_frame: str = ""
    """Name of the colour camera's optical frame; empty if the log does not name it."""
    nearest_color_ns: np.ndarray | None = None
    """Timestamp in the header of the colour image nearest to each frame, int64 [ns], -1 = none,
    even if colour was not read; None if the frames have no log."""

    def one_by_one(self) -> Iterator[LogFrame]:
        """Yield the frames without the padding."""
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
        """Return the batch without images and padding, to keep it when image memory is reused."""
        count, frames = len(self.status), self.frames
        poses = frames.T_world_camera
        known = {name: _rows(getattr(frames, name), count) for name in _PER_FRAME}
        small = {"color": None, "depth": frames.depth[:0].copy()}
        return self._replace(
            frames=frames._replace(**known, **small, T_world_camera=_rows(poses, count))
        )

    @classmethod
    def joined(cls, parts: Sequence["Batch"]) -> "Batch":
        """Concatenate one or more batches without images, see :meth:`without_images`."""
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
