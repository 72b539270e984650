"""What is known of each frame's floor: from the user, the robot (TF), or a sample of the log.

It is decided before the frames of a log (or of a fixed time window of it) are looked at, and never
carried from frame to frame, so results do not depend on how a run is split. Each frame's own depth
then corrects it.
"""

from dataclasses import replace
from typing import TYPE_CHECKING

from jaxdet.config import Config, GroundConfig
from jaxdet.engine.ground import GroundRecord, Planes, record_of
from jaxdet.engine.prior import prior_of
from jaxdet.errors import InputError
from jaxdet.floor.plane import flagged_plane, plane_from_transform, unknown_plane
from jaxdet.pipeline import BackendName
from jaxdet.types import GroundPlane

if TYPE_CHECKING:
    from jaxdet.io import Log

MIN_HEIGHT_M, MAX_HEIGHT_M = 0.02, 20.0
"""Camera heights that a TF tree is believed for; a base frame in the camera has none."""


def decide_planes(log: "Log", config: Config, backend: BackendName) -> Planes:
    """What is known of the floor of a log's frames, in the order flags, TF, none.

    A sample of the frames is looked at first, each for itself, and the median of the floors that
    they show takes the place of what flags or TF say, as mounts are not always as they are said to
    be. Where neither says anything it is the prior only of a camera that keeps its place, see
    :class:`jaxdet.floor.sampled.SampledFloor`; else each frame is searched alone.

    Args:
        log: An open log.
        config: ``config.ground`` says which source is wanted.
        backend: Backend that finds the floors.

    Returns:
        The planes, with records and warnings for the summary.

    Raises:
        InputError: ``ground.source`` is tf and the log has no usable transform.
    """
    if config.ground.source == "none":
        return Planes((GroundRecord("none", message="asked for"),), {0: unknown_plane(1)})
    known, plane, warnings = _stated(log, config.ground)
    planes = prior_of(log, known, plane, config, backend, warnings)
    unknown = sum(not one.valid[0] for one in planes.windows.values())
    if not config.cluster.points or not unknown:
        return planes
    where = f" in {unknown} of {len(planes.windows)} time windows" if planes.window_ns else ""
    problem = f"no floor was found{where}: nothing is dropped as floor there"
    return replace(planes, warnings=(*warnings, f"{problem}; give --ground.camera-height-m"))


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


def _plane_from_tf(log: "Log") -> tuple[GroundPlane | None, str]:
    if log.T_base_camera is None:
        return None, "no transform from the robot's base to the colour camera"
    plane = plane_from_transform(log.T_base_camera)
    height = float(plane.height[0])
    if not MIN_HEIGHT_M <= height <= MAX_HEIGHT_M:
        return None, f"the TF camera height of {height:.3f} m above {log.base_frame} is not used"
    return plane, ""
