"""Summary of a run and of its logs, for ``summary.json``."""

import dataclasses
import math
import os
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from jaxdet.errors import FrameStatus
from jaxdet.results.json_files import plain
from jaxdet.results.metric import MOST_TILT_DEG, TILT, rectangle_distances, tilted
from jaxdet.results.versions import version, versions

STEPS = ("read", "decode", "transfer", "compute", "write")
ON_DEVICES = ("transfer", "compute")
"""Steps that GPUs do, if there are GPUs."""
_DERIVED = ("bottleneck", "rates")
"""Keys of a log's entry that are neither fields nor results of observers."""
SHORT_M = 0.02
"""Gap between an obstacle's nearest point and its rectangle above which this is too short [m]."""
MANY_REFUSED = 0.1
"""Maximum fraction of frames without a floor of their own that causes no warning."""
ROLL_FLAG = "--ground.camera-roll"
STEEP_DEG = 60.0
"""Pitch or roll above which a mount may belong to a frame other than the camera's [degree]."""
MOSTLY_FAR = 0.9
"""Fraction of frames with a floor far from the prior above which the depth may be wrong."""


@dataclass(kw_only=True)
class Counts:
    """Counts and times of a set of frames, which can be added up."""

    frames: int = 0
    """Number of depth images; if the log failed, their number before the failure."""
    status: Counter[str] = field(default_factory=Counter)
    obstacles: int = 0
    short_rectangles: int = 0
    """Number of obstacles with a point more than ``SHORT_M`` in front of their rectangle."""
    overflow_frames: int = 0
    floor_sources: Counter[str] = field(default_factory=Counter)
    """Number of ok frames per ``floor_source`` of ``frames.parquet``."""
    floor_refused: Counter[str] = field(default_factory=Counter)
    """Number of ok frames per ``floor_refused`` of ``frames.parquet``."""
    tilted_frames: int = 0
    """Number of ok frames without a position in the world, as the world's z axis is not up."""
    busy_s: Counter[str] = field(default_factory=Counter)
    """Time of all processes to ``read`` and unpack, ``decode`` images, ``transfer`` to GPUs and
    back, ``compute``, ``write`` rows, and to ``wait`` for the process that computes [s]."""

    def count(self, rows: Mapping[str, Any], obstacles: Mapping[str, Any]) -> None:
        """Add the counts of some frames with all their obstacles.

        Args:
            rows: Columns of ``frames.parquet`` as NumPy arrays; Arrow would import pandas to
                convert a table to them.
            obstacles: Columns of ``obstacles.parquet``.
        """
        self.frames += len(rows["status"])
        self.status.update(rows["status"].tolist())
        self.obstacles += int(rows["num_obstacles"].sum())
        begins = rectangle_distances(obstacles["corners_ground"].reshape(-1, 4, 2))
        self.short_rectangles += int((begins > obstacles["distance_m"] + SHORT_M).sum())
        self.overflow_frames += int(rows["overflow"].sum())
        good = rows["status"] == str(FrameStatus.OK)
        self.floor_sources.update(rows["floor_source"][good].tolist())
        self.floor_refused.update(rows["floor_refused"][good].compressed().tolist())
        self.tilted_frames += int(tilted(*(rows[name][good] for name in TILT)).sum())

    def add(self, other: "Counts") -> None:
        """Add the counts and times of other frames."""
        for part in dataclasses.fields(Counts):
            mine, more = getattr(self, part.name), getattr(other, part.name)
            if isinstance(mine, Counter):
                mine.update(more)
            else:
                setattr(self, part.name, mine + more)


