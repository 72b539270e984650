"""Free floor of obstacles made of surfaces. Twin of ``jaxdet/reference/_free.py``."""

from jaxdet.config import Config
from jaxdet.floor.plane import quadratic_table
from jaxdet.stages._tables import Tables, kernel_tables


def tables(config: Config, depth_unit: float) -> Tables:
    """The tables of a configuration, on the host."""
    floor, ground = config.floor, config.ground
    bows = quadratic_table(ground.step_height_m, floor.bow_per_m, depth_unit)
    drops = quadratic_table(floor.drop_m, floor.noise_per_m, depth_unit)
    settings = [round(m / depth_unit) for m in (ground.max_depth_m, floor.gap_m)]
    return kernel_tables(bows=bows, drops=drops, free_settings=settings)
