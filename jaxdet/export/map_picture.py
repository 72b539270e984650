"""Map of a log as a small RGBA picture."""

import cv2
import numpy as np

from jaxdet.results.occupancy import MapImage

MOST_CELLS = 720
"""Maximum side of a picture [pixel]; in larger maps a pixel is the maximum of several cells."""
FREE = (122, 150, 140)
FREE_ALPHA = 70


def map_picture(image: MapImage) -> tuple[np.ndarray, float]:
    """Draw cells covered by outlines in the colour map ``inferno``, and free cells in grey.

    Args:
        image: Map.

    Returns:
        Picture ``(h, w, 4)`` uint8, RGBA, with the lowest Y in row 0 and transparent unknown cells;
        and the side of a pixel [m]. The outer corner of pixel (0, 0) is the map's origin.
    """
    side = -(-max(image.counts.shape) // MOST_CELLS)
    counts, free = _largest(image.counts, side), _largest(image.free, side)
    most = max(int(counts.max(initial=0)), 1)
    share = np.log1p(np.maximum(counts - 1, 0)) / max(np.log1p(most - 1), 1e-9)
    level = (90 + 130 * np.clip(share, 0, 1)).astype(np.uint8)
    heat = cv2.applyColorMap(level, cv2.COLORMAP_INFERNO)[..., ::-1]
    picture = np.zeros((*counts.shape, 4), np.uint8)
    picture[free > 0] = (*FREE, FREE_ALPHA)
    used = counts > 0
    picture[used, :3], picture[used, 3] = heat[used], 255
    return picture, side * image.cell_m


def _largest(cells: np.ndarray, side: int) -> np.ndarray:
    """Return the maximum of each block of ``side`` × ``side`` cells."""
    rows, columns = (-(-n // side) * side for n in cells.shape)
    whole = np.zeros((rows, columns), cells.dtype)
    whole[: cells.shape[0], : cells.shape[1]] = cells
    return whole.reshape(rows // side, side, columns // side, side).max(axis=(1, 3))
