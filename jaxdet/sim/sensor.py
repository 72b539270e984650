"""From ideal pictures to what a stereo depth camera and a colour camera deliver.

The depth camera works in disparity d = f B / z, as the Intel D400 family does: its noise and
its steps are even in disparity, so they grow with z^2. Depth is that of the left imager.

Matching needs contrast. What there is of it: the surface's own (spread over mean in the matching
window) and the projector's dots, whose share of the light falls with z^2 and with the light of the
day. What spoils it: the imager's noise, which is large on dark surfaces, and gloss, which mirrors
the dots away. Where ``contrast / noise`` is too low there is a hole.
"""

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from jaxdet.types import Intrinsics


@dataclass(frozen=True)
class DepthSensor:
    """A stereo depth camera; the defaults are a D435's."""

    enabled: bool = True
    """Off: exact depths, only rounded to units."""
    baseline_m: float = 0.05
    """Between the imagers [m]: 50 mm by the D400 series data sheet (337029)."""
    noise_px: float = 0.08
    """Standard deviation of a disparity [pixel]: 0.032 at best, 0.08 to be reckoned with, by
    RealSense's chief technical officer (librealsense issue 3904)."""
    noise_size_px: float = 1.5
    """How far the noise hangs together [pixel]: matching compares windows, not pixels."""
    step_px: float = 1 / 32
    """Step of a disparity [pixel]: Intel white paper "Subpixel linearity improvement"."""
    max_disparity_px: float = 126.0
    """Search range [pixel], which sets the nearest depth f B / 126: Intel's guide to
    tuning D400 cameras."""
    max_range_m: float = 10.0
    """Nothing farther is delivered [m]: the data sheet's usable range."""
    dropout: float = 0.004
    """Share of the image in blotches without depth (our choice, by eye on real D435 images)."""
    speckle: float = 0.001
    """Share of single pixels without depth (as above)."""
    fattening_px: float = 1.2
    """How far nearer things grow over what is behind them [pixel]: half of what of the matching
    window decides (our choice, by eye on real D435 images)."""
    contrast: float = 1.0
    """Least contrast over noise that is matched; 0: no holes of that cause."""
    projector_lux: float = 500.0
    """Light of the day against which the projector's dots at 1 m are as bright as it [lux]: about
    0.36 W on 2 m2 in dots of a tenth of the area, against 500 lx of 3-4 W/m2 each klx."""

    def deviation_m(self, z: np.ndarray, fx: float) -> np.ndarray:
        """Standard deviation of a depth ``z`` [m] seen with focal length ``fx`` [pixel], in m:
        z^2 noise / (f B), with that of the rounding to steps added."""  # noqa: D205, D209
        spread = np.hypot(self.noise_px, self.step_px / np.sqrt(12))
        return np.square(z) * spread / (fx * self.baseline_m)


class Surface(NamedTuple):
    """What the depth camera sees beside distances."""

    reflectance: np.ndarray
    """``(H, W)`` float32, 0 to 1."""
    gloss: np.ndarray
    """``(H, W)`` float32, 0 to 1."""
    facing: np.ndarray
    """``(H, W)`` float32, cosine between surface and view."""
    lux: float
    """Light of the day."""


def measure_depth(
    z: np.ndarray,
    camera: Intrinsics,
    sensor: DepthSensor,
    rng: np.random.Generator,
    surface: Surface | None = None,
    unit_m: float = 0.001,
) -> np.ndarray:
    """Make an ideal depth image a measured one.

    Args:
        z: ``(H, W)`` float, ideal depth [m], inf where there is none.
        camera: The depth camera (its left imager).
        sensor: How it errs.
        rng: Random numbers.
        surface: What the surfaces look like; None: all can be matched.
        unit_m: The depth unit [m].

    Returns:
        ``(H, W)`` uint16 [depth units], 0 where nothing is measured.
    """
    seen = np.isfinite(z) & (z > 0)
    if sensor.enabled:
        constant = camera.fx * sensor.baseline_m
        ideal = np.divide(constant, z, out=np.zeros_like(z), where=seen)
        noise = sensor.noise_px * smooth_noise(z.shape, sensor.noise_size_px, rng)
        lost = _dropouts(z.shape, sensor, rng)
        if surface is not None and sensor.contrast > 0:
            quality = match_quality(surface, z, sensor.projector_lux)
            patches = _blotches(z.shape, rng)
            lost |= quality < sensor.contrast * np.exp2(0.7 * patches)
            noise *= 1 + np.minimum(sensor.contrast / np.maximum(quality, 1e-3), 1)
        ideal = fatten(ideal, sensor.fattening_px, rng)
        lost |= is_shadowed(ideal) | (ideal > sensor.max_disparity_px)
        stepped = np.round((ideal + noise) / sensor.step_px) * sensor.step_px
        seen = (ideal > 0) & ~lost & (stepped > constant / sensor.max_range_m)
        z = np.divide(constant, stepped, out=np.zeros_like(z), where=seen)
    units = np.round(np.where(seen, z, 0.0) / unit_m)
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


def smooth_noise(shape: tuple[int, ...], size_px: float, rng: np.random.Generator) -> np.ndarray:
    """Normal noise ``shape`` float32, unit variance, blurred by ``size_px`` [pixel]."""
    white = rng.standard_normal(shape, np.float32)
    if size_px <= 0:
        return white
    # A Gaussian of this width leaves 1 / (4 pi size^2) of the variance; measured on its taps.
    taps = cv2.getGaussianKernel(2 * int(3 * size_px + 0.5) + 1, size_px)
    return cv2.sepFilter2D(white, -1, taps, taps) / np.float32((taps**2).sum())


def _dropouts(shape: tuple[int, ...], sensor: DepthSensor, rng: np.random.Generator) -> np.ndarray:
    blotches = _blotches(shape, rng)
    limit = np.quantile(blotches, 1 - sensor.dropout)
    return (blotches > limit) | (rng.random(shape, np.float32) < sensor.speckle)


def _blotches(shape: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
    """Noise in patches of about ten pixels."""
    small = smooth_noise((shape[0] // 8 + 1, shape[1] // 8 + 1), 0.7, rng)
    return cv2.resize(small, shape[::-1], interpolation=cv2.INTER_LINEAR)
