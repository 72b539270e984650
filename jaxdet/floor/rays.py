"""Tables for the rays of the free floor, for both backends: bearings and directions in integers."""

from functools import lru_cache

import numpy as np

from jaxdet.config import GroundConfig
from jaxdet.elementary import arctangent, sin_cos
from jaxdet.types import RAYS, Intrinsics

UNITS = 16  # bearing units between neighbouring rays
TURN = RAYS * UNITS  # bearing units of a full turn
RATIO_BITS = 12  # fraction bits of the tangents in bearing_table
RAY_BITS = 13  # fraction bits of a direction
TURN_BITS = 13  # fraction bits of the sine of a small turn
TILE = 4  # rows of cells in a tile
# minimum depth of a notch in the free floor, and search depth for obstacles in it [m]
NOTCH_M = 0.3


def half_turn(camera: Intrinsics, side: int) -> int:
    """Return half of a cell's angle [rad], with ``TURN_BITS`` fraction bits.

    Args:
        camera: Depth camera.
        side: Side of a cell [pixel].
    """
    half = round(side / min(camera.fx, camera.fy) / 2 * (1 << TURN_BITS))
    return min(half, 1 << TURN_BITS)


def tile_corners(rays: np.ndarray) -> np.ndarray:
    """Compute the rays through the corners of tiles, ``TILE`` rows of a column of cells each.

    Corners of cells are halfway between cell centres, or extrapolated by half a cell.

    Args:
        rays: Rays through the centres of cells, ``(2, R, C)`` int64.

    Returns:
        Rays in the same units, ``(2, T + 1, C + 1)`` int64, for T tiles per column; the last tile
        may have fewer rows.

    Example:
        >>> tile_corners(np.array([[[0, 10, 20]], [[7, 7, 7]]]))[0].tolist()
        [[-5, 5, 15, 25], [-5, 5, 15, 25]]
    """
    wide = np.pad(rays, ((0, 0), (1, 1), (1, 1)), mode="reflect", reflect_type="odd")
    pairs = wide[:, :-1] + wide[:, 1:]
    corners = (pairs[:, :, :-1] + pairs[:, :, 1:]) >> 2
    rows = rays.shape[1]
    return corners[:, [*range(0, rows, TILE), rows]]


def block_settings(ground: GroundConfig, depth_unit: float) -> np.ndarray:
    """Return the coefficients of the step height of a single pixel, as in ``StepHeight``.

    Returns:
        Coefficients ``(3,)`` float32: constant [depth units]; growth with depth; and the step
        height due to noise per depth and camera height, a minimum [1/depth unit].
    """
    step, noise = ground.step_height_m / depth_unit, ground.noise_per_m * depth_unit
    return np.array([step, ground.step_height_per_m, noise], np.float32)


@lru_cache(maxsize=1)
def bearing_table() -> np.ndarray:
    """Tabulate angles up to an eighth of a turn by their tangent.

    Returns:
        Angles [bearing units] for tangents from 0 to 1, ``(2**RATIO_BITS + 1,)`` int64, read-only.
    """
    tangent = np.append((np.arange(1 << RATIO_BITS) + 0.5) / (1 << RATIO_BITS), 1.0)
    table = np.rint(arctangent(tangent) * (TURN / (2 * np.pi))).astype(np.int64)
    table.setflags(write=False)
    return table


@lru_cache(maxsize=1)
def ray_directions() -> np.ndarray:
    """Return the directions of the rays, and of the left edges of their sectors.

    Returns:
        Directions ``(2, RAYS, 2)`` int64, right and forward with ``RAY_BITS`` fraction bits,
        read-only.
    """
    angle = (np.arange(RAYS) - RAYS // 2 - np.array([[0.0], [0.5]])) * (2 * np.pi / RAYS)
    table = np.rint(np.stack(sin_cos(angle), axis=-1) * (1 << RAY_BITS)).astype(np.int64)
    table.setflags(write=False)
    return table
