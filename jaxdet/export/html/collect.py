"""One pass over the tables of results: timelines, histograms, and the frames worth a look."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from jaxdet.errors import FrameStatus

if TYPE_CHECKING:
    from jaxdet.results.reading import Results

MOST_BINS = 512
"""Of a timeline; longer logs have several frames in a bin, of which the nearest obstacle is
kept."""
LOST_KEPT = 12
"""First frames without a result, and with an overflow, that are kept of each log."""
HISTOGRAM_BINS = 41
"""The last one is open."""
NEAR_M = (1.0, 0.5)
"""What is nearer is counted by itself: these need be no edges of the histograms' bins [m]."""
APART = 32
"""Frames worth a look are this part of their log apart."""
CHUNK_FRAMES = 1 << 16
"""Read together."""
FRAME_COLUMNS = ("frame", "stamp_ns", "status", "overflow")


class Columns(NamedTuple):
    """Some frames of a log in their order, each with its obstacles' distances."""

    frame: np.ndarray
    """``(n,)`` int64."""
    stamp_ns: np.ndarray
    """``(n,)`` int64."""
    status: np.ndarray
    """``(n,)`` str objects."""
    overflow: np.ndarray
    """``(n,)`` bool."""
    obstacles: np.ndarray
    """``(n,)`` int64, how many."""
    distance_m: np.ndarray
    """``(sum of obstacles,)`` float32, of all of them, frame after frame."""

    @property
    def nearest_m(self) -> np.ndarray:
        """``(n,)`` float64, distance of the nearest obstacle; inf without one."""
        nearest, some = np.full(len(self.frame), np.inf), self.obstacles > 0
        first = (np.cumsum(self.obstacles) - self.obstacles)[some]
        if first.size:
            nearest[some] = np.minimum.reduceat(self.distance_m, first)
        return nearest


