"""Prior of the floor of a log's frames, and its source.

Flags or the robot's transforms (TF) give a first prior. The floors of a sample of frames, each
found on its own, replace it, as mounts are often described wrongly. The prior is decided before the
frames of a log (or of a fixed time window of it) are processed, and is never carried from frame to
frame, so results don't depend on how a run is divided. Each frame's own depth corrects it later;
only for clusters of points (preset ``paper``) the prior itself is used as the floor.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from jaxdet.config import Config, GroundConfig
from jaxdet.engine.startup import computing
from jaxdet.errors import InputError
from jaxdet.floor.plane import (
    flagged_plane,
    join_planes,
    plane_from_transform,
    repeat_plane,
    unknown_plane,
)
from jaxdet.floor.sampled import SampledFloor, sampled_floor
from jaxdet.floor.turned import turned_back, turned_frames
from jaxdet.pipeline import BackendName, find_floors
from jaxdet.results.summary import STEEP_DEG
from jaxdet.types import GroundPlane

if TYPE_CHECKING:
    from jaxdet.io import Log

_FEW, _MOST = 0.25, 0.75
"""Maximum fraction of sampled frames with a floor at which other mountings of the camera are tried,
and minimum fraction of frames that must show the floor of another mounting."""
_TURNS = (2, 1, 3)
"""Quarter turns of the images of cameras that are mounted upside down (2) or on a side (1, 3)."""
_PARALLEL_RAD = math.radians(3.0)
"""Maximum difference in pitch and roll between floors that count as parallel [rad]."""
_SAME_HEIGHT = 0.1
"""Maximum difference between equal camera heights, as a fraction of the height."""
_LOW_M = 1.0
"""Maximum height of a camera that counts as upside down; a farther plane may be a ceiling [m]."""
MIN_HEIGHT_M, MAX_HEIGHT_M = 0.02, 20.0
"""Range of camera heights accepted from TF [m]; a base frame at the camera would give 0."""


@dataclass(frozen=True)
class GroundRecord:
    """Floor prior of a log or of a time window, and the prior's source, for the summary."""

    source: str
    """Source of the prior: ``flags``, ``tf``, ``estimate`` or ``none``."""
    window_start_ns: int | None = None
    """First stamp of the time window; None for the whole log."""
    height_m: float | None = None
    pitch_rad: float | None = None
    roll_rad: float | None = None
    height_spread_m: float | None = None
    """Spread of the heights of the sampled frames, if the source is ``estimate`` [m]."""
    frames_used: int | None = None
    message: str = ""


