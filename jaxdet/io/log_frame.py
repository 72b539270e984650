"""One frame of a log, for those who look at frames one by one."""

from typing import NamedTuple

import numpy as np

from jaxdet.errors import FrameStatus


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
