"""Which pixels of the colour image, and which points, are an obstacle's."""

import numpy as np

from jaxdet.types import CellLabels, Detections, Intrinsics


def label_image(found: CellLabels, row: int, camera: Intrinsics) -> np.ndarray:
    """The obstacle on each pixel of a frame.

    As fine as the depth cells are, 3 to 4 pixels of a depth image: a cell covers its box in the
    colour image. Where several cells cover a pixel it is the nearest one's, obstacle or not.

    Args:
        found: NumPy arrays, with the cells of the frame.
        row: The frame's row in them.
        camera: The colour camera.

    Returns:
        ``(H, W)`` int32, -1 = none. An obstacle's pixels lie in its ``u_min u_max v_min v_max``.
    """
    grid, used = found.cells, found.cells.in_view[row]
    label, low, high = (a[row][used] for a in (found.label, grid.uv_min, grid.uv_max))
    # From far to near, as of several values that a pixel is given the last one stays.
    order = np.lexsort((label, grid.z[row][used]))[::-1]
    label, low, size = label[order], low[order], (high - low)[order] + 1
    area = size.prod(axis=1)
    cell = np.repeat(np.arange(len(label)), area)
    place = np.arange(len(cell)) - np.repeat(np.cumsum(area) - area, area)
    v, u = np.divmod(place, size[cell, 0])
    image = np.full((camera.height, camera.width), -1, np.int32)
    image[low[cell, 1] + v, low[cell, 0] + u] = label[cell]
    return image


def obstacle_points(found: Detections, row: int, unit: float) -> tuple[np.ndarray, np.ndarray]:
    """The points of a frame's obstacles: the cells in the colour image, else the points clustered.

    Args:
        found: NumPy arrays, with cells where obstacles are made of surfaces.
        row: The frame's row in them.
        unit: Metres in a depth unit.

    Returns:
        ``(P, 3)`` float32 in the colour optical frame [m], and ``(P,)`` int32, the obstacle of
        each; ``num_points`` of each obstacle.
    """
    if found.cells is None:
        label, place = found.labels.labels[row], found.features
        used = label >= 0
    else:
        label, place = found.cells.label[row], found.cells.cells
        used = (label >= 0) & place.in_view[row]
    xyz = np.stack([axis[row][used] for axis in (place.x, place.y, place.z)], axis=1)
    return (xyz.astype(np.float64) * unit).astype(np.float32), label[used]
