"""Free floor of obstacles made of surfaces. Twin of ``jaxdet/reference/_free.py``, ``_rays.py``."""

from jaxdet.camera import cell_rays, cell_side
from jaxdet.config import Config
from jaxdet.floor.plane import depth_range, max_height, quadratic_table
from jaxdet.floor.rays import (
    bearing_table,
    block_settings,
    half_turn,
    ray_directions,
    tile_corners,
)
from jaxdet.stages._tables import Tables, kernel_tables
from jaxdet.types import Calibration


def tables(calibration: Calibration, config: Config) -> Tables:
    """The tables of a camera and a configuration, on the host."""
    floor, ground, unit = config.floor, config.ground, calibration.depth_unit
    bows = quadratic_table(ground.step_height_m, floor.bow_per_m, unit)
    drops = quadratic_table(floor.drop_m, floor.noise_per_m, unit)
    lengths = [round(m / unit) for m in (ground.max_depth_m, floor.gap_m)]
    bounds = depth_range(ground.min_depth_m, ground.max_depth_m, unit)
    side = cell_side(calibration.depth, config.surface.cell_rad)
    half = half_turn(calibration.depth, side)
    made = kernel_tables(
        bows=bows,
        drops=drops,
        free_settings=(*lengths, *bounds, max_height(ground, unit), half),
        bearings=bearing_table(),
        ray_directions=ray_directions(),
        tile_corners=tile_corners(cell_rays(calibration.depth, side)),
    )
    return made | {"block_settings": block_settings(ground, unit)}
