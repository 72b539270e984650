"""The kernels on the CPU without JAX, whose start takes longer than processing a few frames."""

from functools import lru_cache

import numpy as np

from jaxdet.config import Config
from jaxdet.floor.units import FloorFit, floor_fit
from jaxdet.runtime.compiled import load_for_cpu
from jaxdet.stages import _program
from jaxdet.stages._check import check_kernels
from jaxdet.stages._program import Rows, Static, record_layout
from jaxdet.types import Calibration, Detections, Frames, GroundPlane


def find_floors(frames: Frames, prior: GroundPlane, config: Config) -> FloorFit:
    """Estimate the floors; twin of :func:`jaxdet.reference.find_floors`.

    Raises:
        ConfigError: The kernels do not support images or grids of this size.
        JaxdetError: The kernels can't be compiled.
    """
    rows, _ = _run(frames, prior, config, _program.FLOOR_STEPS, keep_work=False)
    found = record_layout().take(rows.record, "floor")
    return floor_fit(found, prior, frames.calibration.depth_unit)


def detect_on_cpu(frames: Frames, prior: GroundPlane, config: Config) -> Detections:
    """Detect obstacles, with cells; twin of :func:`jaxdet.reference.detect`, but not for ``paper``.

    Raises:
        ConfigError: The kernels do not support images or grids of this size.
        JaxdetError: The kernels can't be compiled.
    """
    rows, static = _run(frames, prior, config, len(_program.STEPS), keep_work=True)
    found = _program.detections(rows, static, True, np)
    assert found.scene is not None
    return found._replace(scene=found.scene._replace(prior=prior))


def _run(
    frames: Frames, prior: GroundPlane, config: Config, steps: int, *, keep_work: bool
) -> tuple[Rows, Static]:
    """Run the first steps on all frames; return their results and the sizes of the program."""
    tables = _tables(frames.calibration, config)
    floors = _program.floors(prior, config, frames.calibration.depth_unit)
    given = frames.depth, floors, tables
    return _program.run("cpu", given, steps, keep_work=keep_work), Static.of(tables)


@lru_cache(maxsize=8)
def _tables(calibration: Calibration, config: Config) -> np.ndarray:
    load_for_cpu(_program.kernels)
    check_kernels("cpu")
    return _program.packed(*_program.host_tables(calibration, config), "cpu")
