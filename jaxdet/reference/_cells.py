"""Cells: square blocks of the depth image, each with one robust depth and a 3D position."""

import numpy as np

from jaxdet.camera import cell_rays, cell_side, corner_rays, splat_parameters
from jaxdet.config import SurfaceConfig
from jaxdet.floor.plane import quadratic_table
from jaxdet.reference._lens import project_corners
from jaxdet.reference._rounding import lateral, rounded
from jaxdet.types import Calibration, Cells

MARGIN = 8
"""Each margin, left and right, has one in MARGIN of the image's columns. Stereo depth is bent
there."""
LEAST = 2
"""At least one in LEAST pixels of a cell must be measured."""


def cells(
    depth: np.ndarray, calibration: Calibration, config: SurfaceConfig, part: slice = slice(None)
) -> Cells:
    """Reduce depth images to a regular grid of cells in the depth camera's frame (Eq. 1).

    A cell is a square of s x s depth pixels, ``s = round(f_x cell_rad)``. Its depth is the rounded
    mean of the measured depths within the surface step of their lower median, or 0 if fewer than
    half of the pixels are measured. The mean of 16 pixels has a quarter of their noise, and a cell
    on a contour gets the depth of either the object or the background, never one in between. Its
    position is on the ray through its centre, ``P = d K^-1 p``, in fixed point.

    Args:
        depth: Depth images ``(B, Hd, Wd)`` uint16 [depth units], 0 = no measurement.
        calibration: Calibration of the log.
        config: Size of the cells, and the surface step.
        part: Rows and columns of cells to return; default: all.

    Returns:
        Cells ``(B, R, C)``; pixels to the right of and below the last complete cell are ignored.
    """
    side = cell_side(calibration.depth, config.cell_rad)
    near = quadratic_table(config.step_m, config.step_per_m, calibration.depth_unit)
    z = np.stack([_block_depth(image, side, near, part) for image in depth])
    x, y = (lateral(ray[part, part], z) for ray in cell_rays(calibration.depth, side))
    return Cells(x, y, z.astype(np.int32))


def margins(columns: int) -> np.ndarray:
    """Return whether each column is in a margin of the image, ``(columns,)`` bool."""
    column, width = np.arange(columns), columns // MARGIN
    return (column < width) | (column >= columns - width)


def _block_depth(image: np.ndarray, side: int, near: np.ndarray, part: slice) -> np.ndarray:
    """Return the depth of each block in a part of the rows and columns, int64 [depth units]."""
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


def nearest_depths(depth: np.ndarray, side: int) -> np.ndarray:
    """Return the smallest measured depth of each cell, even if the cell has no depth.

    Args:
        depth: Depth images ``(B, Hd, Wd)`` uint16 [depth units], 0 = no measurement.
        side: Side of a cell [pixel].

    Returns:
        Depth ``(B, R, C)`` int64 [depth units], 0 if no pixel is measured.

    Example:
        >>> nearest_depths(np.array([[[0, 7, 0, 0], [9, 8, 0, 0]]], np.uint16), 2).tolist()
        [[[7, 0]]]
    """
    batch, height, width = depth.shape
    rows, columns = height // side, width // side
    blocks = depth[:, : rows * side, : columns * side].reshape(batch, rows, side, columns, side)
    least = np.where(blocks > 0, blocks.astype(np.int64), 65536).min(axis=(2, 4))
    return np.where(least < 65536, least, 0)


def cell_boxes(
    z: np.ndarray, calibration: Calibration, side: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the box of each cell in the image of ``calibration.image``.

    If depth is aligned, the box is the square of the cell. Otherwise it is spanned by the
    projections of the cell's upper left and lower right corners into the colour image (Eq. 2-4), in
    the arithmetic of :func:`jaxdet.reference.paper.align`, and clipped to the image.

    Args:
        z: Depth of the cells, ``(B, R, C)`` int32 [depth units].
        calibration: Calibration of the log.
        side: Side of a cell [depth pixel].

    Returns:
        First and last column and row, ``(B, R, C, 2)`` int32 each, and whether the cell is measured
        and at least partly in the image, ``(B, R, C)`` bool. Boxes of other cells are 0.
    """
    seen = z > 0
    _, row, column = np.nonzero(seen)
    low, high = np.zeros((2, *z.shape, 2), np.int32)
    if calibration.is_aligned:
        low[seen] = first = np.stack([column, row], axis=-1) * side
        high[seen] = first + side - 1
        return low, high, seen
    splat, color = splat_parameters(calibration), calibration.image
    x, y = corner_rays(calibration.depth)
    corners, inside = [], np.ones(row.size, bool)
    for shift in (0, side):
        ray = row * side + shift, column * side + shift
        u, v, _, fits = project_corners(x[ray], y[ray], z[seen].astype(np.uint16), splat)
        corners.append(np.stack([u, v], axis=-1))
        inside &= fits
    first, last = np.minimum(*corners), np.maximum(*corners)
    most = np.array([color.width - 1, color.height - 1])
    inside &= ((last >= 0) & (first <= most)).all(axis=-1)
    seen[seen] = inside
    low[seen], high[seen] = (np.clip(a[inside], 0, most) for a in (first, last))
    return low, high, seen
