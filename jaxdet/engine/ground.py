"""The planes of a log and where they come from, and the sample of its frames that is looked at."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from jaxdet.config import Config
from jaxdet.floor.plane import join_planes, repeat_plane, unknown_plane
from jaxdet.types import GroundPlane

if TYPE_CHECKING:
    from jaxdet.io import Log


@dataclass(frozen=True)
class GroundRecord:
    """A plane and where it comes from, for the summary."""

    source: str
    """``flags``, ``tf``, ``estimate`` or ``none``."""
    window_start_ns: int | None = None
    """First stamp of the time window; None: the whole log."""
    height_m: float | None = None
    pitch_rad: float | None = None
    roll_rad: float | None = None
    ramp_start_m: float | None = None
    """Where a ramp ahead begins [m]; None: there is none."""
    ramp_slope: float | None = None
    height_spread_m: float | None = None
    """How much the height differs between the sampled frames (estimate) [m]."""
    frames_used: int | None = None
    message: str = ""


@dataclass(frozen=True)
class Planes:
    """The planes of a log."""

    records: tuple[GroundRecord, ...]
    windows: dict[int, GroundPlane]
    """Window number to plane (``B = 1``); one window, 0, for the whole log."""
    window_ns: int = 0
    """Length of the windows; 0: the whole log."""
    warnings: tuple[str, ...] = ()
    otherwise: GroundPlane = field(default_factory=lambda: unknown_plane(1), repr=False)
    """Of frames in no window, ``B = 1``."""
    otherwise_source: str = "none"
    """Where that comes from."""

    def of(self, stamp_ns: np.ndarray) -> GroundPlane:
        """The plane of each frame with these stamps ``(B,)`` int64."""
        if not self.window_ns:
            return repeat_plane(self.windows[0], stamp_ns.size)
        keys = (stamp_ns // self.window_ns).tolist()
        each = [self.windows.get(key, self.otherwise) for key in keys]
        return join_planes(each)

    def sources(self, stamp_ns: np.ndarray) -> list[str]:
        """Where the plane of each frame with these stamps comes from.

        ``flags``, ``tf``, ``log`` (an estimate from frames of the whole log), ``window`` (from
        those of the frame's time window) or ``none``.
        """
        if not self.window_ns:
            return [_WORDS.get(self.records[0].source, "log")] * stamp_ns.size
        known = {
            record.window_start_ns // self.window_ns: _WORDS.get(record.source, "window")
            for record in self.records
            if record.window_start_ns is not None
        }
        keys = (stamp_ns // self.window_ns).tolist()
        return [known.get(key, self.otherwise_source) for key in keys]


_WORDS = {word: word for word in ("flags", "tf", "none")}


def record_of(source: str, plane: GroundPlane, message: str = "") -> GroundRecord:
    """The record of a plane, ``B = 1``."""
    height, pitch, roll, _, start, slope = (float(part[0]) for part in plane)
    ramp = (start, slope) if np.isfinite(start) else (None, None)
    return GroundRecord(source, None, height, pitch, roll, *ramp, message=message)


def in_windows(
    log: "Log", config: Config, look: Callable[[np.ndarray], tuple[GroundRecord, GroundPlane]]
) -> tuple[list[GroundRecord], dict[int, GroundPlane]]:
    """Looks at a sample of the paired frames of each time window, or of the whole log."""
    paired = np.flatnonzero(np.asarray(log.depth_stamp_ns) >= 0)
    window_ns = round(config.ground.window_s * 1e9)
    numbers = np.asarray(log.stamps_ns)[paired] // window_ns if window_ns else 0 * paired
    records, windows = [], {}
    for number in np.unique(numbers).tolist():
        sample = evenly(paired[numbers == number], config.ground.sample_frames)
        record, windows[number] = look(sample)
        start = number * window_ns if window_ns else None
        records.append(replace(record, window_start_ns=start))
    return records, windows


def evenly(values: np.ndarray, count: int) -> np.ndarray:
    """At most ``count`` of ``values``, evenly spaced, the first and the last among them."""
    if values.size <= count:
        return values
    return values[np.linspace(0, values.size - 1, count).round().astype(np.int64)]
