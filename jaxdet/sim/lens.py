"""What is wrong with whole regions of a depth image: bowed, bent, torn, mirrored, seen through.

Errors are errors of the disparity d = f B / z, so they grow with z^2 in depth.
"""

import numpy as np

from jaxdet.sim.patches import chosen, patches
from jaxdet.sim.stereo import DepthSensor, Surface

FAR_M = 4.0
"""Where ``DepthSensor.bow`` is stated [m]."""


def bend(
    shape: tuple[int, ...],
    constant: float,
    sensor: DepthSensor,
    rng: np.random.Generator,
    specimen: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Errors of the disparity that hang together, and where margins have no depth.

    The bow is ``bow f B / 4 m`` in the corners times a form that a camera keeps: a bowl and a
    twist, their signs and parts drawn. In the margins the error grows from 0 at their inner end to
    the outer one as a square.

    Args:
        shape: H, W.
        constant: f B [m pixel].
        sensor: How it errs.
        rng: Random numbers of the frame.
        specimen: Which camera of its kind it is.

    Returns:
        ``(H, W)`` float64 [pixel] and ``(H, W)`` bool.
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
    """Which surface is matched where floors mirror and panes are clear.

    Args:
        z: ``(H, W)`` float, ideal depth [m].
        surface: What the surfaces look like.
        sensor: How it errs.
        rng: Random numbers.

    Returns:
        ``(H, W)`` float, depth of what is matched [m]; ``(H, W)`` bool, no depth; ``(H, W)`` bool,
        a mirror image, which is matched however bare the floor is.
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
