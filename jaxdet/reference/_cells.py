"""Cells: the depth image in square blocks, each with one robust depth and its place in space."""

import numpy as np

from jaxdet.camera import cell_rays, cell_side, corner_rays, splat_parameters
from jaxdet.config import SurfaceConfig
from jaxdet.floor.plane import quadratic_table
from jaxdet.reference._align import project_corners
from jaxdet.reference._features import lateral
from jaxdet.reference._rounding import rounded
from jaxdet.types import Calibration, Cells, Intrinsics

MARGIN = 8
"""This part of the columns at each side is the image's margin: stereo depth bends up there."""
LEAST = 2  # one of so many pixels of a cell must be measured


def cells(depth: np.ndarray, calibration: Calibration, config: SurfaceConfig) -> Cells:
    """Reduces depth images to a regular grid of cells in the colour camera's frame (Eq. 1-4).

    A cell is a square of s x s depth pixels, ``s = round(f_x cell_rad)``. Its depth is the mean
    of the measured depths within the surface step of their lower median, rounded, and 0 where
    fewer than half of the pixels are measured: the mean of 16 pixels has a quarter of their
    noise, and a cell on a contour is either the thing or the background, never something between.

    The cell's centre is moved into the colour camera with the rotated ray of its middle in fixed
    point, ``P = (R K_d^-1 p) d + t`` (Eq. 1-3); its box in the colour image is spanned by the
    projections of its upper left and lower right corners in the arithmetic of
    :func:`jaxdet.reference.align` (Eq. 4).

    Args:
        depth: ``(B, Hd, Wd)`` uint16 [depth units], 0 = no measurement.
        calibration: The log's calibration; depth may be aligned already.
        config: The cells' size and the step.

    Returns:
        ``(B, R, C)`` cells; pixels right of and below the last whole cell are left out.
    """
    side = cell_side(calibration.depth or calibration.color, config.cell_rad)
    x, y, z, d = cell_centers(depth, calibration, config)
    return Cells(x, y, z, *_boxes(d, z > 0, side, calibration))


def cell_centers(
    depth: np.ndarray, calibration: Calibration, config: SurfaceConfig, part: slice = slice(None)
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Where the cells are, or a part of their rows and columns, and the depth of each.

    Returns:
        x, y and z as :class:`jaxdet.types.Cells` has them, ``(B, R, C)`` int32, and the depth in
        the depth image, int64 [depth units].
    """
    side = cell_side(calibration.depth or calibration.color, config.cell_rad)
    near = quadratic_table(config.step_m, config.step_per_m, calibration.depth_unit)
    d = np.stack([_block_depth(image, side, near, part) for image in depth])
    rays, offset = cell_rays(calibration, side)
    x, y, z = (
        np.where(d > 0, lateral(ray[part, part], d) + start, 0)
        for ray, start in zip(rays, offset, strict=True)
    )
    seen, z = (d > 0) & (z > 0), np.minimum(z, 65535)
    x, y, z = (np.where(seen, a, 0).astype(np.int32) for a in (x, y, z))
    return x, y, z, d


def cover(grid: Cells, keep: np.ndarray, camera: Intrinsics) -> np.ndarray:
    """The nearest kept cell whose box, a pixel wider at each side, covers a colour pixel.

    Args:
        grid: The cells.
        keep: ``(B, R, C)`` bool, those that take part, all of them in view.
        camera: The colour camera.

    Returns:
        ``(B, H, W)`` int64, its index in the flattened grid, of equally near ones the first; -1
        where there is none.
    """
    out = np.full((len(keep), camera.height, camera.width), -1)
    for b, image in enumerate(out):
        cell = np.flatnonzero(keep[b])
        cell = cell[np.lexsort((cell, grid.z[b].ravel()[cell]))][::-1]
        left, top = (grid.uv_min[b].reshape(-1, 2)[cell] - 1).T
        right, bottom = (grid.uv_max[b].reshape(-1, 2)[cell] + 1).T
        for k, one in enumerate(cell.tolist()):
            image[max(top[k], 0) : bottom[k] + 1, max(left[k], 0) : right[k] + 1] = one
    return out


def margins(columns: int) -> np.ndarray:
    """The outer ``MARGIN`` of the columns at each side, ``(columns,)`` bool."""
    column, width = np.arange(columns), columns // MARGIN
    return (column < width) | (column >= columns - width)


def _block_depth(image: np.ndarray, side: int, near: np.ndarray, part: slice) -> np.ndarray:
    """The depth of each block of a part of the rows and columns, int64 [depth units]."""
    rows, columns = (size // side for size in image.shape)
    blocks = image[: rows * side, : columns * side].reshape(rows, side, columns, side)
    blocks = blocks.transpose(0, 2, 1, 3)[part, part]
    values = blocks.reshape(*blocks.shape[:2], side * side).astype(np.int64)
    measured = values > 0
    count = measured.sum(axis=-1)
    ordered = np.sort(np.where(measured, values, 65536), axis=-1)
    middle = np.maximum((count - 1) // 2, 0)[..., None]
    median = np.where(
        LEAST * count >= side * side, np.take_along_axis(ordered, middle, -1)[..., 0], 0
    )
    used = measured & (np.abs(values - median[..., None]) <= near[median][..., None])
    number = np.maximum(used.sum(axis=-1), 1)
    mean = rounded(np.where(used, values, 0).sum(axis=-1), number)
    return np.where(median > 0, mean, 0)


def _boxes(
    d: np.ndarray, seen: np.ndarray, side: int, calibration: Calibration
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The first and the last colour pixel of each cell, clipped, and whether any is inside.

    Boxes of cells that are not in view are zero.
    """
    batch, rows, columns = d.shape
    top, left = (a * side for a in np.mgrid[0:rows, 0:columns])
    if calibration.is_aligned:
        first = np.broadcast_to(np.stack([left, top], axis=-1), (batch, rows, columns, 2))
        first, last = (np.where(seen[..., None], a, 0) for a in (first, first + side - 1))
        return first.astype(np.int16), last.astype(np.int16), seen
    assert calibration.depth is not None
    splat, color = splat_parameters(calibration), calibration.color
    x, y = corner_rays(calibration.depth)
    low, high = np.zeros((*d.shape, 2), np.int32), np.zeros((*d.shape, 2), np.int32)
    inside = seen.copy()
    for shift, corner in ((0, low), (side, high)):
        ray = x[top + shift, left + shift], y[top + shift, left + shift]
        ray_x, ray_y = (np.broadcast_to(a, d.shape)[seen] for a in ray)
        u, v, _, fits = project_corners(ray_x, ray_y, d[seen].astype(np.uint16), splat)
        corner[seen] = np.stack([u, v], axis=-1)
        inside[seen] &= fits
    low, high = np.minimum(low, high), np.maximum(low, high)
    last = np.array([color.width - 1, color.height - 1])
    inside &= ((high >= 0) & (low <= last)).all(axis=-1)
    low, high = (np.where(inside[..., None], np.clip(a, 0, last), 0) for a in (low, high))
    return low.astype(np.int16), high.astype(np.int16), inside
