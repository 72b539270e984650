"""Procedural textures: periodic images, drawn once, looked up with bilinear filtering."""

from functools import lru_cache

import numpy as np

from jaxdet.sim.scene import Texture

SIZE = 512
"""Side of a texture image [texel]."""
PERIODS = 4
"""How often the pattern's period fits into the image: variation before it repeats."""
LEVELS = 7
"""Halvings kept, against aliasing far away."""


def spectral_noise(rng: np.random.Generator, slope: float, stretch: float = 1.0) -> np.ndarray:
    """Periodic noise with a power-law spectrum.

    Args:
        rng: Random numbers.
        slope: Amplitude falls with the frequency to this power; 0 is white.
        stretch: How much longer its features are along s than along t.

    Returns:
        ``(SIZE, SIZE)`` float64 indexed ``[t, s]``, zero mean, unit variance.
    """
    s, t = np.fft.rfftfreq(SIZE) * stretch, np.fft.fftfreq(SIZE)
    frequency = np.hypot(s[None, :], t[:, None])
    frequency[0, 0] = np.inf
    spectrum = np.fft.rfft2(rng.standard_normal((SIZE, SIZE))) * frequency**-slope
    spectrum[0, 0] = 0
    noise = np.fft.irfft2(spectrum, (SIZE, SIZE))
    return noise / noise.std()


def _mix(texture: Texture, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """How much accent (0-1) and how much brighter (grey levels) each texel is."""
    t, s = np.mgrid[:SIZE, :SIZE] * (PERIODS / SIZE)
    shade = np.zeros((SIZE, SIZE))
    per_cell = rng.normal(0, 7, (PERIODS, PERIODS))
    if texture.kind == "noise":
        mix = np.clip(0.5 + 0.6 * spectral_noise(rng, 1.0), 0, 1)
    elif texture.kind == "tiles":
        mix = ((t % 1 < 0.035) | (s % 1 < 0.035)).astype(float)
        shade = per_cell[t.astype(int), s.astype(int)] + 4 * spectral_noise(rng, 1.0)
    elif texture.kind == "wood":
        board = t.astype(int)
        end = (s + 0.6 * board + 0.5) % 2 < 0.015
        mix = np.clip(0.22 * spectral_noise(rng, 0.8, stretch=12) + 0.15, 0, 0.7)
        mix[(t % 1 < 0.03) | end] = 1
        shade = per_cell[board, 0] * 1.5
    elif texture.kind == "stripes":
        mix = (t % 1 < 0.5).astype(float)
    elif texture.kind == "checker":
        mix = ((t % 1 < 0.5) ^ (s % 1 < 0.5)).astype(float)
    elif texture.kind == "carton":
        tape = abs(t % 1 - 0.5) < 0.06
        label = (abs(s % 1 - 0.3) < 0.18) & (abs(t % 1 - 0.22) < 0.1)
        lines = label & (t * 24 % 1 < 0.45)
        mix = 0.35 * tape + 1.0 * lines
        shade = 55.0 * (label & ~lines)
    else:
        mix = np.zeros((SIZE, SIZE))
    return mix, shade


@lru_cache(maxsize=64)
def texture_pyramid(texture: Texture, seed: int) -> tuple[np.ndarray, ...]:
    """Draw a texture.

    Returns:
        Images ``(n, n, 3)`` float32, n halving from SIZE, indexed ``[t, s]``; each spans
        ``PERIODS * texture.size_m`` metres and repeats.
    """
    rng = np.random.default_rng([seed, 7])
    mix, shade = _mix(texture, rng)
    color, accent = np.asarray(texture.color, float), np.asarray(texture.accent, float)
    image = color + mix[..., None] * (accent - color)
    image += (shade + texture.grain * spectral_noise(rng, 0.3))[..., None]
    levels: list[np.ndarray] = [image.astype(np.float32)]
    for _ in range(LEVELS - 1):
        a = levels[-1]
        quads = a[::2, ::2] + a[1::2, ::2] + a[::2, 1::2] + a[1::2, 1::2]
        levels.append((quads / 4).astype(np.float32))
    return tuple(levels)


def _bilinear(image: np.ndarray, s: np.ndarray, t: np.ndarray) -> np.ndarray:
    n = len(image)
    s, t = s * n - 0.5, t * n - 0.5
    s0, t0 = np.floor(s), np.floor(t)
    ws, wt = (s - s0).astype(np.float32)[:, None], (t - t0).astype(np.float32)[:, None]
    i0, j0 = t0.astype(np.int32) % n, s0.astype(np.int32) % n
    i1, j1 = (i0 + 1) % n, (j0 + 1) % n
    top = image[i0, j0] * (1 - ws) + image[i0, j1] * ws
    return top * (1 - wt) + (image[i1, j0] * (1 - ws) + image[i1, j1] * ws) * wt


def sample(texture: Texture, seed: int, st: np.ndarray, pixel_m: np.ndarray) -> np.ndarray:
    """Look a texture up.

    Args:
        texture: The texture.
        seed: Its variation.
        st: ``(n, 2)`` float64, place on the surface [m].
        pixel_m: ``(n,)`` float64, what one pixel covers there [m]; picks the resolution.

    Returns:
        ``(n, 3)`` float32, RGB, not clipped.
    """
    pyramid = texture_pyramid(texture, seed)
    span = PERIODS * texture.size_m
    place = st / span
    place -= np.floor(place)
    level = np.log2(np.maximum(pixel_m * (SIZE / span), 1.0)).round().astype(np.int8)
    level = np.minimum(level, LEVELS - 1)
    out = np.empty((len(st), 3), np.float32)
    for number in np.unique(level):
        chosen = level == number
        out[chosen] = _bilinear(pyramid[number], place[chosen, 0], place[chosen, 1])
    return out
