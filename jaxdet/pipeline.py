"""``detect``: the paper's five steps over a batch of frames, on either backend."""

from dataclasses import replace
from importlib import import_module
from typing import TYPE_CHECKING, Any, Literal, Protocol, cast

import numpy as np

from jaxdet.camera import grid_pixels
from jaxdet.checks import check_frames, check_points
from jaxdet.config import Config, FeaturesConfig
from jaxdet.errors import ConfigError, InputError
from jaxdet.floor import PlaneEstimate, fit_floor, fit_ramp
from jaxdet.plane import flagged_plane, repeat_plane, unknown_plane
from jaxdet.types import (
    AlignedDepth,
    Calibration,
    Detections,
    Features,
    Frames,
    GroundPlane,
    Intrinsics,
    Keep,
    Labels,
    Obstacles,
)

if TYPE_CHECKING:
    from jaxdet.reference import FloorFit

BackendName = Literal["reference", "jax"]


class Backend(Protocol):
    """The five stages; :mod:`jaxdet.reference` and :mod:`jaxdet.stages` both are one."""

    def align(self, depth: np.ndarray, calibration: Calibration) -> AlignedDepth: ...
    def ground(
        self, aligned: AlignedDepth, plane: GroundPlane, calibration: Calibration, config: Config
    ) -> Keep: ...
    def features(
        self,
        color: np.ndarray,
        keep: Keep,
        calibration: Calibration,
        config: FeaturesConfig,
    ) -> Features: ...
    def cluster(self, features: Features, depth_unit: float, config: Config) -> Labels: ...
    def footprint(
        self,
        features: Features,
        labels: Labels,
        plane: GroundPlane,
        depth_unit: float,
        config: Config,
    ) -> Obstacles: ...


def load_backend(name: BackendName) -> Backend:
    """The module that implements the stages.

    Raises:
        ConfigError: There is no such backend.
    """
    modules = {"reference": "jaxdet.reference", "jax": "jaxdet.stages"}
    if name not in modules:
        raise ConfigError(f"no backend {name!r}", remedy=f"use one of {', '.join(modules)}")
    return cast(Backend, import_module(modules[name]))


def detect(
    frames: Frames, config: Config | None = None, *, backend: BackendName = "jax"
) -> Detections:
    """Finds the obstacles in a batch of frames.

    The floor of each frame is ``frames.plane``; where that is None, the configuration's camera
    height, pitch and roll; where those are unset, an estimate from these frames' depth
    (:func:`estimate_plane`), unless ``config.ground.source`` is ``none``. With surfaces
    (``config.surface``) the first two are what each frame's own depth corrects, and without them
    each frame is searched alone; with ``none`` none is.

    Args:
        frames: ``B`` frames, see :class:`jaxdet.types.Frames`.
        config: The method's parameters; by default the preset ``wheeled``.
        backend: ``jax`` for the jitted stages or ``reference`` for plain NumPy; both return
            equal arrays.

    Returns:
        Features, labels and obstacles of each frame, see :class:`jaxdet.types.Detections`; with
        ``jax`` they are JAX arrays, perhaps still being computed.

    Raises:
        CalibrationError: The calibration can't be used, or images are not of its cameras' sizes.
        InputError: There are not as many colour images, depth images and planes.
        ConfigError: The backend is unknown, a frame has too many feature slots, or colour images
            are smaller or larger than the kernels take.
    """
    config = config or Config()
    stages = load_backend(backend)
    calibration, unit = frames.calibration, frames.calibration.depth_unit
    check_frames(frames)
    check_points(slots_of(calibration.color, config.features))
    if config.surface.cell_rad:
        return _detect_surfaces(frames, config, backend)

    program = _program(stages, frames, config)
    if program is not None:
        return program

    aligned = stages.align(frames.depth, calibration)
    plane = _plane_of(frames, aligned, config)
    keep = stages.ground(aligned, plane, calibration, config)
    features = stages.features(frames.color, keep, calibration, config.features)
    labels = stages.cluster(features, unit, config)
    obstacles = stages.footprint(features, labels, plane, unit, config)

    return Detections(features, labels, obstacles, keep.has_depth)


def _detect_surfaces(frames: Frames, config: Config, backend: BackendName) -> Detections:
    """Obstacles made of surfaces, with the floor of each frame."""
    check_backend(config, backend)
    from jaxdet import reference

    return reference.detect(frames, floor_of(frames, config), _searching(config))


def check_backend(config: Config, backend: BackendName) -> None:
    """Refuses a backend that has no program for a configuration.

    Raises:
        ConfigError: There is none.
    """
    if config.surface.cell_rad and backend != "reference":
        raise ConfigError(
            f"obstacles made of surfaces have no program for backend {backend!r} yet",
            remedy="use --backend reference, or a preset without surfaces such as wheeled",
        )


