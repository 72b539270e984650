"""From ideal pictures to what a stereo depth camera and a colour camera deliver.

The depth camera works in disparity d = f B / z, as the Intel D400 family does: its noise and
its steps are even in disparity, so they grow with z^2. Depth is that of the left imager.
"""

from dataclasses import dataclass

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

    def deviation_m(self, z: np.ndarray, fx: float) -> np.ndarray:
        """Standard deviation of a depth ``z`` [m] seen with focal length ``fx`` [pixel], in m:
        z^2 noise / (f B), with that of the rounding to steps added."""  # noqa: D205, D209
        spread = np.hypot(self.noise_px, self.step_px / np.sqrt(12))
        return np.square(z) * spread / (fx * self.baseline_m)


def measure_depth(
    z: np.ndarray,
    camera: Intrinsics,
    sensor: DepthSensor,
    rng: np.random.Generator,
    unit_m: float = 0.001,
) -> np.ndarray:
    """Make an ideal depth image a measured one.

    Args:
        z: ``(H, W)`` float, ideal depth [m], inf where there is none.
        camera: The depth camera (its left imager).
        sensor: How it errs.
        rng: Random numbers.
        unit_m: The depth unit [m].

    Returns:
        ``(H, W)`` uint16 [depth units], 0 where nothing is measured.
    """
    seen = np.isfinite(z) & (z > 0)
    if sensor.enabled:
        constant = camera.fx * sensor.baseline_m
        ideal = np.divide(constant, z, out=np.zeros_like(z), where=seen)
        lost = is_shadowed(ideal) | (ideal > sensor.max_disparity_px)
        lost |= _dropouts(z.shape, sensor, rng)
        noisy = ideal + sensor.noise_px * smooth_noise(z.shape, sensor.noise_size_px, rng)
        stepped = np.round(noisy / sensor.step_px) * sensor.step_px
        seen &= ~lost & (stepped > constant / sensor.max_range_m)
        z = np.divide(constant, stepped, out=np.zeros_like(z), where=seen)
    units = np.round(np.where(seen, z, 0.0) / unit_m)
    return np.where(units <= np.iinfo(np.uint16).max, units, 0).astype(np.uint16)


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
    blotches = smooth_noise((shape[0] // 8 + 1, shape[1] // 8 + 1), 0.7, rng)
    blotches = cv2.resize(blotches, shape[::-1], interpolation=cv2.INTER_LINEAR)
    limit = np.quantile(blotches, 1 - sensor.dropout)
    return (blotches > limit) | (rng.random(shape, np.float32) < sensor.speckle)


def expose_color(
    color: np.ndarray, rng: np.random.Generator, noise: float = 2.0, blur_px: float = 0.5
) -> np.ndarray:
    """Make an ideal colour image a picture.

    Args:
        color: ``(H, W, 3)`` float32, grey levels.
        rng: Random numbers.
        noise: Standard deviation of the read noise [grey levels]; 0: none.
        blur_px: Width of the lens's and the demosaicing's blur [pixel]; 0: none.

    Returns:
        ``(H, W, 3)`` uint8.
    """
    if blur_px > 0:
        color = cv2.GaussianBlur(color, (5, 5), blur_px)
    if noise > 0:
        color = color + np.float32(noise) * rng.standard_normal(color.shape, np.float32)
    return np.clip(np.rint(color), 0, 255).astype(np.uint8)
