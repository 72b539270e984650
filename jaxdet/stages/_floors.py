"""Floor estimation on the CPU, without JAX, whose start takes longer than finding a few floors."""

from functools import lru_cache

import numpy as np
import warp as wp

from jaxdet.config import Config
from jaxdet.floor.units import FloorFit, floor_fit
from jaxdet.runtime.compiled import load_for_cpu
from jaxdet.stages import _program
from jaxdet.stages._check import check_kernels
from jaxdet.stages._program import Static, record_layout
from jaxdet.types import Calibration, Frames, GroundPlane


def find_floors(frames: Frames, prior: GroundPlane, config: Config) -> FloorFit:
    """Estimate the floors; twin of :func:`jaxdet.reference.find_floors`.

    Raises:
        ConfigError: The kernels do not support images or grids of this size.
        JaxdetError: The kernels can't be compiled.
    """
    tables, static = _tables(frames.calibration, config)
    unit, batch = frames.calibration.depth_unit, len(frames.depth)
    given = frames.depth, _program.floors(prior, config, unit), tables
    record, contour, _ = static.words()
    found = np.zeros((batch, record), np.int32)
    made = found, np.zeros((batch, contour), np.int32), np.zeros((1, 1), np.int32)
    arrays = [
        wp.array(a, dtype=wp.dtype_from_numpy(a.dtype), device="cpu", copy=False)
        for a in map(np.ascontiguousarray, (*given, *made))
    ]
    _program.launch(arrays, None, 0, _program.FLOOR_STEPS, static)
    return floor_fit(record_layout().take(found, "floor"), prior, unit)


@lru_cache(maxsize=8)
def _tables(calibration: Calibration, config: Config) -> tuple[np.ndarray, Static]:
    load_for_cpu(_program.kernels)
    check_kernels("cpu")
    tables = _program.packed(*_program.host_tables(calibration, config), "cpu")
    return tables, Static.of(tables)
