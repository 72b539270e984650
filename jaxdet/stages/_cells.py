"""Tables of the step cells."""

from jaxdet.camera import cell_rays, cell_side
from jaxdet.config import SurfaceConfig
from jaxdet.floor.plane import quadratic_table
from jaxdet.stages._tables import Tables, kernel_tables
from jaxdet.types import Calibration


def tables(calibration: Calibration, config: SurfaceConfig) -> Tables:
    """The tables of a camera and a configuration, on the host.

    Raises:
        CalibrationError: The calibration can't be used.
    """
    side = cell_side(calibration.depth, config.cell_rad)
    steps = quadratic_table(config.step_m, config.step_per_m, calibration.depth_unit)
    return kernel_tables(near=steps, rays=cell_rays(calibration.depth, side))
