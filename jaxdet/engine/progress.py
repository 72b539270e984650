"""Where a run stands, for people: what is done of a log, and how fast it goes."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import NamedTuple

from jaxdet.results.summary import LogSummary


class Progress(NamedTuple):
    """Where a run stands, given to the progress callback after each unit, and before the first."""

    log: str
    """The log's name, and the camera's where the log has several."""
    log_number: int
    num_logs: int
    done: int
    """Frames of this log."""
    total: int
    """Frames of this log."""
    bad: int
    """Frames of this log that are not ok."""
    frames_per_s: float | None
    bottleneck: str = ""
    """The step that others wait for, see :attr:`jaxdet.results.summary.LogSummary.bottleneck`."""
    rates: Mapping[str, float] = MappingProxyType({})
    """Frames a second of each step alone."""
    doing: str = ""
    """What goes on before the first unit is through."""
    logs_done: int = 0
    """Logs whose results are there."""
    logs_failed: int = 0
    """Logs that failed, of these."""


ProgressCallback = Callable[[Progress], None]


Report = Callable[[LogSummary, str, int, str], None]
"""Gets where a log stands: summary, label, frames, and what goes on."""


@dataclass
class Clock:
    """Times of a log: the first units, and the rate after them."""

    about: LogSummary
    workers: int
    start: float = field(default_factory=time.perf_counter)
    units: int = 0
    first: int = 0
    """Frames of the first unit of each worker."""

    @property
    def seconds(self) -> float:
        """Since the start."""
        return time.perf_counter() - self.start

    def tick(self) -> None:
        """A unit has been counted."""
        about, seconds = self.about, self.seconds
        rest, self.units = about.frames - self.first, self.units + 1
        if self.units <= self.workers:
            self.first, about.first_batch_s = about.frames, seconds
        elif rest >= 2 * self.first and seconds > about.first_batch_s:
            about.frames_per_s = round(rest / (seconds - about.first_batch_s), 2)
