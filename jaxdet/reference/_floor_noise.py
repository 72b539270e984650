"""Noise of the floor in a frame, which limits how low an obstacle can be."""

import numpy as np

from jaxdet.floor.frame import CAMERA_HEIGHT
from jaxdet.floor.plane import SLOPE_BITS, StepHeight
from jaxdet.reference._view import View

LEVELS = 16  # the maximum noise is divided into this many levels
TIMES, DIVISOR = 3, 2
"""The noise is ``TIMES / DIVISOR`` of the depth below the floor that few cells exceed."""
SHARE = 100  # at most one in SHARE floor cells may be deeper
LEAST = 200  # minimum number of floor cells
DEEPEST = 65535  # maximum depth of a cell


def noise_slope(
    view: View, step: StepHeight, floor: np.ndarray, nearest: int, farthest: int
) -> int:
    """Measure the noise of the floor, as a step height per depth.

    Noise lowers as many cells as it raises, but objects only raise them, so it is measured on the
    cells below the floor. Like the maximum noise it is proportional to depth; the result is the
    smallest of ``LEVELS`` levels that few cells exceed.

    Args:
        view: Positions of the cells of a frame.
        step: Step height of a cell.
        floor: Floor frame ``(13,)`` int32, from :func:`jaxdet.floor.frame.floor_frames`.
        nearest: Start of the range of depths [depth units].
        farthest: End of the range of depths [depth units].

    Returns:
        Step height due to noise per depth, with ``SLOPE_BITS`` fraction bits. It is the maximum if
        that does not exceed the step height anyway, as if the floor is unknown, or if fewer than
        ``LEAST`` cells show floor.
    """
    most, least = step.most_noise(int(floor[CAMERA_HEIGHT])), step.table[0]
    if min(farthest, DEEPEST) * most >> SLOPE_BITS <= least:
        return most
    noise = view.z * most >> SLOPE_BITS
    on = (view.z >= nearest) & (view.z <= farthest)
    on &= np.abs(view.height) <= np.maximum(noise, least)
    below, noise = -view.height[on], noise[on]
    if len(noise) < LEAST:
        return most
    for level in range(1, LEVELS):
        deeper = TIMES * LEVELS * below > DIVISOR * level * noise
        if SHARE * int(deeper.sum()) <= len(noise):
            return most * level // LEVELS
    return most
