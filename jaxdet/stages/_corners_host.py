"""Corners on the host with OpenCV, to the rule of the reference at any image width."""

import cv2
import numpy as np

from jaxdet.config import FeaturesConfig

LANES = 32
"""OpenCV's AVX2 Sobel leaves the fused multiply-add out in the last ``width mod 32`` columns."""


def canny_bounds(image: np.ndarray, config: FeaturesConfig) -> tuple[int, int]:
    """Canny's bounds for a grey image ``(H, W)`` uint8, lower in darker frames if so configured."""
    low, high = sorted((int(config.canny_low // 1), int(config.canny_high // 1)))
    level = int(16 * config.canny_reference_level)
    if not level:
        return low, high
    mean = int(cv2.sumElems(image)[0]) * 16 // image.size
    mean = min(max(mean, int(config.canny_least_share * level)), level)
    return low * mean // level, high * mean // level


def strongest_corners(
    image: np.ndarray, mask: np.ndarray | None, config: FeaturesConfig
) -> np.ndarray:
    """``cv2.goodFeaturesToTrack``, with bits that don't depend on the image width.

    Args:
        image: ``(H, W)`` uint8, the edge image or the grey image.
        mask: ``(H, W)`` uint8, zero where no corner is allowed; None for everywhere.
        config: The selection; one corner more than ``max_corners`` is looked for.

    Returns:
        ``(n, 2)`` int32, column and row, strongest first.
    """
    most = 0 if config.max_per_tile else config.max_corners + 1
    if image.shape[1] % LANES == 0:
        found = cv2.goodFeaturesToTrack(
            image,
            most,
            config.quality_level,
            config.min_distance,
            mask=mask,
            blockSize=config.block_size,
        )
        found = np.zeros((0, 2), np.int32) if found is None else found[:, 0].astype(np.int32)
    else:
        strength = _min_eigenvalue(image, config.block_size)
        limit = most or image.size
        found = _select(strength, mask, limit, config.quality_level, config.min_distance)
    if config.max_per_tile:
        found = _share_out(found, config)[: config.max_corners + 1]
    return found


def _share_out(corners: np.ndarray, config: FeaturesConfig) -> np.ndarray:
    """Keeps the first ``max_per_tile`` corners of each tile, in their order."""
    taken: dict[tuple[int, int], int] = {}
    keep = np.zeros(len(corners), bool)
    for i, (u, v) in enumerate((corners // config.tile_size).tolist()):
        taken[u, v] = taken.get((u, v), 0) + 1
        keep[i] = taken[u, v] <= config.max_per_tile
    return corners[keep]


def _min_eigenvalue(image: np.ndarray, block_size: int) -> np.ndarray:
    """``cv2.cornerMinEigenVal`` with the Sobel run on whole vectors of columns."""
    width = image.shape[1]
    padding = -width % LANES
    wide = cv2.copyMakeBorder(image, 0, 0, 0, padding, cv2.BORDER_REFLECT_101)
    scale = 1.0 / (4 * block_size * 255)
    dx, dy = (
        np.ascontiguousarray(cv2.Sobel(wide, cv2.CV_32F, i, 1 - i, ksize=3, scale=scale)[:, :width])
        for i in (1, 0)
    )
    xx, xy, yy = (
        cv2.boxFilter(p, cv2.CV_32F, (block_size, block_size), normalize=False)
        for p in (dx * dx, dx * dy, dy * dy)
    )
    a, c = np.float32(0.5) * xx, np.float32(0.5) * yy
    t = a - c
    return (a + c) - np.sqrt(t * t + xy * xy)


def _select(
    strength: np.ndarray,
    mask: np.ndarray | None,
    max_corners: int,
    quality_level: float,
    min_distance: float,
) -> np.ndarray:
    """OpenCV's selection on a given strength map."""
    height, width = strength.shape
    strongest = cv2.minMaxLoc(strength, mask)[1]
    _, kept = cv2.threshold(strength, strongest * quality_level, 0, cv2.THRESH_TOZERO)
    corners = (kept != 0) & (kept == cv2.dilate(kept, np.ones((3, 3), np.uint8)))
    if mask is not None:
        corners &= mask != 0
    corners[[0, -1]] = False
    corners[:, [0, -1]] = False
    position = np.flatnonzero(corners)[::-1]
    position = position[np.argsort(-kept.reshape(-1)[position], kind="stable")]
    if min_distance < 1:
        position = position[:max_corners]
        return np.stack([position % width, position // width], axis=1).astype(np.int32)
    return _spread(position, (height, width), max_corners, min_distance)


def _spread(
    position: np.ndarray, size: tuple[int, int], max_corners: int, min_distance: float
) -> np.ndarray:
    """Greedy minimum distance: each corner taken blocks the disc around it."""
    reach = int(np.ceil(min_distance)) - 1
    offset = np.arange(-reach, reach + 1)
    disc = offset[:, None] ** 2 + offset**2 < min_distance * min_distance
    height, width = size
    blocked = np.zeros((height + 2 * reach, width + 2 * reach), bool)
    taken: list[tuple[int, int]] = []
    side = 2 * reach + 1
    for v, u in zip(*(a.tolist() for a in np.divmod(position, width)), strict=True):
        if blocked[v + reach, u + reach]:
            continue
        taken.append((u, v))
        if len(taken) == max_corners:
            break
        blocked[v : v + side, u : u + side] |= disc
    return np.array(taken, np.int32).reshape(-1, 2)
