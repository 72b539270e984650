"""Pixels and points of obstacles in a frame."""

import numpy as np

from jaxdet.reference._cells import cell_boxes
from jaxdet.types import Calibration, CellLabels, Detections


def label_image(found: CellLabels, row: int, calibration: Calibration, side: int) -> np.ndarray:
    """Return the obstacle at each pixel of a frame.

    The resolution is that of the cells, 3 to 4 pixels of a depth image: a cell covers a box in the
    image of ``calibration.image``. A pixel in several boxes belongs to the nearest cell, even if
    that cell is not part of an obstacle.

    Args:
        found: Cells of a batch with their labels, NumPy arrays.
        row: Row of the frame in these arrays.
        calibration: Calibration of the log.
        side: Side of a cell [depth pixel], see :func:`jaxdet.camera.cell_side`.

    Returns:
        Labels ``(H, W)`` int32, -1 without an obstacle. The pixels of an obstacle lie in its box
        ``u_min u_max v_min v_max``.
    """
    z, camera = found.cells.z[row : row + 1], calibration.image
    low, high, used = (part[0] for part in cell_boxes(z, calibration, side))
    label, low, high = (a[used] for a in (found.label[row], low, high))
    # Cells are drawn from far to near, as the last value that is written to a pixel remains.
    order = np.lexsort((label, z[0][used]))[::-1]
    label, low, (width, height) = label[order], low[order], (high - low)[order].T + 1
    # Each row of a box is a run of pixels of the flattened image.
    cell = np.repeat(np.arange(len(label)), height)
    v = low[cell, 1] + np.arange(cell.size) - np.repeat(np.cumsum(height) - height, height)
    length = width[cell]
    start = v * camera.width + low[cell, 0] - (np.cumsum(length) - length)
    pixel = np.arange(length.sum(), dtype=np.int32) + np.repeat(start.astype(np.int32), length)
    image = np.full((camera.height, camera.width), -1, np.int32)
    image.ravel()[pixel] = np.repeat(label[cell], length)
    return image


def obstacle_points(found: Detections, row: int, unit: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the points of a frame's obstacles: depth cells, or corners with the preset ``paper``.

    Args:
        found: Detections of a batch, NumPy arrays, with cells or points.
        row: Row of the frame in these arrays.
        unit: Metres in a depth unit.

    Returns:
        Points ``(P, 3)`` float32 in the camera's optical frame [m], and ``(P,)`` int32, the
        obstacle of each point. Each obstacle has ``num_points`` points.
    """
    if found.points is not None:
        label, place = found.points.labels.labels[row], found.points.features
    else:
        assert found.cells is not None
        label, place = found.cells.label[row], found.cells.cells
    used = label >= 0
    xyz = np.stack([axis[row][used] for axis in (place.x, place.y, place.z)], axis=1)
    return (xyz.astype(np.float64) * unit).astype(np.float32), label[used]
