"""Maps of logs with their path, for an SVG to show."""

from typing import Any

import cv2
import numpy as np

from jaxdet.export.html.images import data_url
from jaxdet.export.map_picture import map_picture
from jaxdet.results.occupancy import MapImage

MOST_POINTS = 800
"""Of the path."""
LOSSLESS = 101
"""WebP's quality that says so."""


def map_figure(image: MapImage) -> dict[str, Any]:
    """What the page needs to draw a map.

    Args:
        image: The map of a log.

    Returns:
        ``picture`` (a data URL, X to the right and Y up), its ``x``, ``y`` (world coordinates of
        its lower left corner), ``width`` and ``height`` [m], ``cell`` (side of a pixel [m]) and
        ``path``, a list of X and Y in turn [m].
    """
    picture, cell_m = map_picture(image)
    height, width = picture.shape[:2]
    step = -(-max(len(image.path), 1) // MOST_POINTS)
    path = np.concatenate([image.path[::step], image.path[-1:]])
    return {
        "picture": data_url(cv2.cvtColor(picture[::-1], cv2.COLOR_RGBA2BGRA), LOSSLESS),
        "x": round(image.origin[0], 3),
        "y": round(image.origin[1], 3),
        "width": round(width * cell_m, 3),
        "height": round(height * cell_m, 3),
        "cell": round(cell_m, 3),
        "path": np.round(path, 3).ravel().tolist(),
    }
