"""Procedural textures: periodic patterns for the ray caster, drawn once.

A pattern is an image of three channels: fraction of the accent colour (0-1), brightness offset
[grey levels], and fine noise of unit variance, which the texture's grain scales.
"""

from functools import lru_cache
from typing import get_args

import numpy as np

from jaxdet.sim import ray_kernels as kernels
from jaxdet.sim.appearance import Kind

SIZE = int(kernels.SIZE)
"""Side of a pattern's finest image [texel]."""
PERIODS = int(kernels.PERIODS)
"""Number of periods of the pattern per image; each period has different noise."""


def spectral_noise(rng: np.random.Generator, slope: float, stretch: float = 1.0) -> np.ndarray:
    """Return periodic noise with a power-law spectrum.

    Args:
        rng: Random generator.
        slope: Exponent by which the amplitude falls with frequency; 0: white noise.
        stretch: Length of features along s divided by their length along t.

    Returns:
        Noise ``(SIZE, SIZE)`` float64 indexed ``[t, s]``, zero mean, unit variance.
    """
    s, t = np.fft.rfftfreq(SIZE) * stretch, np.fft.fftfreq(SIZE)
    frequency = np.hypot(s[None, :], t[:, None])
    frequency[0, 0] = np.inf
    spectrum = np.fft.rfft2(rng.standard_normal((SIZE, SIZE))) * frequency**-slope
    spectrum[0, 0] = 0
    noise = np.fft.irfft2(spectrum, (SIZE, SIZE))
    return noise / noise.std()


def _built(kind: Kind, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the accent fraction and brightness offset of a regular pattern, else None."""
    t, s = np.mgrid[:SIZE, :SIZE] * (PERIODS / SIZE)
    shade = np.zeros((SIZE, SIZE))
    per_cell = rng.normal(0, 7, (8 * PERIODS, 8 * PERIODS))
    if kind == "tiles":
        mix = ((t % 1 < 0.035) | (s % 1 < 0.035)).astype(float)
        shade = per_cell[t.astype(int), s.astype(int)] + 4 * spectral_noise(rng, 1.0)
    elif kind == "wood":
        board = t.astype(int)
        end = (s + 0.6 * board + 0.5) % 2 < 0.015
        mix = np.clip(0.22 * spectral_noise(rng, 0.8, stretch=12) + 0.15, 0, 0.7)
        mix[(t % 1 < 0.03) | end] = 1
        shade = per_cell[board, 0] * 1.5
    elif kind == "stripes":
        mix = (t % 1 < 0.5).astype(float)
    elif kind == "checker":
        mix = ((t % 1 < 0.5) ^ (s % 1 < 0.5)).astype(float)
    elif kind == "carton":
        tape = abs(t % 1 - 0.5) < 0.06
        label = (abs(s % 1 - 0.3) < 0.18) & (abs(t % 1 - 0.22) < 0.1)
        lines = label & (t * 24 % 1 < 0.45)
        mix = 0.35 * tape + 1.0 * lines
        shade = 55.0 * (label & ~lines)
    elif kind == "brick":
        row = (t * 2).astype(int)
        column = s + 0.5 * (row % 2)
        mix = ((t * 2 % 1 < 0.13) | (column % 1 < 0.05)).astype(float)
        shade = per_cell[row, column.astype(int)] * 1.5 * (1 - mix) + 3 * spectral_noise(rng, 0.5)
    elif kind == "lines":
        mix = ((s % 1 < 0.05) | (abs(t - 2.0) < 0.03)).astype(float)
        mix *= np.clip(1.1 - 0.25 * np.abs(spectral_noise(rng, 0.7)), 0, 1)
        shade = 6 * spectral_noise(rng, 0.6)
    elif kind == "mosaic":
        cells = per_cell[(t * 4).astype(int) % 32, (s * 4).astype(int) % 32]
        mix = np.where((t * 4 % 1 < 0.08) | (s * 4 % 1 < 0.08), 0.7, np.clip(cells / 14, 0, 1))
    else:
        return None
    return mix, shade


def _mix(kind: Kind, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return the accent fraction (0-1) and brightness offset [grey levels] of each texel."""
    built = _built(kind, rng)
    if built is not None:
        return built
    shade = np.zeros((SIZE, SIZE))
    if kind == "noise":
        return np.clip(0.5 + 0.6 * spectral_noise(rng, 1.0), 0, 1), shade
    if kind == "cloth":
        folds = spectral_noise(rng, 1.3, stretch=0.35)
        return np.clip(0.25 + 0.16 * folds, 0, 1), shade
    if kind == "bark":
        ridges = np.abs(spectral_noise(rng, 0.9, stretch=0.25))
        return np.clip(1.1 - 1.4 * ridges, 0, 1), 10 * spectral_noise(rng, 0.8)
    if kind == "asphalt":
        stones = spectral_noise(rng, 0.15)
        return np.clip(0.35 * (stones > 1.3) + 0.1 * spectral_noise(rng, 1.0), 0, 1), shade
    if kind == "grass":
        blades = spectral_noise(rng, 0.5, stretch=0.5)
        return np.clip(0.5 + 0.4 * blades, 0, 1), 14 * spectral_noise(rng, 1.0)
    return shade, shade


@lru_cache(maxsize=len(get_args(Kind)))
def pattern(kind: Kind) -> np.ndarray:
    """Draw the mipmap of a pattern.

    Returns:
        Texels ``(texels, 3)`` float32: images of side SIZE, SIZE / 2, ..., concatenated, row by row
        ``[t, s]``; each spans ``PERIODS`` periods and repeats.
    """
    rng = np.random.default_rng([7, get_args(Kind).index(kind)])
    mix, shade = _mix(kind, rng)
    image = np.stack([mix, shade, spectral_noise(rng, 0.3)], axis=-1)
    levels = [image]
    for _ in range(int(kernels.LEVELS) - 1):
        a = levels[-1]
        levels.append((a[::2, ::2] + a[1::2, ::2] + a[::2, 1::2] + a[1::2, 1::2]) / 4)
    flat = np.concatenate([level.reshape(-1, 3) for level in levels]).astype(np.float32)
    flat.setflags(write=False)
    return flat
