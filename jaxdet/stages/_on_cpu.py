"""Kernels on the CPU without JAX, because to load JAX takes longer than to process a few frames."""

import numpy as np

from jaxdet.config import Config
from jaxdet.floor.units import FloorFit, floor_fit
from jaxdet.runtime.compiled import load_for_cpu
from jaxdet.stages import _program
from jaxdet.stages._check import check_kernels
from jaxdet.types import Detections, Frames, GroundPlane


def find_floors(frames: Frames, prior: GroundPlane, config: Config) -> FloorFit:
    """Estimate the floors; twin of :func:`jaxdet.reference.find_floors`.

    Raises:
        ConfigError: The kernels do not support images or grids of this size.
        JaxdetError: The kernels can't be compiled.
    """
    _load()
    rows, _ = _program.run("cpu", frames, prior, config, _program.FLOOR_STEPS, keep_work=False)
    found = _program.record_layout().take(rows.record, "floor")
    return floor_fit(found, prior, frames.calibration.depth_unit)


def detect_on_cpu(frames: Frames, prior: GroundPlane, config: Config) -> Detections:
    """Detect obstacles, with cells; twin of :func:`jaxdet.reference.detect`, but not for ``paper``.

    Raises:
        ConfigError: The kernels do not support images or grids of this size.
        JaxdetError: The kernels can't be compiled.
    """
    _load()
    given = frames, prior, config, len(_program.STEPS)
    rows, static = _program.run("cpu", *given, keep_work=True)
    return _program.detections(rows, static, True, np, prior)


def _load() -> None:
    load_for_cpu(_program.kernels)
    check_kernels("cpu")
