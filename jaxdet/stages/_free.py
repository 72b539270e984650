"""Free floor of obstacles made of surfaces. Twin of ``jaxdet/reference/_free.py``, ``_rays.py``."""

from jaxdet.config import Config
from jaxdet.floor.plane import depth_range, max_height, quadratic_table, step_height
from jaxdet.floor.rays import bearing_table, half_cell, half_turn, ray_directions
from jaxdet.stages._tables import Tables, kernel_tables
from jaxdet.types import Calibration


def tables(calibration: Calibration, config: Config) -> Tables:
    """The tables of a camera and a configuration, on the host."""
    floor, ground, unit = config.floor, config.ground, calibration.depth_unit
    bows = quadratic_table(ground.step_height_m, floor.bow_per_m, unit)
    drops = quadratic_table(floor.drop_m, floor.noise_per_m, unit)
    lengths = [round(m / unit) for m in (ground.max_depth_m, floor.gap_m)]
    bounds = depth_range(ground.min_depth_m, ground.max_depth_m, unit)
    pixel = step_height(calibration, config, side=1)
    half = half_cell(calibration.depth, config.surface.cell_rad)
    above = max_height(ground, unit), half, half_turn(half), pixel.noise
    return kernel_tables(
        bows=bows,
        drops=drops,
        pixel_rises=pixel.table,
        free_settings=(*lengths, *bounds, *above),
        bearings=bearing_table(),
        ray_directions=ray_directions(),
    )
