"""Sensor model of a stereo depth camera.

The camera measures disparity d = f B / z, as the Intel D400 family does: noise and quantisation are
uniform in disparity, so they grow with z^2. Depth is that of the left imager.

Stereo matching needs contrast, from the surface's texture (standard deviation over mean in the
matching window) and from the projector's dots, whose share of the light decreases with z^2 and with
ambient light. Imager noise is large on dark surfaces, and gloss reflects the dots away. Depth has
holes where ``contrast / noise`` is too low.
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
    """Simulate the measurement of an ideal depth image.

    Args:
        z: Ideal depth ``(H, W)`` float [m], inf without a hit.
        camera: Depth camera (its left imager).
        sensor: Error model.
        rng: Random generator.
        surface: Appearance of the surfaces; None: all can be matched.
        specimen: Seed of the systematic errors, which are constant for a camera.

    Returns:
        Depth ``(H, W)`` uint16 [mm], 0 = no measurement.
    """
    # A separate stream, so that the default sensor's noise does not depend on further errors.
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
    """Compute the ratio of contrast to noise in the matching window.

    In ambient light the contrast is the surface's, standard deviation over mean. The projector's
    dots add ``facing projector_lux / (z^2 lux)``, at most 1, to it. The noise is that of a camera
    whose mean pixel holds 2500 electrons with a read noise of 1 % of the mean:
    ``sqrt(4e-4 / s + (0.01 / s)^2)`` for a surface of brightness s, divided by the square root of
    (pixels in the window / 8).

    Args:
        surface: Appearance of the surfaces.
        z: Depth ``(H, W)`` float [m].
        projector_lux: See :class:`DepthSensor`.
        window: Side of the window [pixel].

    Returns:
        Match quality ``(H, W)`` float32.
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
    """Dilate foreground objects over the background, as block matching does (edge fattening).

    Args:
        disparity: Disparity ``(H, W)`` float64 [pixel], 0 at infinity.
        reach_px: Mean reach, which varies over the image [pixel]; 0: off.
        rng: Random generator.
    """
    if reach_px <= 0:
        return disparity
    reach = reach_px * (1 + 0.5 * smooth_noise(disparity.shape, 3.0, rng))
    out = disparity
    for radius in range(1, int(np.ceil(2 * reach_px)) + 1):
        kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
        grown = cv2.dilate(disparity, kernel)
        # A jump of a pixel is an edge; slanted surfaces have smaller jumps.
        out = np.where((reach > radius - 0.5) & (grown > disparity + 1), grown, out)
    return out


def is_shadowed(disparity: np.ndarray) -> np.ndarray:
    """Return the stereo shadow: pixels that the right imager doesn't see.

    A pixel at column u of the left image is at column u - d of the right image. It is hidden if a
    pixel further right in the left image is further left in the right image, or if u - d is outside
    of the right image.

    Args:
        disparity: Disparity ``(H, W)`` float64 [pixel], 0 at infinity.

    Returns:
        Mask ``(H, W)`` bool.
    """
    landing = np.arange(disparity.shape[1]) - disparity
    leftmost = np.minimum.accumulate(landing[:, ::-1], axis=1)[:, ::-1]
    return (landing > leftmost + 0.5) | (landing < 0)


def _dropouts(shape: tuple[int, ...], sensor: DepthSensor, rng: np.random.Generator) -> np.ndarray:
    blotches = patches(shape, sensor.blotch_px, rng)
    limit = np.quantile(blotches, 1 - sensor.dropout)
    return (blotches > limit) | (rng.random(shape, np.float32) < sensor.speckle)
