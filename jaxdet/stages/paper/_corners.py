"""Detection of the strongest corners of Canny edges: one kernel for the CPU and CUDA."""

import math
import struct
from typing import Any

import jax
import numpy as np

from jaxdet.config import FeaturesConfig
from jaxdet.runtime.calls import by_device, device_of_jax, jax_callable, most_teams
from jaxdet.runtime.launch import by_frame, filled, reported_words
from jaxdet_kernels import features as kernels


def corner_settings(config: FeaturesConfig) -> np.ndarray:
    """Return the settings for the kernels, ``(5,)`` int32.

    These are Canny's two thresholds; the square of the minimum distance, rounded up (squared
    distances are integers, so the same ones are smaller); and the quality level as the two words of
    a float64, low word first.
    """
    distance, quality = config.min_distance, struct.pack("<d", config.quality_level)
    limit = math.ceil(distance * distance) if distance >= 1 else 0
    words = *config.canny_bounds, limit, *struct.unpack("<2i", quality)
    return np.array(words, np.int32)


def strongest_corners(
    color: jax.Array, settings: jax.Array, slots: int
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return the strongest corners of the Canny edges of images, as selected by the reference.

    Args:
        color: Images ``(B, H, W, 3)`` uint8, RGB.
        settings: From :func:`corner_settings`.
        slots: ``N``, maximum number of corners of a frame; static.

    Returns:
        Columns and rows ``(B, N)`` int32, strongest first, zero in empty slots; and the number of
        corners ``(B,)`` int32, which is ``N + 1`` if there are more than ``N``.
    """
    batch, height, width, _ = color.shape
    words = reported_words(kernels, [height, width], device_of_jax(kernels))

    def corners(teams: int) -> tuple[jax.Array, jax.Array, jax.Array]:
        found = dict.fromkeys(("u", "v"), (batch, slots))
        dims = {**found, "number": (batch,), "scratch": (teams, words)}
        return _corners(color, settings, output_dims=dims)[:3]

    return by_device(lambda: corners(1), lambda: corners(most_teams(batch, words, kernels.BLOCKS)))


@jax_callable(kernels, kernels.TYPES, outputs=4)
def _corners(color: Any, settings: Any, u: Any, v: Any, number: Any, scratch: Any) -> None:
    batch = filled(kernels.Batch, color=color, settings=settings, u=u, v=v, number=number)
    by_frame(kernels, kernels.corners, batch, len(color), scratch)
