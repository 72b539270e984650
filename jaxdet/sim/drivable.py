"""Where the robot can truly drive: which pixels show such floor, and where the floor steps down."""

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
"""``(K,)`` the bearings of ``Truth.edge_m``: clockwise from above, 0 ahead [rad]."""
_HIDDEN = 0.97
"""An edge is hidden by what is nearer than this share of its depth."""


class FloorTruth(NamedTuple):
    """The floor that a frame's colour pixels show."""

    drivable: np.ndarray
    """``(H, W)`` bool: the pixel shows floor on the robot's level (ramps too), outside the
    footprints of all things and walls higher than 5 cm. Floor beyond a step down is not."""
    points_m: np.ndarray
    """``(H, W, 2)`` float32: right, forward in the camera's ground frame, exact [m]; NaN where
    no floor is seen, drivable or not."""


def floor_truth(frame: SimFrame) -> FloorTruth:
    """The floor of a frame, for instance to count how much of it lies in found outlines.

    Args:
        frame: Of :func:`jaxdet.sim.simulate` or :func:`jaxdet.sim.sample_frames`.

    Returns:
        A part of it for each colour pixel.
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
    """Where the floor steps down first, by bearing.

    Args:
        frame: A frame.
        bearings_rad: ``(K,)`` clockwise from above, 0 ahead: ``arctan2(right, forward)``.

    Returns:
        ``(K,)`` float32, distance from the camera's foot to the edge [m], NaN where the floor goes
        on; ``(K,)`` bool, whether the colour camera sees the edge there.
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
    """Which world points ``(n, 3)`` are in the colour picture and not hidden."""
    camera, T = calibration_of(frame.config).image, frame.T_world_color
    x, y, z = ((points - T[:3, 3]) @ T[:3, :3]).T
    ahead = np.where(z > 0, z, np.inf)
    u = np.rint(x / ahead * camera.fx + camera.cx).astype(int)
    v = np.rint(y / ahead * camera.fy + camera.cy).astype(int)
    inside = (z > 0) & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    inside[inside] = frame.truth.depth[v[inside], u[inside]] > _HIDDEN * z[inside]
    return inside


def _level(ground: Ground, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Which places lie before the first step down."""
    if not ground.edges_m:
        return np.ones(x.shape, bool)
    along = np.cos(ground.slope_yaw) * x + np.sin(ground.slope_yaw) * y
    return along <= ground.edges_m[0]


def _inside(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Which points ``(n, 2)`` lie in a convex outline ``(k, 2)``, counter-clockwise."""
    edge = np.roll(corners, -1, axis=0) - corners
    to = points[:, None] - corners
    return np.all(edge[:, 0] * to[..., 1] - edge[:, 1] * to[..., 0] >= 0, axis=1)