class Timeline:
    """The frames of a log in bins of equal numbers of frames, however many there are.

    Args:
        frames: Of the log.
    """

    def __init__(self, frames: int) -> None:
        self.stride = 1
        """Frames in a bin, a power of two."""
        while self.stride * MOST_BINS < frames:
            self.stride *= 2
        self.count = 0
        """Frames seen."""
        bins = -(-frames // self.stride)
        self.nearest_m = np.full(bins, np.inf)
        """Of each bin the nearest obstacle."""
        self.frame = np.zeros(bins, np.int64)
        """The number of the frame with the nearest obstacle, else of the bin's first."""
        self.stamp_ns = np.zeros(bins, np.int64)
        """Of that frame."""
        self.lost = np.zeros(bins, np.int64)
        """Frames without a result."""
        self.most = np.full(bins, -1)
        """Most obstacles of a frame."""
        self.most_frame = np.zeros(bins, np.int64)
        """And its number."""

    @property
    def bins(self) -> int:
        """How many there are."""
        return len(self.most)

    def add(self, rows: Columns) -> None:
        """Appends rows of the log."""
        nearest = rows.nearest_m
        index = (self.count + np.arange(len(nearest))) // self.stride
        self.count += len(nearest)
        bins, first = np.unique(index, return_index=True)
        best, fullest = _best(index, nearest, first), _best(index, -rows.obstacles, first)
        self.lost[bins] += np.add.reduceat(rows.status != FrameStatus.OK, first, dtype=np.int64)
        nearer = (nearest[best] < self.nearest_m[bins]) | (self.most[bins] < 0)
        at, row = bins[nearer], best[nearer]
        self.nearest_m[at], self.frame[at] = nearest[row], rows.frame[row]
        self.stamp_ns[at] = rows.stamp_ns[row]
        more = rows.obstacles[fullest] > self.most[bins]
        at, row = bins[more], fullest[more]
        self.most[at], self.most_frame[at] = rows.obstacles[row], rows.frame[row]

    def nearest_frames(self, most: int) -> list[int]:
        """Numbers of frames with the nearest obstacles, some way apart, the nearest first."""
        return [int(self.frame[b]) for b in self._spaced(self.nearest_m, most)]

    def fullest_frames(self, most: int) -> list[int]:
        """Numbers of frames with the most obstacles, likewise."""
        counts = np.where(self.most > 0, -self.most.astype(np.float64), np.inf)
        return [int(self.most_frame[b]) for b in self._spaced(counts, most)]

    def _spaced(self, cost: np.ndarray, most: int) -> list[int]:
        """The bins of least cost, each some way from the others; infinite ones are none."""
        chosen: list[int] = []
        apart = max(1, self.bins // APART)
        for b in np.argsort(cost, kind="stable").tolist():
            if len(chosen) == most or not np.isfinite(cost[b]):
                break
            if all(abs(b - other) >= apart for other in chosen):
                chosen.append(b)
        return chosen


def _best(index: np.ndarray, cost: np.ndarray, first: np.ndarray) -> np.ndarray:
    """The row of least cost of each bin, of equal ones the first; ``first`` begins each bin."""
    order = np.lexsort((np.arange(len(cost)), cost, index))
    return order[first]


@dataclass
class LogFigures:
    """What the tables say of a log."""

    log: str
    width_m: float
    """Of a bin of the histograms."""
    timeline: Timeline
    start_ns: int | None = None
    stop_ns: int | None = None
    per_frame: np.ndarray = field(default_factory=lambda: np.zeros(HISTOGRAM_BINS, np.int64))
    """Histogram of the distance to the nearest obstacle of each frame; its last bin is open."""
    per_obstacle: np.ndarray = field(default_factory=lambda: np.zeros(HISTOGRAM_BINS, np.int64))
    """And of all distances."""
    near_frames: np.ndarray = field(default_factory=lambda: np.zeros(len(NEAR_M), np.int64))
    """Frames whose nearest obstacle is nearer than each of :data:`NEAR_M`."""
    near_obstacles: np.ndarray = field(default_factory=lambda: np.zeros(len(NEAR_M), np.int64))
    """And of all obstacles."""
    lost: list[int] = field(default_factory=list)
    """The first frames without a result."""
    overflow: list[int] = field(default_factory=list)
    """The first frames with an overflow."""

    def add(self, rows: Columns) -> None:
        """Appends rows of the log."""
        self.timeline.add(rows)
        if self.start_ns is None:
            self.start_ns = int(rows.stamp_ns[0])
        self.stop_ns = int(rows.stamp_ns[-1])
        nearest = rows.nearest_m
        self.per_frame += self._histogram(nearest[np.isfinite(nearest)])
        self.per_obstacle += self._histogram(rows.distance_m)
        self.near_frames += [np.count_nonzero(nearest < limit) for limit in NEAR_M]
        self.near_obstacles += [np.count_nonzero(rows.distance_m < limit) for limit in NEAR_M]
        for kept, which in (
            (self.lost, rows.status != FrameStatus.OK),
            (self.overflow, rows.overflow),
        ):
            kept += rows.frame[which][: LOST_KEPT - len(kept)].tolist()

    def _histogram(self, distance_m: np.ndarray) -> np.ndarray:
        number = np.minimum(distance_m / self.width_m, HISTOGRAM_BINS - 1).astype(np.int64)
        return np.bincount(number, minlength=HISTOGRAM_BINS)


def collect(results: "Results", range_m: float) -> list[LogFigures]:
    """The figures of each log, in the order of the tables, in one pass and bounded memory.

    Args:
        results: The results.
        range_m: Farthest depth used, for the histograms [m].
    """
    width_m, found = range_m / (HISTOGRAM_BINS - 1), []
    for log in results.logs:
        figures = LogFigures(log.label, width_m, Timeline(log.num_frames))
        for chunk in results.chunks(log, FRAME_COLUMNS, ("distance_m",), CHUNK_FRAMES):
            columns = {name: chunk.frames[name].to_numpy() for name in FRAME_COLUMNS}
            count = chunk.frames["num_obstacles"].to_numpy().astype(np.int64)
            distance_m = chunk.obstacles["distance_m"].to_numpy()
            figures.add(Columns(**columns, obstacles=count, distance_m=distance_m))
        found.append(figures)
    return found
