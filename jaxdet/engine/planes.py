"""Which floor each frame has: the user's, the robot's (TF), an estimate, or none.

The plane, and in time windows a ramp ahead, is decided before the frames of a log (or of a fixed
time window of it) are looked at, and never carried from frame to frame, so results do not depend
on how a run is split. With surfaces it is a prior, which each frame's own depth then corrects.
"""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from jaxdet.config import Config, GroundConfig
from jaxdet.engine.ground import GroundRecord, Planes, in_windows, record_of
from jaxdet.engine.prior import prior_of
from jaxdet.errors import InputError
from jaxdet.pipeline import BackendName, estimate_plane, estimate_ramp
from jaxdet.plane import flagged_plane, plane_from_transform, repeat_plane, unknown_plane
from jaxdet.types import GroundPlane

if TYPE_CHECKING:
    from jaxdet.io import Log

MIN_HEIGHT_M, MAX_HEIGHT_M = 0.02, 20.0
"""Camera heights that a TF tree is believed for; a base frame in the camera has none."""


def decide_planes(log: "Log", config: Config, backend: BackendName) -> Planes:
    """The floor of a log, in the order flags, TF, estimate, none.

    With surfaces (``config.surface``) it is the prior of each frame's floor. Then a sample of the
    frames is looked at first, each for itself, and the median of the floors that they show takes
    the place of what flags or TF say, as mounts are not always as they are said to be. Where
    neither says anything it is the prior only of a camera that keeps its place, see
    :class:`jaxdet.engine.sampled_floor.SampledFloor`; else each frame is searched alone.

    Args:
        log: An open log.
        config: ``config.ground`` says which source is wanted.
        backend: Backend that aligns the sampled depth images.

    Returns:
        The planes, with records and warnings for the summary.

    Raises:
        InputError: ``ground.source`` is tf and the log has no usable transform.
    """
    if config.ground.source == "none":
        return Planes((GroundRecord("none", message="asked for"),), {0: unknown_plane(1)})
    known, plane, warnings = _stated(log, config.ground)
    if config.surface.cell_rad:
        return prior_of(log, known, plane, config, warnings)
    if known.source != "none":
        return _known(log, known, plane, config, backend)
    return _estimated(log, config, backend, warnings)


def _stated(log: "Log", ground: GroundConfig) -> tuple[GroundRecord, GroundPlane, tuple[str, ...]]:
    """What flags or TF say, with warnings; of source ``none`` where they say nothing."""
    if ground.camera_height_m is not None and ground.source in ("auto", "flags"):
        plane = flagged_plane(ground)
        return record_of("flags", plane), plane, ()
    nothing = GroundRecord("none"), unknown_plane(1)
    if ground.source not in ("auto", "tf"):
        return *nothing, ()
    plane, problem = _plane_from_tf(log)
    if plane is not None:
        return record_of("tf", plane, f"{log.base_frame} to the colour camera"), plane, ()
    if ground.source == "tf":
        raise InputError(problem, path=log.name, remedy="give --ground.camera-height-m")
    return *nothing, (problem,) if log.T_base_camera is not None else ()


def _known(
    log: "Log", known: GroundRecord, plane: GroundPlane, config: Config, backend: BackendName
) -> Planes:
    """A plane that needs no estimate; in time windows, ramps ahead are looked for."""
    if not config.ground.window_s:
        return Planes((known,), {0: plane})

    def look(sample: np.ndarray) -> tuple[GroundRecord, GroundPlane]:
        frames = log.read(sample.tolist()).frames
        if not frames.valid.any():
            message = "no sampled frame could be read, no ramp seen"
            return replace(known, message=message), plane
        frames = frames._replace(plane=repeat_plane(plane, len(frames.valid)))
        found = estimate_ramp(frames, config, backend=backend)
        return record_of(known.source, found, known.message), found

    records, windows = in_windows(log, config, look)
    window_ns = round(config.ground.window_s * 1e9)
    return Planes(tuple(records) or (known,), windows, window_ns, (), plane, known.source)


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
    records, windows = in_windows(
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
        record_of("estimate", found.plane, found.message),
        height_spread_m=float(found.height_spread_m),
        inlier_share=float(found.inlier_share),
        frames_used=int(found.frames_used),
    )
    return record, found.plane
