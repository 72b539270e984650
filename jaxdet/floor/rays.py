"""Tables of the rays of the free floor, for both backends: bearings and directions in integers."""

from functools import lru_cache
from math import ceil, pi

import numpy as np

from jaxdet.camera import cell_side
from jaxdet.elementary import arctangent, sin_cos
from jaxdet.types import RAYS, Intrinsics

UNITS = 16  # of a bearing, between neighbouring rays
TURN = RAYS * UNITS  # a full turn
RATIO_BITS = 12  # of the quotient that a bearing is read by
RAY_BITS = 13  # fraction bits of a direction
TURN_BITS = 13  # fraction bits of the sine of a small turn
MOST_HALF = 1 << 15  # of a cell's angle, so that its product with a depth has 31 bits


def half_cell(camera: Intrinsics, cell_rad: float) -> int:
    """Half of a cell's angle in bearing units, with four fraction bits."""
    wide = cell_side(camera, cell_rad) / min(camera.fx, camera.fy)
    return min(ceil(wide / 2 * (TURN / (2 * pi)) * 16), MOST_HALF)


def half_turn(half: int) -> int:
    """An angle of :func:`half_cell` in radians, with ``TURN_BITS`` fraction bits."""
    return round(half / 16 * (2 * pi / TURN) * (1 << TURN_BITS))


@lru_cache(maxsize=1)
def bearing_table() -> np.ndarray:
    """Angles up to an eighth of a turn, by tangent with ``RATIO_BITS``, in bearing units."""
    tangent = np.append((np.arange(1 << RATIO_BITS) + 0.5) / (1 << RATIO_BITS), 1.0)
    table = np.rint(arctangent(tangent) * (TURN / (2 * np.pi))).astype(np.int64)
    table.setflags(write=False)
    return table


@lru_cache(maxsize=1)
def ray_directions() -> np.ndarray:
    """Directions of the rays, and of the left edges of their sectors.

    Returns:
        ``(2, RAYS, 2)`` int64, right and forward with ``RAY_BITS`` fraction bits, read-only.
    """
    angle = (np.arange(RAYS) - RAYS // 2 - np.array([[0.0], [0.5]])) * (2 * np.pi / RAYS)
    table = np.rint(np.stack(sin_cos(angle), axis=-1) * (1 << RAY_BITS)).astype(np.int64)
    table.setflags(write=False)
    return table
