"""Obstacles made of surfaces, measured and outlined on their cells.

Twin of ``jaxdet/reference/_outlines.py`` and of ``footprint_on_floor`` in ``_footprint.py``.
"""

import numpy as np

from jaxdet.camera import cell_side, corner_rays
from jaxdet.config import Config
from jaxdet.floor.plane import band_table, direction_table
from jaxdet.stages import _align
from jaxdet.stages._tables import Tables, kernel_tables
from jaxdet.types import Calibration
from jaxdet_kernels.align import PARAMETERS


def tables(calibration: Calibration, config: Config) -> Tables:
    """The tables of a camera and a configuration, on the host."""
    unit, footprint = calibration.depth_unit, config.footprint
    vertex, long = (round(m / unit) for m in (footprint.vertex_threshold_m, footprint.long_m))
    image, camera = calibration.image, calibration.depth
    found = kernel_tables(
        bands=band_table(footprint, unit),
        directions=direction_table(),
        outline_settings=(footprint.trim, vertex, long),
        last=(image.width - 1, image.height - 1),
    )
    if calibration.is_aligned:
        return found | {"parameters": np.zeros(PARAMETERS + 2, np.float32)}
    side = cell_side(camera, config.surface.cell_rad)
    corners = tuple(slice(0, n // side * side + 1, side) for n in (camera.height, camera.width))
    x, y = (rays[corners] for rays in corner_rays(camera))
    return found | {"corner_x": x, "corner_y": y, "parameters": _align.parameters(calibration)}