@dataclass(frozen=True)
class Planes:
    """Priors of a log's floors."""

    records: tuple[GroundRecord, ...]
    windows: dict[int, GroundPlane]
    """Plane (``B = 1``) of each window by its number; the whole log is window 0."""
    window_ns: int = 0
    """Length of the windows; 0 for the whole log."""
    warnings: tuple[str, ...] = ()
    otherwise: GroundPlane = field(default_factory=lambda: unknown_plane(1), repr=False)
    """Plane for frames outside of all windows, ``B = 1``."""
    otherwise_source: str = "none"
    """Source of the plane :attr:`otherwise`."""

    def of(self, stamp_ns: np.ndarray) -> GroundPlane:
        """Return the floor priors of frames, by their timestamps ``(B,)`` int64 [ns]."""
        if not self.window_ns:
            return repeat_plane(self.windows[0], stamp_ns.size)
        keys = (stamp_ns // self.window_ns).tolist()
        each = [self.windows.get(key, self.otherwise) for key in keys]
        return join_planes(each)

    def sources(self, stamp_ns: np.ndarray) -> list[str]:
        """Return the source of each frame's prior, by the timestamps ``(B,)`` int64 [ns].

        Sources are ``flags``, ``tf``, ``log`` (an estimate from frames of the whole log),
        ``window`` (an estimate from frames of the same time window) and ``none``.
        """
        if not self.window_ns:
            return [_word(self.records[0], "log")] * stamp_ns.size
        words = {
            record.window_start_ns // self.window_ns: _word(record, "window")
            for record in self.records
            if record.window_start_ns is not None
        }
        keys = (stamp_ns // self.window_ns).tolist()
        return [words.get(key, self.otherwise_source) for key in keys]


def _word(record: GroundRecord, estimated: str) -> str:
    return estimated if record.source == "estimate" else record.source


def decide_planes(
    log: "Log",
    config: Config,
    backend: BackendName,
    frames: np.ndarray | None = None,
    at_once: int | None = None,
    alive: Callable[[], object] = lambda: None,
) -> Planes:
    """Return the priors of a log's floors.

    The median floor of a sample of frames replaces the prior from flags or, if no flags are set,
    from TF. Without flags and TF, the median is only used if the camera keeps its place on the
    robot, see :class:`jaxdet.floor.sampled.SampledFloor`; otherwise the floor of each frame is
    searched without a prior. Samples are spread evenly over all frames of the log, or of each time
    window with a frame that is read, so that the prior of a frame doesn't depend on which other
    frames are read.

    Args:
        log: An open log.
        config: ``config.ground`` has the source, and the length of the time windows that have
            their own samples.
        backend: Backend that finds the floors.
        frames: Numbers of the frames that need a prior; by default all that are read.
        at_once: Maximum number of frames of a sample in memory at a time; by default all.
        alive: Called after each part of a sample.

    Returns:
        The planes, with records and warnings for the summary.

    Raises:
        InputError: ``ground.source`` is tf and the log has no usable transform.
    """
    if config.ground.source == "none":
        return Planes(
            (GroundRecord("none", message="ground.source is none"),), {0: unknown_plane(1)}
        )
    first, plane, warnings = _stated(log, config.ground)
    samples = _Samples(log, config, backend, at_once, alive)
    records, windows, texts = [], {}, []
    window_ns = round(config.ground.window_s * 1e9)
    wanted = np.array(log.frames, int) if frames is None else frames
    for number, all_frames in _windows(log, window_ns, wanted):
        sample = evenly(all_frames, config.ground.sample_frames)
        (found,) = samples.floors(sample, plane)
        record, windows[number] = _prior(found, first, plane, by_frame=not config.cluster.points)
        few = record.frames_used is not None and record.frames_used <= _FEW * len(sample)
        if few and record.source in ("none", "tf") and not config.cluster.points:
            turns = (0, *_TURNS) if record.source == "tf" else _TURNS
            floors = samples.floors(sample, unknown_plane(1), turns)
            each = tuple(zip(turns, floors, strict=True))
            record, windows[number], text = _other_prior(each, record, plane)
            texts += [text] if text else []
        start = number * window_ns if window_ns else None
        records.append(replace(record, window_start_ns=start))
    if texts:
        where = f"; in {len(texts)} of {len(windows)} time windows" if window_ns else ""
        warnings = (*warnings, texts[0] + where)
    unknown = sum(not one.valid[0] for one in windows.values())
    if config.cluster.points and unknown:
        where = f" in {unknown} of {len(windows)} time windows" if window_ns else ""
        problem = f"no floor was found{where}: nothing is dropped as floor there"
        warnings = (*warnings, f"{problem}; pass --ground.camera-height-m")
    return Planes(
        tuple(records) or (replace(first, message=_with_prior(first, "no frame has depth")),),
        windows if window_ns else {0: plane, **windows},
        window_ns,
        warnings,
        plane,
        first.source,
    )


def evenly(values: np.ndarray, count: int) -> np.ndarray:
    """Return at most ``count`` of ``values``, evenly spaced, with the first and the last."""
    if values.size <= count:
        return values
    return values[np.linspace(0, values.size - 1, count).round().astype(np.int64)]


def _windows(log: "Log", window_ns: int, wanted: np.ndarray) -> list[tuple[int, np.ndarray]]:
    """Return the number and all frames of each window with a wanted frame, or of the whole log."""
    frames = np.arange(log.num_frames)
    if not window_ns:
        return [(0, frames)] if frames.size else []
    numbers = np.asarray(log.stamps_ns) // window_ns
    needed = np.unique(numbers[wanted])
    return [(number, frames[numbers == number]) for number in needed.tolist()]


def _stated(log: "Log", ground: GroundConfig) -> tuple[GroundRecord, GroundPlane, tuple[str, ...]]:
    """Return the prior from flags or TF, with warnings; its source is ``none`` without either."""
    if ground.camera_height_m is not None and ground.source in ("auto", "flags"):
        plane = flagged_plane(ground)
        return _record("flags", plane), plane, ()
    nothing = GroundRecord("none"), unknown_plane(1)
    if ground.source not in ("auto", "tf"):
        return *nothing, ()
    plane, problem = _plane_from_tf(log)
    if plane is not None:
        return _record("tf", plane, f"{log.base_frame} to the depth camera"), plane, ()
    if ground.source == "tf":
        raise InputError(problem, path=log.name, remedy="pass --ground.camera-height-m")
    return *nothing, (problem,) if log.T_base_camera is not None else ()


def _plane_from_tf(log: "Log") -> tuple[GroundPlane | None, str]:
    if log.T_base_camera is None:
        return None, "no transform from the robot's base to the depth camera"
    plane = plane_from_transform(log.T_base_camera)
    height = float(plane.height[0])
    if not MIN_HEIGHT_M <= height <= MAX_HEIGHT_M:
        return None, f"the TF camera height of {height:.3f} m above {log.base_frame} is not used"
    return plane, ""


class _Samples(NamedTuple):
    """Floor search in samples of a log's frames; fields are arguments of :func:`decide_planes`."""

    log: "Log"
    config: Config
    backend: BackendName
    at_once: int | None
    alive: Callable[[], object]

    def floors(
        self, sample: np.ndarray, plane: GroundPlane, turns: Sequence[int] = (0,)
    ) -> list[SampledFloor | None]:
        """Return the floor of a sample for each turn of its images.

        Args:
            sample: Numbers of frames.
            plane: Prior for each frame, ``B = 1``.
            turns: Quarter turns of the images.

        Returns:
            A floor for each turn; None if no frame can be read.
        """
        shown: list[list[GroundPlane]] = [[] for _ in turns]
        own: list[list[np.ndarray]] = [[] for _ in turns]
        size = self.at_once or len(sample)
        for first in range(0, len(sample), size):
            frames = self.log.read(sample[first : first + size].tolist()).frames
            for way, quarters in enumerate(turns if frames.valid.any() else ()):
                images = turned_frames(frames, quarters) if quarters else frames
                images = images._replace(plane=repeat_plane(plane, len(frames.valid)))
                with computing():
                    fit = find_floors(images, self.config, backend=self.backend)
                shown[way].append(GroundPlane(*(np.asarray(a)[frames.valid] for a in fit.plane)))
                own[way].append(np.asarray(fit.own)[frames.valid])
            self.alive()
        return [
            sampled_floor(join_planes(planes), np.concatenate(decided)) if planes else None
            for planes, decided in zip(shown, own, strict=True)
        ]


def _prior(
    found: SampledFloor | None, first: GroundRecord, plane: GroundPlane, *, by_frame: bool
) -> tuple[GroundRecord, GroundPlane]:
    """Return the prior after a sample: the floor that its frames show, or the first prior.

    Args:
        found: Floor of the sample.
        first: Record of the first prior.
        plane: The first prior.
        by_frame: Whether the floor of a frame can be found without a prior.
    """
    if found is None:
        return replace(first, message=_with_prior(first, "no sampled frame could be read")), plane
    message = _with_prior(first, _sample_text(found))
    by_frame = by_frame and not plane.valid[0]
    if not (found.agrees if by_frame else found.plane.valid[0]):
        if by_frame:
            message = f"each frame is searched alone; {message}"
        return replace(first, frames_used=found.decided, message=message), plane
    return _estimate(found, found.plane, message), found.plane


def _other_prior(
    each: Sequence[tuple[int, SampledFloor | None]], record: GroundRecord, plane: GroundPlane
) -> tuple[GroundRecord, GroundPlane, str]:
    """Return the prior of a camera with another mount, and a warning or an empty text.

    A mount that contradicts TF is used if :func:`_tf_fault` explains it. If images turned by 180°
    show a near floor, the camera is taken to be upside down; a far plane may be the ceiling above
    an upright camera. For other mounts the warning only names the flags: a higher plane may be a
    table, and a wall may look like a floor in turned images.

    Args:
        each: Quarter turns of the images, and the floor of the sample in turned images, searched
            without a prior.
        record: Record of the prior.
        plane: The prior.
    """
    for quarters, found in each:
        if found is None or not found.shown_by(_MOST):
            continue
        shown, sample = turned_back(found.plane, quarters), _sample_text(found)
        height, pitch, roll = (float(part[0]) for part in shown[:3])
        flags = f"--ground.camera-height-m {height:.2f} --ground.camera-pitch "
        flags += f"{math.degrees(pitch):z.0f}deg --ground.camera-roll {math.degrees(roll):z.0f}deg"
        if quarters == 0 and (fault := _tf_fault(shown, plane, flags)):
            message = f"without transforms, {sample}; with them, {record.message}"
            return _estimate(found, shown, message), shown, f"{fault} ({sample})"
        if quarters == 2 and height < _LOW_M and record.source == "none":
            text = f"the camera is taken to be mounted upside down ({flags}): turned over, {sample}"
            return _estimate(found, shown, sample), shown, text
        turned = "turned, " if quarters else ""
        return record, plane, f"if the camera is mounted so, pass {flags}: {turned}{sample}"
    return record, plane, ""


def _tf_fault(shown: GroundPlane, plane: GroundPlane, flags: str) -> str:
    """Return the fault of a mount from TF as text; empty if the plane may not be the floor.

    The base frame may be above the floor, or the camera may be tilted in another way.

    Args:
        shown: Plane in the images, ``B = 1``.
        plane: Floor by TF.
        flags: Flags that set the mount according to the images.
    """
    lower, *tilts = (float(a[0] - b[0]) for a, b in zip(shown[:3], plane[:3], strict=True))
    parallel = max(map(abs, tilts)) <= _PARALLEL_RAD
    if parallel and lower >= 0:
        text = f"the floor is {lower:.2f} m lower than z = 0 of the robot's base frame, and is used"
        return f"{text}; name the frame on the floor with --log.base-frame"
    if parallel or abs(lower) > _SAME_HEIGHT * shown.height[0]:
        return ""
    stated, own = (
        f"{math.degrees(one.pitch[0]):z.1f}° down, rolled by {math.degrees(one.roll[0]):z.1f}°"
        for one in (plane, shown)
    )
    steep = math.radians(STEEP_DEG) < max(map(abs, tilts))
    remedy = "name the optical frame with --log.camera-frame" if steep else "correct the transforms"
    text = f"by its transforms the camera looks {stated}; its images show the floor of a camera "
    return f"{text}{own}, which is used; {remedy}, or pass {flags}"


def _estimate(found: SampledFloor, plane: GroundPlane, message: str) -> GroundRecord:
    """Return the record of a plane that was estimated from a sample."""
    record = _record("estimate", plane, message)
    return replace(record, height_spread_m=found.height_spread_m, frames_used=found.decided)


def _record(source: str, plane: GroundPlane, message: str = "") -> GroundRecord:
    """Return a prior ``plane`` (``B = 1``) as it is recorded in the results."""
    height, pitch, roll = (float(part[0]) for part in (plane.height, plane.pitch, plane.roll))
    return GroundRecord(source, None, height, pitch, roll, message=message)


def _sample_text(found: SampledFloor) -> str:
    text = f"{found.decided} of {found.looked_at} sampled frames show their floor"
    if np.isnan(found.height_spread_m):
        return text
    degrees = np.degrees(found.angle_spread_rad)
    return f"{text}, within {found.height_spread_m * 100:.1f} cm and {degrees:.1f}° of the median"


def _with_prior(prior: GroundRecord, text: str) -> str:
    """Return a text followed by the values and the message of a prior."""
    if prior.height_m is None:
        return text
    pitch, roll = np.degrees([prior.pitch_rad or 0.0, prior.roll_rad or 0.0])
    about = f"{prior.source}: {prior.height_m:.3f} m up, {pitch:.1f}° down, roll {roll:+.1f}°"
    return "; ".join(part for part in (text, about, prior.message) if part)
