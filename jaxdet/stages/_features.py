"""Stage 3, features: OpenCV on host threads, then look-ups on the device."""

from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache

import cv2
import jax
import jax.numpy as jnp
import numpy as np

from jaxdet.camera import fixed_rays
from jaxdet.config import FeaturesConfig
from jaxdet.stages._corners import strongest_corners
from jaxdet.types import AlignedDepth, Calibration, Features, Keep


def features(
    color: np.ndarray,
    aligned: AlignedDepth,
    keep: Keep,
    calibration: Calibration,
    config: FeaturesConfig,
) -> Features:
    """Finds the strongest Shi-Tomasi corners of the Canny edge image and looks up their depth.

    Equals :func:`jaxdet.reference.features`. The corners come from OpenCV on host threads, one
    frame each; the depth and the metric coordinates are gathered on the device.

    Args:
        color: ``(B, H, W, 3)`` uint8, RGB, on the host.
        aligned: Depth at the colour pixels.
        keep: Where corners may be, from the ground stage.
        calibration: For the colour camera.
        config: Canny's bounds and the corner selection.

    Returns:
        ``N = config.max_corners`` slots a frame; empty slots are zero.
    """
    masks = np.asarray(keep.mask).view(np.uint8) if config.use_mask else [None] * len(color)
    batch, n = len(color), config.max_corners
    uv = np.zeros((2, batch, n), np.int32)
    count = np.zeros(batch, np.int32)

    def find(b: int) -> None:
        corners = _corners(np.asarray(color[b]), masks[b], config)
        count[b] = len(corners)
        uv[:, b, : min(len(corners), n)] = corners[:n].T

    with ThreadPoolExecutor() as pool:
        list(pool.map(find, range(batch)))
    u, v, count_device = jnp.asarray(uv[0]), jnp.asarray(uv[1]), jnp.asarray(count)
    return _look_up(u, v, count_device, aligned.z, keep.mask, *_rays(calibration))


def _corners(image: np.ndarray, mask: np.ndarray | None, config: FeaturesConfig) -> np.ndarray:
    """The corners of one frame, one more than there are slots; ``(n, 2)`` int32 column, row."""
    source = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    if config.canny:
        source = cv2.Canny(source, config.canny_low, config.canny_high)
    return strongest_corners(
        source,
        mask,
        max_corners=config.max_corners + 1,
        quality_level=config.quality_level,
        min_distance=config.min_distance,
        block_size=config.block_size,
    )


@lru_cache(maxsize=8)
def _rays(calibration: Calibration) -> tuple[jax.Array, jax.Array]:
    x, y = fixed_rays(calibration.color)
    return jnp.asarray(x), jnp.asarray(y)


@jax.jit
def _look_up(
    u: jax.Array,
    v: jax.Array,
    count: jax.Array,
    z: jax.Array,
    keep: jax.Array,
    ray_x: jax.Array,
    ray_y: jax.Array,
) -> Features:
    """The features' depth, coordinates and flags, from their pixels ``(B, N)``."""
    with jax.named_scope("features"):
        n = u.shape[1]
        valid = jnp.arange(n, dtype=jnp.int32)[None, :] < count[:, None]
        frame = jnp.arange(u.shape[0], dtype=jnp.int32)[:, None]
        z = jnp.where(valid, z[frame, v, u].astype(jnp.int32), 0)
        kept = valid & keep[frame, v, u]
        x, y = (lateral(ray[v, u], z) for ray in (ray_x, ray_y))
        return Features(u, v, x, y, z, valid, kept, overflow=count > n)


def lateral(ray: jax.Array, z: jax.Array) -> jax.Array:
    """``(ray * z + half) >> RAY_BITS`` without leaving 32 bits: ten fraction bits at a time.

    Holds for rays up to ``MAX_RAY`` and z below 2^16, as the floors nest:
    ``floor((a + 2^19) / 2^20) = floor((floor(a / 2^10) + 2^9) / 2^10)``.
    """
    product = (ray >> 10) * z + (((ray & 1023) * z) >> 10)
    return (product + 512) >> 10