def find_floors(frames: Frames, config: Config) -> "FloorFit":
    """Finds the floor in each frame's own depth, as :func:`detect` does with surfaces.

    Args:
        frames: ``B`` frames; where ``plane`` is None, the prior is the configuration's.
        config: ``surface.cell_rad`` is above 0.

    Returns:
        The planes, and why they are not the frames' own, see
        :class:`jaxdet.reference.FloorFit`.

    Raises:
        CalibrationError: The calibration can't be used, or images are not of its cameras' sizes.
        InputError: There are not as many images and planes.
    """
    from jaxdet import reference

    check_frames(frames)
    unit, config = frames.calibration.depth_unit, _searching(config)
    grid = reference.cells(frames.depth, frames.calibration, config.surface)
    prior = floor_of(frames, config)
    return reference.find_floor(grid.x, grid.y, grid.z, prior, config.floor, unit)


def _searching(config: Config) -> Config:
    """With ``ground.source`` none no floor is looked for: there are no cells to see it in."""
    if config.ground.source != "none":
        return config
    return replace(config, floor=replace(config.floor, max_depth_m=0.0))


def _program(stages: Backend, frames: Frames, config: Config) -> Detections | None:
    """The same five stages in one compiled program, where the backend has one for the frames."""
    covers = getattr(stages, "covers", None)
    if covers is None or not covers(frames):
        return None
    return cast(Any, stages).detect(frames, floor_of(frames, config), config)


def slots_of(camera: Intrinsics, config: FeaturesConfig) -> int:
    """``N``, how many points a frame can have: corners and the pixels of the grid."""
    grid, _ = grid_pixels(camera.width, camera.height, config.grid_columns)
    return config.max_corners + len(grid)


def floor_of(frames: Frames, config: Config, *, backend: BackendName = "jax") -> GroundPlane:
    """The floor of each frame as :func:`detect` takes it: given, configured or estimated.

    With surfaces it is what is known before the frames are looked at, not valid where nothing is.
    """
    plane = known_plane(frames, config)
    if plane is None and config.surface.cell_rad:
        plane = unknown_plane(len(frames.depth))
    if plane is None:
        found = estimate_plane(frames, _one_window(config), backend=backend)
        plane = repeat_plane(found.plane, len(frames.depth))
    return plane


def _plane_of(frames: Frames, aligned: AlignedDepth, config: Config) -> GroundPlane:
    """The floor of each frame: given, from the configuration, or estimated."""
    plane = known_plane(frames, config)
    if plane is None:
        found = _fit(frames, aligned, _one_window(config))
        plane = repeat_plane(found.plane, len(frames.depth))
    return plane


def _one_window(config: Config) -> Config:
    """A batch has no windows of time: one plane for all its frames, and no ramp."""
    return replace(config, ground=replace(config.ground, window_s=0.0))


def known_plane(frames: Frames, config: Config) -> GroundPlane | None:
    """The floor that needs no estimate, or None."""
    if frames.plane is not None:
        return frames.plane
    batch = len(frames.depth)
    if config.ground.camera_height_m is not None:
        return repeat_plane(flagged_plane(config.ground), batch)
    return unknown_plane(batch) if config.ground.source == "none" else None


def estimate_plane(
    frames: Frames, config: Config | None = None, *, backend: BackendName = "jax"
) -> PlaneEstimate:
    """Estimates the one floor that all these frames see, from their depth alone.

    Args:
        frames: ``B`` frames of one camera that keeps its place on the robot.
        config: For the depth range of its ground part; with time windows, these frames are one,
            and a ramp ahead is looked for too.
        backend: Which stages align the depth; the estimate is the same.

    Returns:
        The plane, not valid where no floor was found, see :func:`jaxdet.floor.fit_floor`.
    """
    aligned = load_backend(backend).align(frames.depth, frames.calibration)
    return _fit(frames, aligned, config or Config())


def estimate_ramp(
    frames: Frames, config: Config | None = None, *, backend: BackendName = "jax"
) -> GroundPlane:
    """Looks for the one ramp that all these frames see on their known floor.

    Args:
        frames: ``B`` frames of one camera that keeps its place; the plane is that of the first.
        config: For the depth range of its ground part.
        backend: Which stages align the depth; the result is the same.

    Returns:
        ``B = 1``, see :func:`jaxdet.floor.fit_ramp`.

    Raises:
        CalibrationError: The calibration can't be used, or images are not of its cameras' sizes.
        InputError: The frames have no plane, or not as many as images.
    """
    if frames.plane is None:
        raise InputError("frames without a plane", remedy="set it, or use estimate_plane")
    check_frames(frames)
    aligned = load_backend(backend).align(frames.depth, frames.calibration)
    z = np.asarray(aligned.z)[np.asarray(frames.valid)]
    plane = GroundPlane(*(a[:1] for a in frames.plane))
    return fit_ramp(z, plane, frames.calibration, (config or Config()).ground)


def _fit(frames: Frames, aligned: AlignedDepth, config: Config) -> PlaneEstimate:
    z = np.asarray(aligned.z)[np.asarray(frames.valid)]
    return fit_floor(z, frames.calibration, config.ground)
