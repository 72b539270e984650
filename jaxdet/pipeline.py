"""``detect``: floor, surfaces, obstacles and outlines of a batch of frames, on either backend."""

import os
from dataclasses import replace
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING, Literal, Protocol, cast

import numpy as np

from jaxdet.arguments import named_type, of_type
from jaxdet.checks import check_frames
from jaxdet.config import Config
from jaxdet.errors import ConfigError
from jaxdet.floor.plane import floor_prior, unknown_plane
from jaxdet.floor.sampled import SampledFloor, sampled_floor
from jaxdet.types import Detections, Frames, GroundPlane
from jaxdet.warp_start import start_warp

if TYPE_CHECKING:
    from jaxdet.floor.units import FloorFit

BackendName = Literal["reference", "jax"]


class Backend(Protocol):
    """A program for a batch; :mod:`jaxdet.reference` and :mod:`jaxdet.stages` both are one.

    Their results are equal to the bit.
    """

    def detect(
        self, frames: Frames, plane: GroundPlane, config: Config, with_cells: bool = False
    ) -> Detections: ...
    def find_floors(self, frames: Frames, prior: GroundPlane, config: Config) -> "FloorFit": ...


def load_backend(name: BackendName) -> Backend:
    """Return the module that implements a backend.

    Raises:
        ConfigError: The backend is unknown, or it is JAX in a process that can't use it.
    """
    modules = {"reference": "jaxdet.reference", "jax": "jaxdet.stages"}
    if not isinstance(name, str) or name not in modules:
        remedy = f"use one of {', '.join(modules)}"
        raise ConfigError(f"no backend {named_type(name)}", remedy=remedy)
    if name == "jax":
        if _process_of_jax() != os.getpid():
            problem = (
                "this process was forked from one that computed with JAX, and lacks its threads"
            )
            remedy = "start processes with spawn, or use the backend reference"
            raise ConfigError(problem, remedy=remedy)
        start_warp()  # standard output is the caller's
    return cast(Backend, import_module(modules[name]))


@cache
def _process_of_jax() -> int:
    """The first process that computes; where it is forked, the child has it too."""
    return os.getpid()


def detect(
    frames: Frames,
    config: Config | None = None,
    *,
    backend: BackendName = "jax",
    with_cells: bool = False,
) -> Detections:
    """Find the obstacles in a batch of frames.

    Only depth is read. The preset ``paper`` (``config.cluster.points``) reads colour too.

    Args:
        frames: ``B`` frames, see :class:`jaxdet.types.Frames`. Their ``plane`` is the prior of each
            frame's floor; where it is None, the configuration's camera height, pitch and roll are.
            The frame's own depth corrects it, and finds the floor where there is no prior; the
            preset ``paper`` takes the plane as it is (:func:`estimate_plane` makes one). With
            ``config.ground.source`` ``none`` there is no floor.
        config: Configuration of the method; by default the preset ``wheeled``.
        backend: ``jax`` for the compiled program or ``reference`` for plain NumPy; both return
            equal arrays.
        with_cells: Whether to return the depth cells with their obstacles as well
            (:attr:`jaxdet.types.Detections.cells`); the preset ``paper`` has none.

    Returns:
        The obstacles of each frame, see :class:`jaxdet.types.Detections`; with ``jax`` they are JAX
        arrays, perhaps still being computed, or on the CPU NumPy arrays of batches that are
        computed in parts, see :func:`jaxdet.stages._batches.in_parts`: larger ones, and those of 9
        frames or more whose number is no power of two.

    Raises:
        CalibrationError: The calibration can't be used, or images are not of its cameras' sizes.
        InputError: Numbers of images and planes differ, or the preset ``paper`` lacks colour or a
            plane.
        ConfigError: The backend is unknown, or images have a size that the kernels don't take.
    """
    config = _checked(config)
    of_type("with_cells", with_cells, bool)
    check_frames(frames, config)
    prior = floor_prior(frames, config)
    return load_backend(backend).detect(frames, prior, config, with_cells)


def find_floors(
    frames: Frames, config: Config | None = None, *, backend: BackendName = "jax"
) -> "FloorFit":
    """Find the floor in each frame's own depth, as :func:`detect` does.

    Args:
        frames: ``B`` frames; where ``plane`` is None, the prior is the configuration's.
        config: Configuration of the method; by default the preset ``wheeled``.
        backend: Either; the results are equal.

    Returns:
        The planes, and why a frame's own depth does not decide them, see
        :class:`jaxdet.floor.units.FloorFit`.

    Raises:
        CalibrationError: The calibration can't be used, or images are not of its cameras' sizes.
        InputError: Numbers of images and planes differ.
    """
    return load_backend(backend).find_floors(*_floor_arguments(frames, config))


def find_floors_without_jax(frames: Frames, config: Config | None = None) -> "FloorFit":
    """Find the same floors in a process that computes nothing else, without loading JAX.

    Args:
        frames: ``B`` frames; if ``plane`` is None, the prior is the configuration's.
        config: Configuration of the method; by default the preset ``wheeled``.

    Returns:
        The planes, computed by the kernels if they are compiled already, else by the reference.

    Raises:
        CalibrationError: The calibration can't be used, or images are not of its cameras' sizes.
        InputError: Numbers of images and planes differ.
    """
    from jaxdet.stages import find_floors_on_cpu

    arguments = _floor_arguments(frames, config)
    return find_floors_on_cpu(*arguments) or load_backend("reference").find_floors(*arguments)


def _floor_arguments(frames: Frames, config: Config | None) -> tuple[Frames, GroundPlane, Config]:
    """Check the frames, and return the arguments of a backend's ``find_floors``."""
    config = _checked(config)
    check_frames(frames, config, floor_only=True)
    return frames, floor_prior(frames, config), config


def _checked(config: Config | None) -> Config:
    """Return the configuration, or the default.

    With ``ground.source`` none no floor is searched: no cell is near enough to be part of it.
    """
    if config is not None and not isinstance(config, Config):
        remedy = "give a Config, for instance jaxdet.preset('wheeled')"
        raise ConfigError(f"config is {named_type(config)}", remedy=remedy)
    config = config or Config()
    if config.ground.source != "none":
        return config
    return replace(config, floor=replace(config.floor, max_depth_m=0.0))


def estimate_plane(
    frames: Frames, config: Config | None = None, *, backend: BackendName = "jax"
) -> SampledFloor:
    """Estimate the one floor that all these frames see, from their depth alone.

    Args:
        frames: ``B`` frames of one camera that keeps its place on the robot; their plane is not
            used.
        config: How floors are searched.
        backend: Either; the estimate is the same.

    Returns:
        The median of the floors that the frames show, see
        :class:`jaxdet.floor.sampled.SampledFloor`; not valid where too few do.
    """
    check_frames(frames, _checked(config), floor_only=True)
    unknown = unknown_plane(len(frames.depth))
    fit = find_floors(frames._replace(plane=unknown), config, backend=backend)
    shown = GroundPlane(*(np.asarray(a)[frames.valid] for a in fit.plane))
    return sampled_floor(shown, fit.own[frames.valid])