@dataclass
class LogSummary(Counts):
    """Summary of a log, or of one camera if the log has several."""

    log: str
    paths: tuple[str, ...]
    workers: int = 1
    """Number of processes that share the frames."""
    devices: int = 0
    """Number of GPUs that compute for these processes; 0 if the processes compute themselves."""
    camera: str | None = None
    """Name of the camera; None if the log could not be opened."""
    file_name: str | None = None
    """Prefix of the names of the log's files in an export."""
    seconds: float = 0.0
    """Time from the request of the first batch to the last row [s]."""
    first_batch_s: float = 0.0
    """Time until the first batches were done, with compilation [s]."""
    frames_per_s: float | None = None
    """Rate after the first batches; None if there are too few frames after them."""
    ground: tuple[Any, ...] = ()
    """Priors of the floor and their sources, see ``jaxdet.engine.GroundRecord``."""
    calibration: Any = None
    description: Any = None
    """Description by the reader: topics, calibration sources, pairing, integrity, warnings."""
    cameras_left_out: list[str] = field(default_factory=list)
    """Cameras of the log that can't be used, if no camera was chosen."""
    map: str | None = None
    pictures: list[str] = field(default_factory=list)
    observed: dict[str, Any] = field(default_factory=dict)
    """Result of each observer for this log, by the observer's name; ``score`` is the comparison
    with ground truth."""
    warnings: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    """Remarks that are not warnings."""
    frame_errors: list[str] = field(default_factory=list)
    """Some frames that could not be used, with the reason."""
    lost: list[str] = field(default_factory=list)
    """Ranges of frames without results, as the processes that computed them were lost twice."""
    error: str | None = None
    """Reason why the log failed and has no rows; None if it has rows."""

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> "LogSummary":
        """Restore a summary from the result of :meth:`to_dict`."""
        kinds = {part.name: part for part in dataclasses.fields(cls)}
        counters = {part.name for part in dataclasses.fields(Counts) if part.type is not int}
        values: dict[str, Any] = {
            name: Counter(value) if name in counters else value
            for name, value in content.items()
            if name in kinds
        }
        observed = {k: v for k, v in content.items() if k not in {*kinds, *_DERIVED}}
        return cls(**values, observed=observed)

    def to_dict(self) -> dict[str, Any]:
        """Return values for JSON; results of observers are under the observers' names."""
        values = {"log": self.log, "bottleneck": self.bottleneck, "rates": plain(self.rates)}
        values |= plain(self)
        seen = values.pop("observed")
        return {"score": None, **values, **seen}

    @property
    def floor_warning(self) -> str | None:
        """Warning if many frames don't show their floor themselves."""
        refused, good = self.floor_refused.total(), self.status[FrameStatus.OK]
        if refused <= MANY_REFUSED * good:
            return None
        reasons = ", ".join(f"{n} {name}" for name, n in self.floor_refused.most_common())
        nothing = self.floor_sources["none"]
        priors = {k: n for k, n in self.floor_sources.items() if n and k not in ("frame", "none")}
        others = [f"{n} have that of {name}" for name, n in priors.items()]
        if nothing:
            others.append(f"in {nothing} no floor is known, so their obstacles have no distance")
        remedy = "pass the camera's true --ground.camera-height-m, --ground.camera-pitch and "
        remedy += "--ground.camera-roll"
        if self.floor_sources["flags"]:
            remedy += ", or leave them out"
        if self.floor_refused["far"] > MOSTLY_FAR * good:
            remedy += "; where the mount is true, check the depth unit (--log.depth-unit-m), the "
            remedy += "intrinsics of the depth camera"
        cause = self._floor_cause()
        return (
            f"{refused} of {good} frames don't show their floor themselves ({reasons}; "
            f"see floor_refused in jaxdet help tables), "
            f"{', '.join(others)}: {cause}{'; else ' if cause else ''}{remedy}"
        )

    def _floor_cause(self) -> str:
        """Return a likely cause of missing floors, by the camera's mount, and its remedy."""
        if not (self.floor_sources["tf"] or self.floor_sources["none"]):
            return ""
        if any(ROLL_FLAG in text for text in self.warnings):
            return f"the camera may be mounted in another way, see the warning with {ROLL_FLAG}"
        if not self.floor_sources["tf"]:
            return ""
        mount = next((record for record in self.ground if record.pitch_rad is not None), None)
        angles = [math.degrees(a) for a in (mount.pitch_rad, mount.roll_rad)] if mount else [0, 0]
        if max(map(abs, angles)) > STEEP_DEG:
            looks = f"by its transforms the camera looks {angles[0]:.0f}° down, rolled by "
            looks += f"{angles[1]:.0f}°: its images may not be in the frame that they name"
            return f"{looks}; name the optical frame with --log.camera-frame"
        text = "by its transforms the camera may be elsewhere than over the floor"
        return f"{text}; name the frame whose z = 0 is the floor with --log.base-frame"

    @property
    def depth_warning(self) -> str | None:
        """Warning if most frames that can be decoded have no depth in range."""
        none, good = self.status[FrameStatus.NO_DEPTH], self.status[FrameStatus.OK]
        if none <= good:
            return None
        return (
            f"{none} of {none + good} frames have no depth in range: check the depth unit "
            "(--log.depth-unit-m; 32FC1 counts as metres), then --ground.max-depth-m"
        )

    @property
    def tilt_warning(self) -> str | None:
        """Warning if frames have no position in the world, as its z axis is not up."""
        if not self.tilted_frames:
            return None
        return (
            f"{self.tilted_frames} of {self.status[FrameStatus.OK]} frames have no place in the "
            f"world and on the map: their floor is tilted by more than {MOST_TILT_DEG:g}° in it, "
            "so its z is not up, or the camera's mount is wrong; use poses in a world whose z "
            "points up, or none"
        )

    @property
    def color_warning(self) -> str | None:
        """Warning if half of the depth images or more lack the colour that ``paper`` needs."""
        without = self.status[FrameStatus.NO_COLOR]
        if not without or 2 * without < self.frames:
            return None
        return (
            f"{without} of {self.frames} depth images have no colour image, which the preset paper "
            "needs: use another preset, which reads depth alone; jaxdet info shows the rates of "
            "both"
        )

    @property
    def rates(self) -> dict[str, float]:
        """Frames per second of each step if it were the only one."""
        return {
            what: self.frames * self._in_parallel(what) / self.busy_s[what]
            for what in STEPS
            if self.busy_s[what] > 0 and self.frames
        }

    @property
    def bottleneck(self) -> str:
        """Slowest step of the processes or GPUs that are busy longest; empty before any step.

        With GPUs, the GPUs do the steps ``ON_DEVICES``, and workers do all other steps.
        """
        groups = (ON_DEVICES, tuple(what for what in STEPS if what not in ON_DEVICES))
        groups = [*((what,) for what in groups[0]), groups[1]] if self.devices else [STEPS]
        taken = [
            sum(self.busy_s[what] / self._in_parallel(what) for what in group) for group in groups
        ]
        busiest = groups[taken.index(max(taken))]
        slowest = max(busiest, key=lambda what: self.busy_s[what])
        return slowest if self.busy_s[slowest] > 0 else ""

    def _in_parallel(self, what: str) -> int:
        """Return the number of workers or GPUs that do a step at the same time."""
        return self.devices if self.devices and what in ON_DEVICES else self.workers

    @property
    def num_bad(self) -> int:
        """Number of frames with another status than ok."""
        return self.frames - self.status[FrameStatus.OK]


