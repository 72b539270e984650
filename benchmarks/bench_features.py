"""Stage 3, features, against OpenCV one frame at a time."""

import cv2
import jax
import numpy as np

from benchmarks.run import Case
from benchmarks.scene import BATCH, CALIBRATIONS, CONFIG, Inputs, inputs
from jaxdet import stages


def cases() -> list[Case]:
    """Corners at two sizes; the colour images come from the host each time."""
    return [_case(size) for size in CALIBRATIONS]


def opencv(given: Inputs) -> list[np.ndarray]:
    """Grey, Canny, Shi-Tomasi under the mask: corners without their depth."""
    config = CONFIG.features
    found = []
    for color, keep in zip(given.color, given.keep.mask, strict=True):
        grey = cv2.cvtColor(color, cv2.COLOR_RGB2GRAY)
        edges = cv2.Canny(grey, config.canny_low, config.canny_high)
        corners = cv2.goodFeaturesToTrack(
            edges,
            config.max_corners,
            config.quality_level,
            config.min_distance,
            mask=keep.astype(np.uint8),
            blockSize=config.block_size,
        )
        found.append(np.zeros((0, 1, 2)) if corners is None else corners)
    return found


def _case(size: str) -> Case:
    given = inputs(size)
    keep = jax.device_put(given.keep)
    return Case(
        name=f"{size}.b{BATCH}",
        run=lambda: stages.features(given.color, keep, given.calibration, CONFIG.features),
        frames=BATCH,
        peer=lambda: opencv(given),
    )
