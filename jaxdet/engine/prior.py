"""The prior of each frame's floor; of clusters of points it is the floor.

Each frame's own depth corrects it, so it need not be exact; mounts are not always as they are said
to be, and frames that show little floor have nothing else.
"""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from jaxdet.config import Config
from jaxdet.engine.ground import GroundRecord, Planes, in_windows, record_of
from jaxdet.floor.plane import repeat_plane
from jaxdet.floor.sampled import SampledFloor, sampled_floor
from jaxdet.pipeline import BackendName, find_floors
from jaxdet.types import GroundPlane

if TYPE_CHECKING:
    from jaxdet.io import Log


def prior_of(
    log: "Log",
    known: GroundRecord,
    plane: GroundPlane,
    config: Config,
    backend: BackendName,
    warnings: tuple[str, ...] = (),
) -> Planes:
    """The prior of each frame's floor: what a sample shows, else what is known."""

    def look(sample: np.ndarray) -> tuple[GroundRecord, GroundPlane]:
        frames = log.read(sample.tolist()).frames
        if not frames.valid.any():
            return replace(known, message=_said(known, "no sampled frame could be read")), plane
        frames = frames._replace(plane=repeat_plane(plane, len(frames.valid)))
        fit = find_floors(frames, config, backend=backend)
        shown = GroundPlane(*(np.asarray(a)[frames.valid] for a in fit.plane))
        found = sampled_floor(shown, fit.own[frames.valid])
        message = _said(known, _sample_text(found))
        alone = not plane.valid[0] and not config.cluster.points
        if not (found.agrees if alone else found.plane.valid[0]):
            if alone:
                message = f"each frame is searched alone; {message}"
            return replace(known, frames_used=found.decided, message=message), plane
        record = replace(
            record_of("estimate", found.plane, message),
            height_spread_m=found.height_spread_m,
            frames_used=found.decided,
        )
        return record, found.plane

    records, windows = in_windows(log, config, look)
    window_ns = round(config.ground.window_s * 1e9)
    return Planes(
        tuple(records) or (replace(known, message=_said(known, "no frame has depth")),),
        windows if window_ns else {0: plane, **windows},
        window_ns,
        warnings,
        plane,
        known.source,
    )


def _sample_text(found: SampledFloor) -> str:
    text = f"{found.decided} of {found.looked_at} sampled frames show their floor"
    if np.isnan(found.height_spread_m):
        return text
    degrees = np.degrees(found.angle_spread_rad)
    return f"{text}, within {found.height_spread_m * 100:.1f} cm and {degrees:.1f}° of the median"


def _said(known: GroundRecord, text: str) -> str:
    """A message with what is known beside it."""
    if known.height_m is None:
        return text
    pitch, roll = np.degrees([known.pitch_rad or 0.0, known.roll_rad or 0.0])
    about = f"{known.source}: {known.height_m:.3f} m up, {pitch:.1f}° down, roll {roll:+.1f}°"
    return "; ".join(part for part in (text, about, known.message) if part)
