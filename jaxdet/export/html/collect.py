"""Statistics of results in one pass over the tables: timelines, histograms, notable frames."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from jaxdet.errors import FrameStatus

if TYPE_CHECKING:
    from jaxdet.results.reading import Results

MOST_BINS = 512
"""Maximum number of bins of a timeline; in a longer log, a bin contains several frames and shows
the nearest of their obstacles."""
LOST_KEPT = 12
"""Maximum number of frames without a result that are listed per log, and of frames with an
overflow; the first ones are listed.
"""
HISTOGRAM_BINS = 41
"""Number of bins of a histogram; the last one has no upper edge."""
NEAR_M = (1.0, 0.5)
"""Distances below which obstacles are counted [m], in addition to the histogram, as its bins may
have other edges."""
APART = 20
"""Notable frames are at least 1 / ``APART`` of their log apart."""
CHUNK_FRAMES = 1 << 16
"""Number of frames read at once."""
FRAME_COLUMNS = ("frame", "stamp_ns", "status", "overflow")


class Columns(NamedTuple):
    """Consecutive frames of a log, with the distances of their obstacles."""

    frame: np.ndarray
    """Frame numbers ``(n,)`` int64."""
    stamp_ns: np.ndarray
    """Timestamps ``(n,)`` int64 [ns]."""
    status: np.ndarray
    """Status ``(n,)`` str objects."""
    overflow: np.ndarray
    """Whether obstacles may be missing, ``(n,)`` bool."""
    obstacles: np.ndarray
    """Number of obstacles, ``(n,)`` int64."""
    distance_m: np.ndarray
    """Distances of all obstacles, frame by frame, ``(sum of obstacles,)`` float32; NaN if the floor
    is unknown."""

    @property
    def nearest_m(self) -> np.ndarray:
        """Distance of the nearest obstacle, ``(n,)`` float64 [m]; inf if no distance is known."""
        nearest, some = np.full(len(self.frame), np.inf), self.obstacles > 0
        first = (np.cumsum(self.obstacles) - self.obstacles)[some]
        if first.size:
            nearest[some] = np.fmin.reduceat(self.distance_m, first)
        return np.where(np.isnan(nearest), np.inf, nearest)


class Timeline:
    """Frames of a log in bins of equal numbers of frames.

    Args:
        frames: Number of frames of the log.
    """

    def __init__(self, frames: int) -> None:
        self.stride = 1
        """Number of frames per bin, a power of two."""
        while self.stride * MOST_BINS < frames:
            self.stride *= 2
        self.count = 0
        """Number of frames so far."""
        bins = -(-frames // self.stride)
        self.nearest_m = np.full(bins, np.inf)
        """Distance of the nearest obstacle in each bin."""
        self.frame = np.zeros(bins, np.int64)
        """Number of the frame with the nearest obstacle, else of the bin's first frame."""
        self.stamp_ns = np.zeros(bins, np.int64)
        """Timestamp of that frame."""
        self.lost = np.zeros(bins, np.int64)
        """Number of frames without a result."""
        self.most = np.full(bins, -1)
        """Maximum number of obstacles in a frame."""
        self.most_frame = np.zeros(bins, np.int64)
        """Number of the frame with most obstacles."""

    @property
    def bins(self) -> int:
        """Number of bins."""
        return len(self.most)

    def add(self, rows: Columns) -> None:
        """Add the next frames of the log."""
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
        """Return the frames with the nearest obstacles, spaced in time, the nearest first."""
        return [int(self.frame[b]) for b in self._spaced(self.nearest_m, most)]

    def fullest_frames(self, most: int) -> list[int]:
        """Return the frames with the most obstacles, spaced in time, the fullest first."""
        counts = np.where(self.most > 0, -self.most.astype(np.float64), np.inf)
        return [int(self.most_frame[b]) for b in self._spaced(counts, most)]

    def _spaced(self, cost: np.ndarray, most: int) -> list[int]:
        """Return the bins of least finite cost, at least 1 / APART of the log apart."""
        chosen: list[int] = []
        apart = max(1, self.bins // APART)
        for b in np.argsort(cost, kind="stable").tolist():
            if len(chosen) == most or not np.isfinite(cost[b]):
                break
            if all(abs(b - other) >= apart for other in chosen):
                chosen.append(b)
        return chosen


def _best(index: np.ndarray, cost: np.ndarray, first: np.ndarray) -> np.ndarray:
    """Return the row of least cost in each bin, the first if tied; ``first``: first row per bin."""
    order = np.lexsort((np.arange(len(cost)), cost, index))
    return order[first]


@dataclass
class LogFigures:
    """Statistics of a log."""

    log: str
    width_m: float
    """Bin width of the histograms [m]."""
    timeline: Timeline
    start_ns: int | None = None
    stop_ns: int | None = None
    per_frame: np.ndarray = field(default_factory=lambda: np.zeros(HISTOGRAM_BINS, np.int64))
    """Histogram of the distance to the nearest obstacle of each frame; its last bin is open."""
    per_obstacle: np.ndarray = field(default_factory=lambda: np.zeros(HISTOGRAM_BINS, np.int64))
    """Histogram of the distances to all obstacles; its last bin is open."""
    near_frames: np.ndarray = field(default_factory=lambda: np.zeros(len(NEAR_M), np.int64))
    """Frames whose nearest obstacle is nearer than each of :data:`NEAR_M`."""
    near_obstacles: np.ndarray = field(default_factory=lambda: np.zeros(len(NEAR_M), np.int64))
    """Obstacles nearer than each of :data:`NEAR_M`."""
    lost: list[int] = field(default_factory=list)
    """Numbers of the first frames without a result."""
    overflow: list[int] = field(default_factory=list)
    """Numbers of the first frames with an overflow."""

    def add(self, rows: Columns) -> None:
        """Add the next frames of the log."""
        self.timeline.add(rows)
        if self.start_ns is None:
            self.start_ns = int(rows.stamp_ns[0])
        self.stop_ns = int(rows.stamp_ns[-1])
        nearest = rows.nearest_m
        self.per_frame += self._histogram(nearest)
        self.per_obstacle += self._histogram(rows.distance_m)
        self.near_frames += [np.count_nonzero(nearest < limit) for limit in NEAR_M]
        self.near_obstacles += [np.count_nonzero(rows.distance_m < limit) for limit in NEAR_M]
        for kept, which in (
            (self.lost, rows.status != FrameStatus.OK),
            (self.overflow, rows.overflow),
        ):
            kept += rows.frame[which][: LOST_KEPT - len(kept)].tolist()

    def _histogram(self, distance_m: np.ndarray) -> np.ndarray:
        distance_m = distance_m[np.isfinite(distance_m)]
        number = np.minimum(distance_m / self.width_m, HISTOGRAM_BINS - 1).astype(np.int64)
        return np.bincount(number, minlength=HISTOGRAM_BINS)


def collect(results: "Results", range_m: float) -> list[LogFigures]:
    """Collect the statistics of each log, in the order of the tables, with bounded memory.

    Args:
        results: Results.
        range_m: Maximum depth, for the histograms [m].
    """
    width_m, statistics = range_m / (HISTOGRAM_BINS - 1), []
    for log in results.logs:
        figures = LogFigures(log.label, width_m, Timeline(log.num_frames))
        for chunk in results.chunks(log, FRAME_COLUMNS, ("distance_m",), CHUNK_FRAMES):
            columns = {name: chunk.frames[name].to_numpy() for name in FRAME_COLUMNS}
            count = chunk.frames["num_obstacles"].to_numpy().astype(np.int64)
            distance_m = chunk.obstacles["distance_m"].to_numpy()
            figures.add(Columns(**columns, obstacles=count, distance_m=distance_m))
        statistics.append(figures)
    return statistics