@dataclass
class Summary:
    """Summary of a run."""

    backend: str
    batch_size: int
    logs: list[LogSummary] = field(default_factory=list)
    seconds: float = 0.0
    workers: int = 1
    """Number of processes that shared the frames."""
    kept: frozenset[str] = frozenset()
    """Names of logs that were done before this run."""

    @property
    def frames(self) -> int:
        """Number of frames of all logs with rows in the tables."""
        return sum(log.frames for log in self.whole)

    @property
    def obstacles(self) -> int:
        """Number of obstacles of all logs with rows in the tables."""
        return sum(log.obstacles for log in self.whole)

    @property
    def whole(self) -> list[LogSummary]:
        """Logs with rows in the tables."""
        return [log for log in self.logs if not log.error]

    @property
    def failed(self) -> list[LogSummary]:
        """Logs that failed and have no rows."""
        return [log for log in self.logs if log.error]

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``summary.json``: strings, numbers, lists, mappings and null."""
        status = Counter({str(s): 0 for s in FrameStatus})
        for log in self.whole:
            status.update(log.status)
        return {
            "jaxdet": version("jaxdet"),
            "backend": self.backend,
            "batch_size": self.batch_size,
            "workers": self.workers,
            "frames": self.frames,
            "status": dict(status),
            "obstacles": self.obstacles,
            "overflow_frames": sum(log.overflow_frames for log in self.whole),
            "failed_logs": len(self.failed),
            "kept_logs": len(self.kept),
            "lost_units": sum(len(log.lost) for log in self.whole),
            "seconds": round(self.seconds, 3),
            "logs": [log.to_dict() for log in self.logs],
            "versions": versions(),
        }


def failure_record(about: Mapping[str, Any], logs: Sequence[LogSummary]) -> dict[str, Any]:
    """Return the content of ``failed.json``.

    Args:
        about: Entries as in the manifest of a log with results.
        logs: Summaries of the log's cameras.
    """
    reason = "; ".join(log.error for log in logs if log.error)
    return {"reason": reason, "attempts": 1, **about, "logs": [log.to_dict() for log in logs]}


def problems(content: Mapping[str, Any]) -> list[str]:
    """Return the problems for which a run ends with an error, one line for each.

    Args:
        content: Content of ``summary.json``.
    """
    whole = [log for log in content["logs"] if not log["error"]]
    found = [failure(log) for log in content["logs"] if log["error"]]
    found += [_unusable(log) for log in whole if log["frames"] and not _good(log)]
    scores = [(log["log"], log.get("score") or {}) for log in whole]
    found += [f"{log}: no score: {score['error']}" for log, score in scores if "error" in score]
    left = {log["log"]: log["cameras_left_out"] for log in whole if log["cameras_left_out"]}
    found += [
        f"{log}: left out: camera {', camera '.join(names)}, see the warning; "
        "--camera takes others alone"
        for log, names in left.items()
    ]
    return [*found, *(lost for log in whole for lost in log["lost"])]


def failure(log: Mapping[str, Any]) -> str:
    """Return the error of a failed log, preceded by the log's name unless the error names the log.

    Args:
        log: Entry in ``summary.json``.
    """
    error, name = log["error"], log["log"]
    about = os.path.abspath(error.partition(": ")[0])
    own = (os.path.abspath(path) for path in log["paths"])
    if any(about == path or about.startswith(os.path.join(path, "")) for path in own):
        return error
    return error if error.startswith((f"{name}: ", f"{name}, ")) else f"{name}: {error}"


def _good(log: Mapping[str, Any]) -> int:
    return log["status"].get(FrameStatus.OK, 0)


def _unusable(log: Mapping[str, Any]) -> str:
    states = ", ".join(f"{n} {status}" for status, n in Counter(log["status"]).most_common())
    text = f"{log['log']}: none of its {log['frames']} frames could be used ({states})"
    return "; ".join([text, *log["frame_errors"][:1]])
