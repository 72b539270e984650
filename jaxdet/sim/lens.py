"""Regional depth errors: bowing, bent margins, holes, mirrors and clear panes.

Errors are added to the disparity d = f B / z, so that in depth they grow with z^2.
"""

import numpy as np

from jaxdet.sim.patches import chosen, patches
from jaxdet.sim.stereo import DepthSensor, Surface

FAR_M = 4.0
"""Depth to which ``DepthSensor.bow`` refers [m]."""


def bend(
    shape: tuple[int, ...],
    constant: float,
    sensor: DepthSensor,
    rng: np.random.Generator,
    specimen: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the smooth disparity error, and the holes of the margins.

    The bowing is ``bow f B / 4 m`` times a shape that is constant for a camera: the sum of a bowl,
    a twist and a tilt with random signs and weights. In the margins the error grows quadratically
    from 0 at the inner end.

    Args:
        shape: Image size ``(H, W)``.
        constant: f B [m pixel].
        sensor: Error model.
        rng: Random generator of the frame.
        specimen: Seed of the systematic errors, which are constant for a camera.

    Returns:
        Error ``(H, W)`` float64 [pixel], and holes ``(H, W)`` bool.
    """
    own = np.random.default_rng([specimen, 5])
    y, x = (np.linspace(-1, 1, n) for n in shape)
    x, y = x[None, :], y[:, None]
    error, torn = np.zeros(shape), np.zeros(shape, bool)
    bowl, twist, tilt = own.choice([-1, 1]), *own.uniform(-1, 1, 2)
    sides = own.uniform(-0.3, 1.0, 2)
    if sensor.bow:
        form = bowl * (x * x + y * y - 0.7) / 1.3 + 0.5 * twist * x * y + 0.5 * tilt * x
        error = error + sensor.bow * constant / FAR_M * form / (1 + 0.5 * abs(twist))
    if sensor.waves_px:
        error = error + sensor.waves_px * patches(shape, max(shape[1] // 40, 1), rng)
    if sensor.margin:
        inside = (np.abs(x) - 1) / (2 * sensor.margin) + 1
        depth_in = np.clip(inside, 0, 1)
        side = np.where(x < 0, sides[0], sides[1])
        error = error + sensor.margin_bend_px * side * depth_in**2
        share = sensor.margin_dropout * np.minimum(2 * depth_in, 1) * np.ones(shape)
        torn = chosen(share, patches(shape, sensor.blotch_px, rng))
    return error, torn


def misread(
    z: np.ndarray, surface: Surface, sensor: DepthSensor, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Select the surface that stereo matching measures on reflective floors and clear panes.

    Args:
        z: Ideal depth ``(H, W)`` float [m].
        surface: Appearance of the surfaces.
        sensor: Error model.
        rng: Random generator.

    Returns:
        Depth of the matched surface ``(H, W)`` float [m]; holes ``(H, W)`` bool; mirror images
        ``(H, W)`` bool, which are matched regardless of the floor's texture.
    """
    lost, ghost = np.zeros((2, *z.shape), bool)
    if surface.mirrored is not None and sensor.reflection > 0:
        grazing = np.clip(1 - surface.facing, 0, 1) ** 2
        share = np.minimum(sensor.reflection * surface.gloss * grazing, 1)
        ghost = chosen(share, patches(z.shape, sensor.blotch_px, rng))
        ghost &= ~np.isnan(surface.mirrored)
        z = np.where(ghost, surface.mirrored, z)
        lost |= ghost & np.isinf(surface.mirrored)
    if surface.behind is not None:
        pane = ~np.isnan(surface.behind)
        lost |= pane & chosen(sensor.pane_holes, patches(z.shape, sensor.blotch_px, rng))
        z = np.where(pane, surface.behind, z)
    return z, lost, ghost
