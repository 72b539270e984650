"""Heights, boxes and footprints of a scene's objects at a point in time."""

from functools import lru_cache

import numpy as np

from jaxdet.sim.ground import ground_height
from jaxdet.sim.scene import Scene
from jaxdet.sim.world import OUTLINE_CORNERS, bounds, heading, object_mesh, outline


@lru_cache(maxsize=4)
def placed(scene: Scene, time_s: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return heights, boxes and footprints of all objects, as in :class:`jaxdet.sim.Truth`."""
    count = len(scene.objects)
    heights = np.zeros(count, np.float32)
    boxes = np.zeros((count, 8, 3), np.float32)
    outlines = np.full((count, OUTLINE_CORNERS, 2), np.nan, np.float32)
    for j in range(count):
        mesh = object_mesh(scene, j, time_s)
        boxes[j] = bounds(mesh, heading(scene, j, time_s))
        x, y = boxes[j, :4, :2].mean(0)
        floor_z = float(ground_height(scene.ground, x, y))
        around = outline(mesh, floor_z)
        outlines[j, : len(around)] = around
        heights[j] = boxes[j, 4, 2] - floor_z
    return heights, boxes, outlines
