"""Progress of a run: number of frames that are done, and frames per second."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import NamedTuple

from jaxdet.results.summary import LogSummary


class Progress(NamedTuple):
    """Progress of a run, passed to the progress callback before the first unit and after each."""

    log: str
    """Name of the log, followed by that of the camera if the log has several."""
    log_number: int
    num_logs: int
    done: int
    """Number of frames of this log that are done."""
    total: int
    """Number of frames of this log."""
    bad: int
    """Number of frames of this log with another status than ok."""
    frames_per_s: float | None
    bottleneck: str = ""
    """Slowest step, see :attr:`jaxdet.results.summary.LogSummary.bottleneck`."""
    rates: Mapping[str, float] = MappingProxyType({})
    """Frames per second of each step if it were the only one."""
    doing: str = ""
    """Description of the work before the first unit is done."""
    logs_done: int = 0
    """Number of logs that are done."""
    logs_failed: int = 0
    """Number of logs that are done because they failed."""


ProgressCallback = Callable[[Progress], None]


Report = Callable[[LogSummary, str, int, str], None]
"""Function for the progress of a log: summary, label, number of frames, current work."""


@dataclass
class Clock:
    """Clock of a log: it measures the time of the first units and the frame rate after them."""

    about: LogSummary
    workers: int
    start: float = field(default_factory=time.perf_counter)
    units: int = 0
    first: int = 0
    """Number of frames in the first unit of each worker."""

    @property
    def seconds(self) -> float:
        """Time since the start [s]."""
        return time.perf_counter() - self.start

    def tick(self) -> None:
        """Update the times after a unit, whose frames are already counted in ``about``."""
        about, seconds = self.about, self.seconds
        rest, self.units = about.frames - self.first, self.units + 1
        if self.units <= self.workers:
            self.first, about.first_batch_s = about.frames, seconds
        elif rest >= 2 * self.first and seconds > about.first_batch_s:
            about.frames_per_s = round(rest / (seconds - about.first_batch_s), 2)
