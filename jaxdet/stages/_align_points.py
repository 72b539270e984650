"""Stage 1, align, at single pixels: a walk along each pixel's epipolar stretch."""

from functools import lru_cache, partial
from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import warp as wp

from jaxdet.camera import corner_rays, splat_parameters
from jaxdet.checks import check_depth
from jaxdet.stages import _align
from jaxdet.types import AlignedDepth, Array, Calibration, Distortion
from jaxdet_kernels import align_points as kernels
from jaxdet_kernels.align_search import TILE

LEAST_COSINE = 0.2
"""Calibrations whose cameras are turned further apart use the dense alignment."""
MARGIN = 2.0**-18

_tile_ranges = wp.jax_kernel(kernels.align_tile_ranges)
_points = wp.jax_kernel(kernels.align_points)


def align_points(depth: Array, calibration: Calibration, u: Array, v: Array) -> AlignedDepth:
    """What :func:`jaxdet.stages.align` returns, at single pixels only.

    Equal to the dense alignment at each pixel, for any depth image. Calibrations that the search
    does not cover (:func:`search_table`) are aligned densely.

    Args:
        depth: ``(B, Hd, Wd)`` uint16 [depth units], 0 = no measurement.
        calibration: The log's calibration.
        u: ``(B, M)`` int32, columns, inside the colour image.
        v: ``(B, M)`` int32, rows, inside the colour image.

    Returns:
        Depth and z, ``(B, M)`` uint16, 0 where there is none.

    Raises:
        CalibrationError: The images are not of the depth camera's size.
    """
    check_depth(np.shape(depth), calibration)
    depth, u, v = jnp.asarray(depth), jnp.asarray(u), jnp.asarray(v)
    if not covers(calibration):
        aligned = _align.align(depth, calibration)
        frame = jnp.arange(depth.shape[0], dtype=jnp.int32)[:, None]
        return AlignedDepth(aligned.depth[frame, v, u], aligned.z[frame, v, u])
    *arrays, fills = tables(calibration)
    return AlignedDepth(*look_up(depth, u, v, *depth_ranges(depth), tuple(arrays), fills))


@partial(jax.jit, static_argnames="fills")
def look_up(
    depth: jax.Array,
    u: jax.Array,
    v: jax.Array,
    tiles: jax.Array,
    ranges: jax.Array,
    arrays: tuple[jax.Array, ...],
    fills: int,
) -> tuple[jax.Array, jax.Array]:
    """Depth and z at pixels of the image, from :func:`depth_ranges` and :func:`tables`."""
    with jax.named_scope("align"):
        (keys,) = _points(
            depth, tiles, ranges, *arrays, fills, u, v,
            launch_dims=u.shape, output_dims={"keys_out": u.shape},
        )  # fmt: skip
        keys = jnp.where(keys == jnp.uint32(0xFFFFFFFF), jnp.uint32(0), keys)
        return (keys >> 16).astype(jnp.uint16), (keys & 0xFFFF).astype(jnp.uint16)


def covers(calibration: Calibration) -> bool:
    """Whether the search covers the calibration."""
    return not calibration.is_aligned and search_table(calibration) is not None


