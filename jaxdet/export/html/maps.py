"""Maps of logs with the camera's path, for an SVG."""

from typing import Any

import cv2
import numpy as np

from jaxdet.export.html.images import data_url
from jaxdet.export.map_picture import map_picture
from jaxdet.results.occupancy import MapImage

MOST_POINTS = 800
"""Maximum number of points of the path."""
LOSSLESS = 101
"""WebP quality for lossless compression."""


def map_figure(image: MapImage) -> dict[str, Any]:
    """Return the data of a map for the page.

    Args:
        image: Map of a log.

    Returns:
        ``picture`` (a data URL, X to the right and Y up), ``x``, ``y`` (world coordinates of its
        lower left corner), ``width`` and ``height`` [m], ``cell`` (side of a pixel [m]) and
        ``path`` (alternating X and Y [m]).
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
