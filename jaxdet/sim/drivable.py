"""Ground truth of the drivable floor: its pixels, and where the floor steps down."""

from typing import NamedTuple

import numpy as np

from jaxdet.sim.config import calibration_of
from jaxdet.sim.frames import SimFrame
from jaxdet.sim.ground import RISER_M, ground_height
from jaxdet.sim.placed import placed
from jaxdet.sim.render import PixelKind
from jaxdet.sim.robot import ground_frame
from jaxdet.sim.scene import Ground
from jaxdet.sim.world import STEP_M

EDGE_BEARINGS_RAD = np.radians(np.arange(-40.0, 41.0))
"""Bearings of ``Truth.edge_m``, ``(K,)``, clockwise seen from above, 0 straight ahead [rad]."""
_HIDDEN = 0.97
"""A surface hides an edge if its depth is less than this fraction of the edge's depth."""


class FloorTruth(NamedTuple):
    """Ground truth of the floor at each pixel of a colour image."""

    drivable: np.ndarray
    """Whether the pixel shows drivable floor, ``(H, W)`` bool: on the robot's level (ramps too),
    not beyond a step down, outside of the footprints of objects and walls higher than 5 cm."""
    points_m: np.ndarray
    """Exact coordinates (right, forward) in the camera's ground frame, ``(H, W, 2)`` float32 [m];
    NaN outside of the floor."""


def floor_truth(frame: SimFrame) -> FloorTruth:
    """Return the floor of a frame, for instance to measure the fraction that detections cover.

    Args:
        frame: Frame from :func:`jaxdet.sim.simulate` or :func:`jaxdet.sim.sample_frames`.

    Returns:
        The floor of each colour pixel.
    """
    floor = frame.truth.kind == PixelKind.FLOOR
    points = frame.truth.points[floor]
    x, y = np.ascontiguousarray(points[:, :2].T)
    free = _level(frame.scene.ground, x, y)
    heights, _, outlines = placed(frame.scene, frame.time_s if frame.scene.moves else 0.0)
    for outline in outlines[heights > STEP_M]:
        corners = outline[~np.isnan(outline[:, 0])].astype(np.float64)
        (x0, y0), (x1, y1) = corners.min(0), corners.max(0)
        near = np.flatnonzero((x >= x0) & (x <= x1) & (y >= y0) & (y <= y1) & free)
        free[near[_inside(points[near, :2], corners)]] = False
    drivable = np.zeros(floor.shape, bool)
    drivable[floor] = free
    T = ground_frame(frame.T_world_base)
    ground = np.full((*floor.shape, 2), np.nan, np.float32)
    ground[floor] = points @ T[:2, :3].T + T[:2, 3]
    return FloorTruth(drivable, ground)


def floor_edge(
    frame: SimFrame, bearings_rad: np.ndarray = EDGE_BEARINGS_RAD
) -> tuple[np.ndarray, np.ndarray]:
    """Return the distance of the first step down, by bearing.

    Args:
        frame: Frame.
        bearings_rad: Bearings ``(K,)``, clockwise from above, 0 ahead: ``arctan2(right, forward)``.

    Returns:
        Distance from the camera's ground projection to the edge, ``(K,)`` float32 [m], NaN without
        an edge; and whether the colour camera sees it, ``(K,)`` bool.
    """
    bearings = np.asarray(bearings_rad, np.float64)
    distance, seen = np.full(bearings.shape, np.nan), np.zeros(bearings.shape, bool)
    ground = frame.scene.ground
    if not ground.edges_m:
        return distance.astype(np.float32), seen
    x, y = frame.T_world_base[:2, 3]
    yaw = np.arctan2(frame.T_world_base[1, 0], frame.T_world_base[0, 0])
    way = np.stack([np.cos(yaw - bearings), np.sin(yaw - bearings)], axis=-1)
    axis = np.array([np.cos(ground.slope_yaw), np.sin(ground.slope_yaw)])
    ahead = ground.edges_m[0] - axis @ (x, y)
    meets = (way @ axis > 1e-6) & (ahead > 0)
    distance[meets] = ahead / (way[meets] @ axis)
    edge = np.array([x, y]) + distance[meets, None] * way[meets]
    before = edge - 2 * RISER_M * axis
    z = ground_height(ground, before[:, 0], before[:, 1])
    seen[meets] = _seen(frame, np.column_stack([edge, z]))
    return distance.astype(np.float32), seen


def _seen(frame: SimFrame, points: np.ndarray) -> np.ndarray:
    """Return which world points ``(n, 3)`` are in the colour image and not occluded."""
    camera, T = calibration_of(frame.config).image, frame.T_world_color
    x, y, z = ((points - T[:3, 3]) @ T[:3, :3]).T
    ahead = np.where(z > 0, z, np.inf)
    u = np.rint(x / ahead * camera.fx + camera.cx).astype(int)
    v = np.rint(y / ahead * camera.fy + camera.cy).astype(int)
    inside = (z > 0) & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    inside[inside] = frame.truth.depth[v[inside], u[inside]] > _HIDDEN * z[inside]
    return inside


def _level(ground: Ground, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return which positions are on the robot's level, that is, before the first step down."""
    if not ground.edges_m:
        return np.ones(x.shape, bool)
    along = np.cos(ground.slope_yaw) * x + np.sin(ground.slope_yaw) * y
    return along <= ground.edges_m[0]


def _inside(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return which points ``(n, 2)`` are in a counter-clockwise convex polygon ``(k, 2)``."""
    edge = np.roll(corners, -1, axis=0) - corners
    to = points[:, None] - corners
    return np.all(edge[:, 0] * to[..., 1] - edge[:, 1] * to[..., 0] >= 0, axis=1)
