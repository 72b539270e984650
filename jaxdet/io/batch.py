"""The frames of a log, decoded: some of them as arrays, or one by one."""

from collections.abc import Iterator, Sequence
from itertools import chain
from typing import NamedTuple

import numpy as np

from jaxdet.errors import FrameStatus
from jaxdet.io.notes import Notes, total
from jaxdet.types import Frames

_PER_FRAME = ("number", "stamp_ns", "depth_stamp_ns", "valid")
"""Of :class:`jaxdet.types.Frames`, what is known of each frame beside images and pose."""


class LogFrame(NamedTuple):
    """A frame of a log, decoded."""

    number: int
    """Number of the colour frame in the log, from 0."""
    color: np.ndarray
    """``(H, W, 3)`` uint8, RGB; zeros where the frame can't be used."""
    depth: np.ndarray
    """``(Hd, Wd)`` uint16 [depth units], 0 = no measurement; zeros likewise."""
    status: FrameStatus
    """``ok``, or why it can't be used."""
    error: str
    """One line on that; empty where it is ok."""
    stamp_ns: int
    """Colour header stamp."""
    depth_stamp_ns: int
    """Depth header stamp, -1 = unpaired."""
    T_world_camera: np.ndarray | None
    """``(4, 4)`` float64, colour optical frame to world, NaN where unknown; None: no poses."""

    def __repr__(self) -> str:
        (height, width), (high, wide) = self.color.shape[:2], self.depth.shape
        sizes = f"colour {width}x{height}, depth {wide}x{high}"
        return f"<LogFrame {self.number}: {self.status}, {sizes}, {self.stamp_ns} ns>"


class Batch(NamedTuple):
    """Decoded frames, and what became of each."""

    frames: Frames
    """Padded to the batch size. Padding, unpaired and failed frames have zero images and
    ``valid`` False; padding has ``number`` and stamps -1."""
    status: tuple[FrameStatus, ...]
    """One for each colour frame asked for; at most the batch size."""
    errors: tuple[str, ...]
    """One line for each of them, empty where the status is OK."""
    notes: Notes = Notes()
    """What else was seen, for :meth:`Log.described`."""
    decoding_s: float = 0.0
    """How long its images were decoded [s]; the rest of the time they were read."""
    camera_frame: str = ""
    """Name of the colour camera's optical frame; empty where the log has none."""
    world_frame: str = ""
    """Name of the frame that poses are in; empty where there are none."""
    log_time_ns: np.ndarray | None = None
    """When the log received the colour image of each of them, int64 [ns]; None: of no log."""

    def one_by_one(self) -> Iterator[LogFrame]:
        """The frames without the padding."""
        frames, poses = self.frames, self.frames.T_world_camera
        for row, (status, error) in enumerate(zip(self.status, self.errors, strict=True)):
            yield LogFrame(
                int(frames.number[row]),
                frames.color[row],
                frames.depth[row],
                status,
                error,
                int(frames.stamp_ns[row]),
                int(frames.depth_stamp_ns[row]),
                None if poses is None else poses[row],
            )

    def without_images(self) -> "Batch":
        """The batch without images and padding: what is small, and stays when memory is reused."""
        count, frames = len(self.status), self.frames
        poses = frames.T_world_camera
        known = {name: getattr(frames, name)[:count] for name in _PER_FRAME}
        small = {"color": frames.color[:0].copy(), "depth": frames.depth[:0].copy()}
        poses = poses if poses is None else poses[:count]
        return self._replace(frames=frames._replace(**known, **small, T_world_camera=poses))

    @classmethod
    def joined(cls, parts: Sequence["Batch"]) -> "Batch":
        """Batches of a log as one; they are :meth:`without_images`, and at least one."""
        frames = [part.frames for part in parts]
        known = {name: np.concatenate([getattr(a, name) for a in frames]) for name in _PER_FRAME}
        poses = [a.T_world_camera for a in frames if a.T_world_camera is not None]
        times = [part.log_time_ns for part in parts if part.log_time_ns is not None]
        return parts[0]._replace(
            frames=frames[0]._replace(
                **known, T_world_camera=np.concatenate(poses) if poses else None
            ),
            status=tuple(chain.from_iterable(part.status for part in parts)),
            errors=tuple(chain.from_iterable(part.errors for part in parts)),
            notes=total(part.notes for part in parts),
            decoding_s=sum(part.decoding_s for part in parts),
            log_time_ns=np.concatenate(times) if times else None,
        )
