"""Differences between two runs on the same logs; obstacles are matched by overlap per frame."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from jaxdet.errors import InputError
from jaxdet.eval.polygon import overlap
from jaxdet.results.json_files import plain
from jaxdet.results.reading import MOST_NAMED, ResultLog, Results
from jaxdet.results.tables import Frame

MIN_OVERLAP = 0.2
"""Minimum intersection over union of the outlines of an obstacle in both runs."""
_FROM_ELSEWHERE = {"log", "track", "tracks"}
"""Columns that are not results of a frame and are not compared."""


class Found(NamedTuple):
    """An obstacle of a run."""

    obstacle: int
    """Number in the frame."""
    distance_m: float | None
    """Distance on the floor [m]; None if the floor is unknown."""
    depth_m: float
    """Smallest depth [m]."""


class FrameDifference(NamedTuple):
    """A frame with differences between two runs."""

    frame: int
    """Number of the frame."""
    stamp_ns: int
    """Timestamp [ns]."""
    status: tuple[str, str]
    """Status in each run."""
    obstacles: tuple[int, int]
    """Number of obstacles in each run."""
    only_a: tuple[Found, ...]
    """Obstacles of the first run that the second did not find."""
    only_b: tuple[Found, ...]
    """Obstacles of the second run that the first did not find."""
    changed: tuple[tuple[Found, Found], ...]
    """Pairs of matched obstacles, one of each run, with different values."""
    columns: tuple[str, ...]
    """Columns of the frame that differ."""

    @property
    def moved_m(self) -> float:
        """Largest change of the distance of a matched obstacle [m].

        If one of the runs does not know the floor, the change of the obstacle's depth is used.
        """
        return max((_moved(a, b) for a, b in self.changed), default=0.0)


@dataclass
class LogDifference:
    """Differences between two results of a log."""

    a: ResultLog
    """Log in the first run."""
    b: ResultLog
    """Log in the second run."""
    frames: int = 0
    """Number of frames in both results."""
    only_a: int = 0
    """Number of frames only in the first result."""
    only_b: int = 0
    """Number of frames only in the second result."""
    obstacles: tuple[int, int] = (0, 0)
    """Number of obstacles of each result in the common frames."""
    different: list[FrameDifference] = field(default_factory=list)
    """Frames with differences, in order."""

    @property
    def equal(self) -> bool:
        """Whether both results have the same frames with the same values."""
        return not (self.only_a or self.only_b or self.different)


@dataclass
class Difference:
    """Differences between two runs."""

    settings: list[tuple[str, Any, Any]]
    """Parameters that differ: name, value in the first and in the second run."""
    only_a: list[str]
    """Logs only in the first run."""
    only_b: list[str]
    """Logs only in the second run."""
    logs: list[LogDifference]
    """Logs in both runs."""

    @property
    def equal(self) -> bool:
        """Whether both runs have equal results for the same logs, regardless of parameters."""
        return not (self.only_a or self.only_b) and all(log.equal for log in self.logs)


def difference(a: Results, b: Results) -> Difference:
    """Compare two runs.

    Logs are paired by name, or regardless of name if each run has only one; frames are paired by
    number. Obstacles of a frame are matched one to one, so that the sum of the overlaps of their
    footprints (intersection over union, at least ``MIN_OVERLAP``) is maximal.

    Raises:
        InputError: The runs have no log in common, logs with the same name are different
            recordings, or tables are damaged.
    """
    logs = {log.label: log for log in a.logs}, {log.label: log for log in b.logs}
    common = [name for name in logs[0] if name in logs[1]]
    pairs = [(logs[0][name], logs[1][name]) for name in common]
    if not pairs and len(a.logs) == len(b.logs) == 1:
        pairs = [(a.logs[0], b.logs[0])]
    if not pairs:
        some = (", ".join([*names][:MOST_NAMED]) or "no log" for names in logs)
        problem = "no log of {} is in {}; they have {} and {}"
        raise InputError(problem.format(a.folder, b.folder, *some))
    paired = {log.label for pair in pairs for log in pair}
    only_a, only_b = ([name for name in names if name not in paired] for names in logs)
    found = [_log_difference(a, b, *pair) for pair in pairs]
    return Difference(_settings(a, b), only_a, only_b, found)


def _settings(a: Results, b: Results) -> list[tuple[str, Any, Any]]:
    """Return the version and the parameters that differ."""
    found = [("jaxdet", a.version, b.version)]
    values = _flat(plain(a.method) | {"log": plain(a.log_options)})
    others = _flat(plain(b.method) | {"log": plain(b.log_options)})
    found += [(name, value, others.get(name)) for name, value in values.items()]
    return [(name, one, other) for name, one, other in found if one != other]


def _flat(sections: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    return {f"{name}.{key}": v for name, part in sections.items() for key, v in part.items()}


def _log_difference(a: Results, b: Results, log_a: ResultLog, log_b: ResultLog) -> LogDifference:
    found = LogDifference(log_a, log_b)
    for one, other in _by_number(a.frames(log_a), b.frames(log_b)):
        if one is None or other is None:
            found.only_a += other is None
            found.only_b += one is None
            continue
        if one.row["stamp_ns"] != other.row["stamp_ns"]:
            number = one.row["frame"]
            problem = f"frame {number} of {log_a.label} has another timestamp in {b.folder}"
            remedy = "compare results of the same recording"
            raise InputError(problem, path=str(a.folder), remedy=remedy)
        found.frames += 1
        count = found.obstacles
        found.obstacles = count[0] + len(one.obstacles), count[1] + len(other.obstacles)
        if (different := _frame_difference(one, other)) is not None:
            found.different.append(different)
    if not found.frames:
        problem = f"no frame of {log_a.label} is in {b.folder}"
        remedy = "compare results with the same --start, --stop and --every"
        raise InputError(problem, path=str(a.folder), remedy=remedy)
    return found


def _by_number(
    a: Iterator[Frame], b: Iterator[Frame]
) -> Iterator[tuple[Frame | None, Frame | None]]:
    """Yield pairs of frames with the same number; None stands for a frame that a run lacks."""
    one, other = next(a, None), next(b, None)
    while one is not None or other is not None:
        numbers = [np.inf if frame is None else frame.row["frame"] for frame in (one, other)]
        first, second = numbers[0] <= numbers[1], numbers[1] <= numbers[0]
        yield one if first else None, other if second else None
        one, other = next(a, None) if first else one, next(b, None) if second else other


def _changes(a: Mapping[str, Any], b: Mapping[str, Any]) -> list[str]:
    """Return the columns in which two rows differ; NaN equals NaN."""
    names = [name for name in a if name in b and name not in _FROM_ELSEWHERE]
    return [n for n in names if a[n] != b[n] and repr(a[n]) != repr(b[n])]


def _frame_difference(a: Frame, b: Frame) -> FrameDifference | None:
    """Compare a frame of both runs, with its obstacles matched; None if all values are equal."""
    columns = _changes(a.row, b.row)
    same = len(a.obstacles) == len(b.obstacles) and not any(map(_changes, a.obstacles, b.obstacles))
    if same and not columns:
        return None
    outlines = [[np.reshape(row["corners_ground"], (4, 2)) for row in f.obstacles] for f in (a, b)]
    shared = np.array([[_overlap(one, other) for other in outlines[1]] for one in outlines[0]])
    shared = np.where(shared >= MIN_OVERLAP, shared, 0).reshape(len(a.obstacles), len(b.obstacles))
    rows, others = linear_sum_assignment(shared, maximize=True)
    both = shared[rows, others] > 0
    matched = dict(zip(rows[both].tolist(), others[both].tolist(), strict=True))
    changed = [
        (_found(a.obstacles[i]), _found(b.obstacles[j]))
        for i, j in matched.items()
        if _changes(a.obstacles[i], b.obstacles[j])
    ]
    return FrameDifference(
        a.row["frame"],
        a.row["stamp_ns"],
        (a.row["status"], b.row["status"]),
        (len(a.obstacles), len(b.obstacles)),
        tuple(_found(row) for i, row in enumerate(a.obstacles) if i not in matched),
        tuple(_found(row) for j, row in enumerate(b.obstacles) if j not in matched.values()),
        tuple(changed),
        tuple(columns),
    )


def _found(row: Mapping[str, Any]) -> Found:
    return Found(row["obstacle"], row["distance_m"], row["z_min"])


def _moved(a: Found, b: Found) -> float:
    """Return the change of the distance [m], or of the depth if the floor of a run is unknown."""
    if a.distance_m is None or b.distance_m is None:
        return abs(a.depth_m - b.depth_m)
    return abs(a.distance_m - b.distance_m)


def _overlap(a: np.ndarray, b: np.ndarray) -> float:
    """Return the intersection over union of two outlines ``(4, 2)``; 0 if they are disjoint."""
    if (a.max(axis=0) < b.min(axis=0)).any() or (b.max(axis=0) < a.min(axis=0)).any():
        return 0.0
    return 1.0 if np.array_equal(a, b) else float(np.nan_to_num(overlap(a, b)))
