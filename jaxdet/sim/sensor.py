"""From ideal pictures to what a stereo depth camera and a colour camera deliver.

The depth camera works in disparity d = f B / z, as the Intel D400 family does: its noise and
its steps are even in disparity, so they grow with z^2. Depth is that of the left imager.

Matching needs contrast. What there is of it: the surface's own (spread over mean in the matching
window) and the projector's dots, whose share of the light falls with z^2 and with the light of the
day. What spoils it: the imager's noise, which is large on dark surfaces, and gloss, which mirrors
the dots away. Where ``contrast / noise`` is too low there is a hole.
"""

import cv2
import numpy as np

from jaxdet.sim.lens import bend, misread
from jaxdet.sim.patches import patches, smooth_noise
from jaxdet.sim.stereo import DepthSensor, Surface
from jaxdet.types import Intrinsics


def measure_depth(
    z: np.ndarray,
    camera: Intrinsics,
    sensor: DepthSensor,
    rng: np.random.Generator,
    surface: Surface | None = None,
    specimen: int = 0,
) -> np.ndarray:
    """Make an ideal depth image a measured one.

    Args:
        z: ``(H, W)`` float, ideal depth [m], inf where there is none.
        camera: The depth camera (its left imager).
        sensor: How it errs.
        rng: Random numbers.
        surface: What the surfaces look like; None: all can be matched.
        specimen: Which camera of its kind it is: draws the errors that are always the same.

    Returns:
        ``(H, W)`` uint16 [mm], 0 where nothing is measured.
    """
    # What a default sensor draws does not depend on whether more is drawn.
    more = rng.spawn(1)[0]
    lost = ghost = np.zeros(z.shape, bool)
    if sensor.enabled and surface is not None:
        z, lost, ghost = misread(z, surface, sensor, more)
    seen = np.isfinite(z) & (z > 0)
    if sensor.enabled:
        constant = camera.fx * sensor.baseline_m
        ideal = np.divide(constant, z, out=np.zeros_like(z), where=seen)
        noise = sensor.noise_px * smooth_noise(z.shape, sensor.noise_size_px, rng)
        lost = lost | _dropouts(z.shape, sensor, rng)
        if surface is not None and sensor.contrast > 0:
            quality = match_quality(surface, z, sensor.projector_lux)
            spots = patches(z.shape, 8, rng)
            lost |= (quality < sensor.contrast * np.exp2(0.7 * spots)) & ~ghost
            noise *= 1 + np.minimum(sensor.contrast / np.maximum(quality, 1e-3), 1)
        ideal = fatten(ideal, sensor.fattening_px, rng)
        lost |= is_shadowed(ideal) | (ideal > sensor.max_disparity_px)
        bent, torn = bend(z.shape, constant, sensor, more, specimen)
        lost |= torn
        stepped = np.round((ideal + noise + bent) / sensor.step_px) * sensor.step_px
        seen = (ideal > 0) & ~lost & (stepped > constant / sensor.max_range_m)
        z = np.divide(constant, stepped, out=np.zeros_like(z), where=seen)
    units = np.round(np.where(seen, z, 0.0) / 0.001)
    return np.where(units <= np.iinfo(np.uint16).max, units, 0).astype(np.uint16)


def match_quality(
    surface: Surface, z: np.ndarray, projector_lux: float = 500.0, window: int = 7
) -> np.ndarray:
    """Contrast over noise in the matching window.

    The day's light alone gives the surface's contrast, spread over mean. The dots add
    ``facing lux_p / (z^2 lux)`` of it, at most 1. The noise is that of a camera whose mean pixel
    holds 2500 electrons and which reads with 1 % of the mean: ``sqrt(4e-4 / s + (0.01 / s)^2)``
    for a surface of brightness s, over the root of the pixels in the window / 8.

    Args:
        surface: What is seen.
        z: ``(H, W)`` float, depth [m].
        projector_lux: See :class:`DepthSensor`.
        window: Side of the window [pixel].

    Returns:
        ``(H, W)`` float32.
    """
    rho, size = surface.reflectance, (window, window)
    mean = cv2.blur(rho, size)
    spread = np.sqrt(np.maximum(cv2.blur(rho * rho, size) - mean * mean, 0))
    contrast = spread / np.maximum(mean, 1e-9)
    near = np.where(np.isfinite(z), z, 1e3).astype(np.float32)
    dots = surface.facing * np.float32(projector_lux / max(surface.lux, 1e-3)) / (near * near)
    dots = np.minimum(dots, 1)
    day = mean / max(float(mean.mean()), 1e-9)
    share = np.maximum(day, 2 * dots * mean)
    noise = np.sqrt(4e-4 / np.maximum(share, 1e-3) + np.square(0.01 / np.maximum(share, 1e-3)))
    kept = np.power(np.maximum(1 - surface.gloss, 0), 1.5)
    return kept * np.hypot(contrast, dots) / (noise * np.float32(np.sqrt(8) / window))


def fatten(disparity: np.ndarray, reach_px: float, rng: np.random.Generator) -> np.ndarray:
    """Let nearer things grow over what is behind them, here more and there less.

    Args:
        disparity: ``(H, W)`` float64 [pixel], 0 at infinity.
        reach_px: How far, on average [pixel]; 0: not at all.
        rng: Random numbers.
    """
    if reach_px <= 0:
        return disparity
    reach = reach_px * (1 + 0.5 * smooth_noise(disparity.shape, 3.0, rng))
    out = disparity
    for radius in range(1, int(np.ceil(2 * reach_px)) + 1):
        kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
        grown = cv2.dilate(disparity, kernel)
        # A jump of a pixel is an edge; less is a slanted surface, which stays as it is.
        out = np.where((reach > radius - 0.5) & (grown > disparity + 1), grown, out)
    return out


def is_shadowed(disparity: np.ndarray) -> np.ndarray:
    """Where the right imager doesn't see what the left one sees: beside nearer things, and
    outside its picture.

    Args:
        disparity: ``(H, W)`` float64 [pixel], 0 at infinity.

    Returns:
        ``(H, W)`` bool. A pixel u lands on u - d in the right picture; it is hidden when one
        further right in the left picture lands further left.
    """  # noqa: D205
    landing = np.arange(disparity.shape[1]) - disparity
    leftmost = np.minimum.accumulate(landing[:, ::-1], axis=1)[:, ::-1]
    return (landing > leftmost + 0.5) | (landing < 0)


def _dropouts(shape: tuple[int, ...], sensor: DepthSensor, rng: np.random.Generator) -> np.ndarray:
    blotches = patches(shape, sensor.blotch_px, rng)
    limit = np.quantile(blotches, 1 - sensor.dropout)
    return (blotches > limit) | (rng.random(shape, np.float32) < sensor.speckle)