@jax.jit
def depth_ranges(depth: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The depth ranges of each tile and of each frame, nearest << 16 | farthest.

    Args:
        depth: ``(B, Hd, Wd)`` uint16 [depth units].

    Returns:
        ``(B, ceil(Hd / 16), ceil(Wd / 16))`` and ``(B,)`` uint32; nearest is 65535 and farthest 0
        where nothing was measured.
    """
    batch, height, width = depth.shape
    shape = batch, -(-height // TILE), -(-width // TILE)
    (tiles,) = _tile_ranges(depth, launch_dims=shape, output_dims={"tiles_out": shape})
    nearest, farthest = jnp.min(tiles >> 16, axis=(1, 2)), jnp.max(tiles & 0xFFFF, axis=(1, 2))
    return tiles, (nearest << 16) | farthest


@lru_cache(maxsize=8)
def tables(calibration: Calibration) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array, int]:
    """The kernel's tables on the device: rays x and y, parameters, search table; and ``fills``."""
    search = search_table(calibration)
    assert search is not None
    x, y, parameters, _, fills, _ = _align.tables(calibration)
    return x, y, parameters, jnp.asarray(search), fills


@lru_cache(maxsize=8)
def search_table(calibration: Calibration) -> np.ndarray | None:
    """What the search needs beside the dense alignment's tables, or None where it does not hold.

    It holds for lenses without distortion (so that rays are linear in the pixels) and cameras
    that look the same way, roughly: each image direction of one is that of the other, and each
    ray of the colour camera meets the depth camera's image plane at a good angle.

    The box around a path: let n_u be ``R0 - k R2`` and n_v ``R1 - k' R2`` with the rows of R, and
    d the offset of a depth pixel's upper left corner from the path at the same depth. A hit needs
    ``n_u . d < e_u``, ``n_u . d > -e_u - n_u . s`` and so for n_v, where s is the pixel's size and
    ``e = footprint / (2 f) + margin``. Eliminating one coordinate with positive weights bounds the
    other; the largest weights over the image and the smallest determinant make the constants.

    Returns:
        ``(SEARCH_VALUES,)`` float32, see :mod:`jaxdet_kernels.align_search`.
    """
    splat, depth, color = splat_parameters(calibration), calibration.depth, calibration.color
    assert depth is not None
    if not (Distortion.NONE is splat.model is depth.distortion):
        return None
    unit = float(splat.depth_unit)
    R, t = splat.rotation.astype(float).reshape(3, 3), splat.translation.astype(float) / unit
    fx, fy, cx, cy = (float(value) for value in splat.pinhole)
    ky, kx = (
        np.array([(-2 - center) / focal, (size + 1 - center) / focal])
        for size, center, focal in ((color.height, cy, fy), (color.width, cx, fx))
    )
    n_u, n_v = R[0] - kx[:, None] * R[2], R[1] - ky[:, None] * R[2]
    angles = [a[0] * b[1] - a[1] * b[0] for a, b in product(n_u, n_v)]
    inverse = np.linalg.inv(R)
    rays = np.array([(x, y, 1.0) for x, y in product(kx, ky)])
    good = min(*angles, *n_u[:, 0], *n_v[:, 1], *(rays @ inverse[2]))
    if not good >= LEAST_COSINE:
        return None

    table_x, table_y = (a.astype(float) for a in corner_rays(depth))
    first = np.array([table_x[0, 0], table_y[0, 0]])
    size = 1 / np.array([float(np.float32(depth.fx)), float(np.float32(depth.fy))])
    steepest = np.array([np.abs(table_x).max(), np.abs(table_y).max(), 1.0])
    largest = np.array([np.abs(kx).max(), np.abs(ky).max()])
    terms = np.abs(R) @ steepest
    margin = MARGIN * (terms[:2].max() + largest.max() * terms[2])
    constant = MARGIN * (np.abs(t[:2]).max() + largest.max() * abs(t[2]))

    origin = -inverse @ t
    u, v = np.abs(n_u).max(axis=0), np.abs(n_v).max(axis=0)
    pixel = size if splat.fills_corners else np.zeros(2)
    spans = u[:2] @ pixel, v[:2] @ pixel
    halves = 0.5 / fx, 0.5 / fy
    reach = np.abs(inverse) @ np.array([*largest, 1.0])
    box = []
    for axis, (own, other) in enumerate((((v[1], 0), (u[1], 1)), ((u[0], 1), (v[0], 0)))):
        weights = [w / (min(angles) * size[axis]) for w, _ in (own, other)]
        spread = sum(w * halves[i] for w, (_, i) in zip(weights, (own, other), strict=True))
        before = sum(w * spans[i] for w, (_, i) in zip(weights, (own, other), strict=True))
        after = weights[1] * spans[other[1]]
        rounding = reach[axis] / (good * size[axis]) * (1 + reach[2] / good)
        still = sum(weights) * margin + 2.0**-20 * rounding + 1 / 32
        drift = abs(origin[axis]) / size[axis] + rounding * abs(origin[2])
        box += [before + still, after + still, spread, sum(weights) * constant + MARGIN * drift]

    scaled = inverse / np.array([[size[0]], [size[1]], [1.0]])
    values = [
        *scaled.ravel(), *(origin[:2] / size), origin[2], *(first / size), *box,
        margin, constant, _least_sure_depth(R, t, steepest, max(fx, fy, cx, cy)),
        *first, *size, 1 / fx, 1 / fy, *t,
    ]  # fmt: skip
    return np.array(values, np.float32)


def _least_sure_depth(R: np.ndarray, t: np.ndarray, steepest: np.ndarray, focal: float) -> float:
    """The depth [units] from which each ray's point is in front, its projection below 2^19."""
    never = 65536.0
    ahead = R[2, 2] - np.abs(R[2, :2]) @ steepest[:2] - 0.1
    aside = (np.abs(R[:2]) @ steepest).max() + 1
    if ahead <= 0 or 20 * focal * aside > 1 << 19:
        return never
    return float(min(never, np.ceil(np.abs(t[2]) / ahead + np.abs(t[:2]).max() + 1)))
