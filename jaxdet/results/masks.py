"""Pixels and points of obstacles."""

import numpy as np

from jaxdet.reference._cells import cell_boxes
from jaxdet.types import Calibration, CellLabels, Detections


def label_image(found: CellLabels, row: int, calibration: Calibration, side: int) -> np.ndarray:
    """Return the obstacle on each pixel of a frame.

    It is as fine as the depth cells, 3 to 4 pixels of a depth image: a cell covers its box in the
    image of ``calibration.image``. Where several cells cover a pixel it is the nearest one's,
    obstacle or not.

    Args:
        found: NumPy arrays, with the cells of the frame.
        row: Row of the frame in them.
        calibration: Calibration of the log.
        side: Side of a cell [depth pixel], see :func:`jaxdet.camera.cell_side`.

    Returns:
        ``(H, W)`` int32, -1 = none. Pixels of an obstacle lie in its ``u_min u_max v_min v_max``.
    """
    z, camera = found.cells.z[row : row + 1], calibration.image
    low, high, used = (part[0] for part in cell_boxes(z, calibration, side))
    label, low, high = (a[used] for a in (found.label[row], low, high))
    # From far to near: of several values for a pixel the last one stays.
    order = np.lexsort((label, z[0][used]))[::-1]
    label, low, size = label[order], low[order], (high - low)[order] + 1
    area = size.prod(axis=1)
    cell = np.repeat(np.arange(len(label)), area)
    place = np.arange(len(cell)) - np.repeat(np.cumsum(area) - area, area)
    v, u = np.divmod(place, size[cell, 0])
    image = np.full((camera.height, camera.width), -1, np.int32)
    image[low[cell, 1] + v, low[cell, 0] + u] = label[cell]
    return image


def obstacle_points(found: Detections, row: int, unit: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the points of a frame's obstacles: its cells, in the preset ``paper`` its corners.

    Args:
        found: NumPy arrays, with cells or points.
        row: Row of the frame in them.
        unit: Metres in a depth unit.

    Returns:
        ``(P, 3)`` float32 in the camera's optical frame [m], and ``(P,)`` int32, the obstacle of
        each; ``num_points`` of each obstacle.
    """
    if found.points is not None:
        label, place = found.points.labels.labels[row], found.points.features
    else:
        assert found.cells is not None
        label, place = found.cells.label[row], found.cells.cells
    used = label >= 0
    xyz = np.stack([axis[row][used] for axis in (place.x, place.y, place.z)], axis=1)
    return (xyz.astype(np.float64) * unit).astype(np.float32), label[used]
