"""Which floor each frame has: the user's, the robot's (TF), an estimate, or none.

The plane, and in time windows a ramp ahead, is decided before the frames of a log (or of a fixed
time window of it) are looked at, and never carried from frame to frame, so results do not depend
on how a run is split.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from jaxdet.config import Config
from jaxdet.errors import InputError
from jaxdet.pipeline import BackendName, estimate_plane, estimate_ramp
from jaxdet.plane import (
    flagged_plane,
    join_planes,
    plane_from_transform,
    repeat_plane,
    unknown_plane,
)
from jaxdet.types import GroundPlane

if TYPE_CHECKING:
    from jaxdet.io import Log

MIN_HEIGHT_M, MAX_HEIGHT_M = 0.02, 20.0
"""Camera heights that a TF tree is believed for; a base frame in the camera has none."""


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
    inlier_share: float | None = None
    """Share of the sampled points that lie on the floor (estimate)."""
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

    def of(self, stamp_ns: np.ndarray) -> GroundPlane:
        """The plane of each frame with these stamps ``(B,)`` int64."""
        if not self.window_ns:
            return repeat_plane(self.windows[0], stamp_ns.size)
        keys = (stamp_ns // self.window_ns).tolist()
        each = [self.windows.get(key, self.otherwise) for key in keys]
        return join_planes(each)


def decide_planes(log: "Log", config: Config, backend: BackendName) -> Planes:
    """The floor of a log, in the order flags, TF, estimate, none.

    Args:
        log: An open log.
        config: ``config.ground`` says which source is wanted.
        backend: Backend that aligns the sampled depth images.

    Returns:
        The planes, with records and warnings for the summary.

    Raises:
        InputError: ``ground.source`` is tf and the log has no usable transform.
    """
    ground = config.ground
    if ground.source == "none":
        return Planes((GroundRecord("none", message="asked for"),), {0: unknown_plane(1)})
    if ground.camera_height_m is not None and ground.source in ("auto", "flags"):
        return _known(log, "flags", flagged_plane(ground), config, backend)
    warnings: tuple[str, ...] = ()
    if ground.source in ("auto", "tf"):
        plane, problem = _plane_from_tf(log)
        if plane is not None:
            message = f"{log.base_frame} to the colour camera"
            return _known(log, "tf", plane, config, backend, message)
        if ground.source == "tf":
            raise InputError(problem, path=log.name, remedy="give --ground.camera-height-m")
        warnings = (problem,) if log.T_base_camera is not None else ()
    return _estimated(log, config, backend, warnings)


def _known(
    log: "Log",
    source: str,
    plane: GroundPlane,
    config: Config,
    backend: BackendName,
    message: str = "",
) -> Planes:
    """A plane that needs no estimate; in time windows, ramps ahead are looked for."""
    level = _record(source, plane, message)
    if not config.ground.window_s:
        return Planes((level,), {0: plane})

    def look(sample: np.ndarray) -> tuple[GroundRecord, GroundPlane]:
        frames = log.read(sample.tolist()).frames
        if not frames.valid.any():
            return _record(source, plane, "no sampled frame could be read, no ramp seen"), plane
        frames = frames._replace(plane=repeat_plane(plane, len(frames.valid)))
        found = estimate_ramp(frames, config, backend=backend)
        return _record(source, found, message), found

    records, windows = _in_windows(log, config, look)
    window_ns = round(config.ground.window_s * 1e9)
    return Planes(tuple(records) or (level,), windows, window_ns, otherwise=plane)


def _record(source: str, plane: GroundPlane, message: str) -> GroundRecord:
    height, pitch, roll, _, start, slope = (float(part[0]) for part in plane)
    ramp = (start, slope) if np.isfinite(start) else (None, None)
    return GroundRecord(source, None, height, pitch, roll, *ramp, message=message)


def _in_windows(
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


def _plane_from_tf(log: "Log") -> tuple[GroundPlane | None, str]:
    if log.T_base_camera is None:
        return None, "no transform from the robot's base to the colour camera"
    plane = plane_from_transform(log.T_base_camera)
    height = float(plane.height[0])
    if not MIN_HEIGHT_M <= height <= MAX_HEIGHT_M:
        return None, f"the TF camera height of {height:.3f} m above {log.base_frame} is not used"
    return plane, ""


def _estimated(
    log: "Log", config: Config, backend: BackendName, warnings: tuple[str, ...]
) -> Planes:
    window_ns = round(config.ground.window_s * 1e9)
    records, windows = _in_windows(
        log, config, lambda sample: _estimate(log, sample, config, backend)
    )
    unknown = sum(record.source == "none" for record in records)
    if unknown or not records:
        where = f" in {unknown} of {len(records)} time windows" if window_ns else ""
        reason = next((r.message for r in records if r.source == "none"), "no frame has depth")
        problem = f"no floor was found{where} ({reason}): nothing is dropped as floor there"
        warnings = (*warnings, f"{problem}; give --ground.camera-height-m")
    return Planes(
        tuple(records) or (GroundRecord("none", message="no frame has depth"),),
        windows if window_ns else {0: unknown_plane(1), **windows},
        window_ns,
        warnings,
    )


def _estimate(
    log: "Log", sample: np.ndarray, config: Config, backend: BackendName
) -> tuple[GroundRecord, GroundPlane]:
    frames = log.read(sample.tolist()).frames
    if not frames.valid.any():
        return GroundRecord("none", message="no sampled frame could be read"), unknown_plane(1)
    found = estimate_plane(frames, config, backend=backend)
    if not found.plane.valid[0]:
        record = GroundRecord("none", frames_used=found.frames_used, message=found.message)
        return record, unknown_plane(1)
    record = replace(
        _record("estimate", found.plane, found.message),
        height_spread_m=float(found.height_spread_m),
        inlier_share=float(found.inlier_share),
        frames_used=int(found.frames_used),
    )
    return record, found.plane


def evenly(values: np.ndarray, count: int) -> np.ndarray:
    """At most ``count`` of ``values``, evenly spaced, the first and the last among them."""
    if values.size <= count:
        return values
    return values[np.linspace(0, values.size - 1, count).round().astype(np.int64)]
