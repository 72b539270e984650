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
    """Interface of a backend, implemented by :mod:`jaxdet.reference` and :mod:`jaxdet.stages`.

    The results of both are equal to the bit.
    """

    def detect(
        self, frames: Frames, plane: GroundPlane, config: Config, with_cells: bool = False
    ) -> Detections: ...
    def find_floors(self, frames: Frames, prior: GroundPlane, config: Config) -> "FloorFit": ...


def load_backend(name: BackendName) -> Backend:
    """Return the module that implements a backend.

    Raises:
        ConfigError: The backend is unknown, or JAX can't be used in this process.
    """
    modules = {"reference": "jaxdet.reference", "jax": "jaxdet.stages"}
    if not isinstance(name, str) or name not in modules:
        remedy = f"use one of {', '.join(modules)}"
        raise ConfigError(f"unknown backend {named_type(name)}", remedy=remedy)
    if name == "jax":
        check_not_forked()
        start_warp()  # keeps Warp's banner out of standard output
    return cast(Backend, import_module(modules[name]))


def check_not_forked() -> None:
    """Check that this process can use JAX.

    Raises:
        ConfigError: It was forked from one that used JAX.
    """
    if process_that_used("JAX") != os.getpid():
        problem = "JAX can't be used in a process forked from one that used it"
        remedy = "start processes with spawn, or use the backend reference"
        raise ConfigError(problem, remedy=remedy)


@cache
def process_that_used(_what: str) -> int:
    """Return the id of the process that first called this function with ``_what``.

    Forked children inherit it.
    """
    return os.getpid()


def detect(
    frames: Frames,
    config: Config | None = None,
    *,
    backend: BackendName = "jax",
    with_cells: bool = False,
) -> Detections:
    """Detect the obstacles in a batch of frames.

    Only depth is used, except by the preset ``paper`` (``config.cluster.points``), which also uses
    colour.

    Args:
        frames: ``B`` frames, see :class:`jaxdet.types.Frames`. Their ``plane`` is the prior of the
            floor; if it is None, the configuration's camera height, pitch and roll are used. The
            depth of each frame corrects the prior, or determines the floor if there is no prior.
            The preset ``paper`` uses the plane unchanged (:func:`estimate_plane` computes one). If
            ``config.ground.source`` is ``none``, no floor is estimated.
        config: Configuration of the method; by default the preset ``wheeled``.
        backend: ``jax`` for the compiled program, ``reference`` for NumPy. Both return equal
            arrays.
        with_cells: Whether to also return the depth cells with their obstacles
            (:attr:`jaxdet.types.Detections.cells`); not available in the preset ``paper``.

    Returns:
        Obstacles of each frame, see :class:`jaxdet.types.Detections`. With ``jax`` they are JAX
        arrays that may still be computed asynchronously. On the CPU, large batches, and those of 9
        or more frames whose number is not a power of two, are computed in several calls
        (:func:`jaxdet.stages._batches.in_parts`) and return NumPy arrays.

    Raises:
        CalibrationError: The calibration is invalid, or images differ in size from their camera.
        InputError: The numbers of images and planes differ, or the preset ``paper`` lacks colour or
            a plane.
        ConfigError: The backend is unknown, or the kernels do not support the image size.
    """
    config = _checked(config)
    of_type("with_cells", with_cells, bool)
    check_frames(frames, config)
    prior = floor_prior(frames, config)
    return load_backend(backend).detect(frames, prior, config, with_cells)


def detect_on_cpu(frames: Frames, config: Config, *, backend: BackendName) -> Detections:
    """Detect obstacles as :func:`detect` does, with cells or points, without loading JAX.

    This function is meant for a few frames, for instance for pictures. The preset ``paper``, whose
    program needs JAX, is computed by the reference.

    Args:
        frames: ``B`` frames on the host.
        config: Configuration of the method.
        backend: ``jax`` for the kernels of the default method, ``reference`` for NumPy.

    Returns:
        NumPy arrays, equal to those of :func:`detect`.
    """
    config = _checked(config)
    check_frames(frames, config)
    prior = floor_prior(frames, config)
    if backend == "reference" or config.cluster.points:
        return load_backend("reference").detect(frames, prior, config, True)
    load_backend(backend)
    from jaxdet.stages import detect_on_cpu as by_kernels

    return by_kernels(frames, prior, config)


def find_floors(
    frames: Frames, config: Config | None = None, *, backend: BackendName = "jax"
) -> "FloorFit":
    """Estimate the floor from the depth of each frame, as :func:`detect` does.

    Args:
        frames: ``B`` frames; if ``plane`` is None, the prior is the configuration's.
        config: Configuration of the method; by default the preset ``wheeled``.
        backend: ``jax`` for the compiled kernels, which run on the CPU and do not load JAX;
            ``reference`` for NumPy. The results are equal.

    Returns:
        Planes, and the reason if a frame's own depth does not determine its plane, see
        :class:`jaxdet.floor.units.FloorFit`.

    Raises:
        CalibrationError: The calibration is invalid, or images differ in size from their camera.
        InputError: The numbers of images and planes differ.
    """
    config = _checked(config)
    check_frames(frames, config, floor_only=True)
    return load_backend(backend).find_floors(frames, floor_prior(frames, config), config)


def _checked(config: Config | None) -> Config:
    """Return the configuration, or the default.

    If ``ground.source`` is none, the depth range of the floor estimate is set to 0, which disables
    it.
    """
    if config is not None and not isinstance(config, Config):
        remedy = "pass a Config, for instance jaxdet.preset('wheeled')"
        raise ConfigError(f"expected a Config, got {named_type(config)}", remedy=remedy)
    config = config or Config()
    if config.ground.source != "none":
        return config
    return replace(config, floor=replace(config.floor, max_depth_m=0.0))


def estimate_plane(
    frames: Frames, config: Config | None = None, *, backend: BackendName = "jax"
) -> SampledFloor:
    """Estimate one floor plane for all frames from their depth.

    Args:
        frames: ``B`` frames of one camera in a fixed pose on the robot; their plane is ignored.
        config: Configuration of the floor estimate; by default the preset ``wheeled``.
        backend: Backend; the results are equal.

    Returns:
        Median of the floors found in the frames, see :class:`jaxdet.floor.sampled.SampledFloor`;
        not valid if too few frames show the floor.
    """
    check_frames(frames, _checked(config), floor_only=True)
    unknown = unknown_plane(len(frames.depth))
    fit = find_floors(frames._replace(plane=unknown), config, backend=backend)
    shown = GroundPlane(*(np.asarray(a)[frames.valid] for a in fit.plane))
    return sampled_floor(shown, fit.own[frames.valid])
