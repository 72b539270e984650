"""Metric values of obstacles, computed from integers on the host, for all backends.

The stages return integers in depth units. Metric values are computed from them here, in NumPy
float64, so that results don't depend on the backend, the batch or the device. Only this module
converts between the yaw of ROS and the angle of Eq. 8-9, see :func:`world_angle`.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxdet.arguments import number, numeric, of_type
from jaxdet.config import FootprintConfig
from jaxdet.elementary import cos, dot, norm
from jaxdet.errors import InputError
from jaxdet.floor.plane import down_vector
from jaxdet.floor.units import FloorFit, floor_fit
from jaxdet.io.motion import motion_matrix
from jaxdet.types import Array, Detections, Obstacles, Scene

MOST_TILT_DEG = 30.0
"""Largest tilt of floors in a world whose z is up; ramps are up to 20° steep [degree]."""
_LEAST_UP = float(cos(np.radians(MOST_TILT_DEG)))
TILT = "camera_orientation_world", "camera_pitch_rad", "camera_roll_rad"
"""Columns of ``frames.parquet`` that :func:`tilted` takes."""


class Extents(NamedTuple):
    """Boxes and centroids in the camera's optical frame; 0 in empty slots."""

    minimum: np.ndarray
    """Minimum x, y and z, ``(..., 3)`` float32 [m]."""
    maximum: np.ndarray
    """Maximum x, y and z, ``(..., 3)`` float32 [m]."""
    centroid: np.ndarray
    """Centroid x, y and z, ``(..., 3)`` float32 [m]."""


def extents(obstacles: Obstacles, depth_unit: float) -> Extents:
    """Return the boxes and centroids of a batch of obstacles.

    Args:
        obstacles: Integer outlines in slots of any shape ``(...)``, for instance ``(B, M)``.
        depth_unit: Metres in one depth unit.

    Returns:
        Boxes and centroids in metres, computed in float64 and rounded once.

    Raises:
        InputError: The arrays have other shapes than obstacles, or the unit is not a number.
    """
    _check(obstacles, depth_unit, ("num_points", "xyz_min", "xyz_max", "xyz_sum"))
    points = np.maximum(np.asarray(obstacles.num_points), 1).astype(np.float64)
    centroid = dot(obstacles.xyz_sum, np.array([65536.0, 1.0])) / points[..., None]
    return Extents(
        *(
            (np.asarray(a).astype(np.float64) * depth_unit).astype(np.float32)
            for a in (obstacles.xyz_min, obstacles.xyz_max, centroid)
        )
    )


def _check(obstacles: Obstacles, depth_unit: float, parts: Sequence[str]) -> None:
    """Check the arrays of obstacles that ``parts`` names; the first has a single value per slot."""
    of_type("obstacles", obstacles, Obstacles)
    if not 0 < number("depth_unit", depth_unit) < math.inf:
        problem, remedy = f"{depth_unit:g} m", "pass the metres of a depth unit"
        raise InputError(problem, topic="depth_unit", remedy=remedy)
    slots = numeric(f"obstacles.{parts[0]}", getattr(obstacles, parts[0])).shape
    for name in parts:
        shape = numeric(f"obstacles.{name}", getattr(obstacles, name)).shape
        wanted = (*slots, *_PARTS.get(name, ()))
        if shape != wanted:
            raise InputError(
                f"shape {shape}", topic=f"obstacles.{name}", remedy=f"pass shape {wanted}"
            )


_PARTS = dict.fromkeys(("a", "b", "c", "direction"), (2,)) | {
    "xyz_min": (3,),
    "xyz_max": (3,),
    "xyz_sum": (3, 2),
    "span": (4,),
}
"""Shape of each part of an obstacle that is not a single number."""


def floors(scene: Scene, depth_unit: float) -> FloorFit:
    """Return the floor of each frame in metres and radians: its own floor, or the prior.

    Args:
        scene: NumPy or JAX arrays.
        depth_unit: Metres in one depth unit.
    """
    return floor_fit(np.asarray(scene.floor), scene.prior, depth_unit)


def distances(detections: Detections) -> np.ndarray:
    """Return the distance on the floor from the camera's ground projection to each obstacle.

    Args:
        detections: NumPy or JAX arrays.

    Returns:
        Distance to the nearest point of the contour, or of all points if there is no contour,
        ``(B, M)`` float64 [depth units]; 0 in empty slots.
    """
    scene = detections.scene
    if scene is None:
        return point_distances(detections.obstacles)
    found = np.zeros(np.shape(scene.contour_points))
    used = np.nonzero(np.asarray(scene.contour_points))
    found[used] = nearest(*contour_lines(scene.contour, scene.contour_points, *used))
    return found


def point_distances(obstacles: Obstacles) -> np.ndarray:
    """Return the distance to the nearest point of clusters of points, ``(...)`` [depth units]."""
    assert obstacles.nearest is not None  # only obstacles made of surfaces lack it
    return np.sqrt(dot(obstacles.nearest, np.array([262144.0, 1.0])))


def distance_text(distance_m: float | None, depth_m: float) -> str:
    """Return the text of a distance or, if the distance is unknown, of the depth after ``~``.

    Example:
        >>> distance_text(1.234, 1.1), distance_text(None, 1.1)
        ('1.23 m', '~1.10 m')
    """
    return f"~{depth_m:.2f} m" if distance_m is None else f"{distance_m:.2f} m"


def rectangle_distances(corners: np.ndarray) -> np.ndarray:
    """Return the distance from the camera's ground projection to the nearest point of a rectangle.

    Args:
        corners: Corners ``(..., 4, 2)`` in order around the rectangle, ground frame [m].

    Returns:
        Distances ``(...)`` float64 [m]; 0 if the camera is above the rectangle.

    Example:
        >>> float(rectangle_distances(np.array([[-1, 2], [1, 2], [1, 3], [-1, 3]])))
        2.0
    """
    start = np.asarray(corners).astype(np.float64)
    edge = np.roll(start, -1, axis=-2) - start
    length = dot(edge, edge)
    share = np.divide(-dot(start, edge), length, out=np.zeros_like(length), where=length > 0)
    foot = start + np.clip(share, 0, 1)[..., None] * edge
    side = edge[..., 0] * start[..., 1] - edge[..., 1] * start[..., 0]
    inside = (side > 0).all(axis=-1) | (side < 0).all(axis=-1)
    return np.where(inside, 0.0, norm(foot).min(axis=-1))


def contour_lines(
    contour: Array,
    contour_points: Array,
    row: np.ndarray,
    slot: np.ndarray,
    backward: np.ndarray | bool = False,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the contours of selected obstacles without padding, one after the other.

    Args:
        contour: Contours of :class:`jaxdet.types.Scene`, ``(B, M, C, 2)`` int32.
        contour_points: Number of points of each contour, ``(B, M)`` int32.
        row: Frames of the obstacles, ``(R,)``.
        slot: Slots of the obstacles, ``(R,)``.
        backward: Whether to reverse each contour, ``(R,)`` bool.

    Returns:
        Points ``(P, 2)`` int32 [depth units], and the number of points per obstacle, ``(R,)``
        int32.
    """
    count = np.asarray(contour_points)[row, slot]
    contour = np.ascontiguousarray(contour, np.int32)
    _, slots, columns, _ = contour.shape
    first = np.cumsum(count) - count
    at = np.repeat((row * slots + slot) * columns - first, count)
    at += np.arange(at.size)
    if np.any(backward):
        order = np.repeat(2 * first + count - 1, count) - np.arange(at.size)
        at = np.where(np.repeat(backward, count), at[order], at)
    pairs = contour.view(np.int64).ravel()  # both coordinates of a point are copied together
    return pairs[at].view(np.int32).reshape(-1, 2), count


def nearest(points: np.ndarray, count: np.ndarray) -> np.ndarray:
    """Return the distance from the origin to the nearest point of each line.

    Args:
        points: Points of all lines, one after the other, ``(P, 2)``.
        count: Number of points of each line, ``(R,)`` integer.

    Returns:
        Distances ``(R,)`` float64, 0 for lines without points.
    """
    squared, used = np.zeros(len(count)), count > 0
    squared[used] = np.minimum.reduceat(_squared(points), (np.cumsum(count) - count)[used])
    return np.sqrt(squared)


def _squared(points: np.ndarray) -> np.ndarray:
    """Return the squared distances of points ``(..., 2)`` from the origin, float64."""
    x, y = points[..., 0].astype(np.float64), points[..., 1].astype(np.float64)
    return x * x + y * y


def rectangles(obstacles: Obstacles, depth_unit: float, config: FootprintConfig) -> np.ndarray:
    """Return the outline of each obstacle on the floor (Section 3.5, Eq. 7).

    The outline is a rectangle. A and B, the leftmost and the rightmost point of the obstacle, are
    the ends of one of its edges. If C, the nearest point, is a vertex, the opposite edge is on the
    parallel to AB through C. Otherwise the opposite edge is ``extension_m`` behind AB, away from
    the camera. Then the margin ``margin_m + margin_per_m2 z²`` is added on all sides; z is the
    smallest depth of the obstacle.

    Obstacles made of surfaces have a fitted rectangle instead, in the fields ``direction`` and
    ``span``. Only the margin is added to it, and AB is the side whose middle is nearest to the
    camera.

    If A and B coincide, AB is assumed to be lateral, so that its normal points forward. If AB
    points forward, its normals are lateral, and the one that points away from the forward axis is
    used (to the right, if AB is on the axis).

    Args:
        obstacles: Integer outlines in slots of any shape ``(...)``, for instance ``(B, M)``.
        depth_unit: Metres in one depth unit.
        config: The fixed extension and the margin.

    Returns:
        Corners in the ground frame, right and forward, ``(..., 4, 2)`` float64 [m], in the order A,
        B, the corner opposite A, the corner opposite B.

    Raises:
        InputError: The arrays are not those of obstacles, or the unit is not a number.
    """
    of_type("config", config, FootprintConfig)
    _check(obstacles, depth_unit, ("has_vertex", "a", "b", "c", "direction", "span", "xyz_min"))
    if np.any(obstacles.direction):
        return _fitted_rectangles(obstacles, depth_unit, config)
    a, b, c = (np.asarray(p).astype(np.float64) for p in (obstacles.a, obstacles.b, obstacles.c))
    edge = b - a
    length = norm(edge)[..., None]
    along = np.divide(edge, length, out=np.zeros_like(edge), where=length > 0)
    along = np.where(length > 0, along, [1.0, 0.0])
    across = _backward_normal(a, along)
    has_vertex = np.asarray(obstacles.has_vertex)
    left, right = dot(a, along), dot(b, along)
    front = dot(a, across)
    back = np.where(has_vertex, dot(c, across), front + config.extension_m / depth_unit)
    margin = _margin(obstacles, depth_unit, config)
    outward = np.where(front <= back, margin, -margin)
    sides = left - margin, right + margin, front - outward, back + outward
    return _corners(along, across, *sides) * depth_unit


def _fitted_rectangles(
    obstacles: Obstacles, depth_unit: float, config: FootprintConfig
) -> np.ndarray:
    """Return the fitted rectangles of obstacles with a margin, ``(..., 4, 2)`` float64 [m]."""
    edge = np.asarray(obstacles.direction).astype(np.float64)
    length = norm(edge)[..., None]
    scale = np.where(length > 0, length, 1.0)
    along, span = edge / scale, np.asarray(obstacles.span) / scale
    across = np.stack([-along[..., 1], along[..., 0]], axis=-1)
    margin = _margin(obstacles, depth_unit, config)
    left, right, near, far = np.moveaxis(span, -1, 0)
    # Sides of the rectangle with its margin. Edge 0 is the side ``near``.
    sides = left - margin, right + margin, near - margin, far + margin
    ring = _corners(along, across, *sides)
    middle = ring + np.roll(ring, -1, axis=-2)  # twice the middle of each edge
    first = np.argmin(dot(middle, middle), axis=-1)
    order = (first[..., None] + np.arange(4)) % 4
    return np.take_along_axis(ring, order[..., None], axis=-2) * depth_unit


def _corners(
    along: np.ndarray,
    across: np.ndarray,
    left: np.ndarray,
    right: np.ndarray,
    front: np.ndarray,
    back: np.ndarray,
) -> np.ndarray:
    """Return the corners ``(..., 4, 2)`` of rectangles, from their sides along two unit vectors."""
    corners = [(left, front), (right, front), (right, back), (left, back)]
    points = [s[..., None] * along + t[..., None] * across for s, t in corners]
    return np.stack(points, axis=-2)


def _margin(obstacles: Obstacles, depth_unit: float, config: FootprintConfig) -> np.ndarray:
    """Return the margin of rectangles, ``(...)`` float64 or a single value [depth units]."""
    margin = np.asarray(config.margin_m)
    if config.margin_per_m2:
        z = np.asarray(obstacles.xyz_min, np.float64)[..., 2] * depth_unit
        margin = margin + config.margin_per_m2 * z * z
    return margin / depth_unit


def _backward_normal(a: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Return the unit normals, away from the camera, of edges with direction ``along``."""
    normal = np.stack([-along[..., 1], along[..., 0]], axis=-1)
    sideways = np.where(a[..., 0] >= 0, 1.0, -1.0) * normal[..., 0]
    outward = np.where(normal[..., 1] != 0, normal[..., 1], sideways)
    return np.where(outward[..., None] < 0, -normal, normal)


def tilted(orientation: np.ndarray, pitch: np.ndarray, roll: np.ndarray) -> np.ndarray:
    """Return whether floors are tilted in the world by more than ``MOST_TILT_DEG`` (z is not up).

    Args:
        orientation: Quaternions ``camera_orientation_world`` of ``frames.parquet``, ``(B, 4)``
            float64.
        pitch: Pitch of the camera above the floor, ``(B,)`` [rad].
        roll: Roll of the camera, ``(B,)`` [rad].

    Returns:
        One bool per floor, ``(B,)``; False if a value is NaN (unknown).
    """
    T = motion_matrix(np.zeros((len(orientation), 3)), orientation)
    up = -dot(T[:, 2, :3], down_vector(pitch, roll))
    return up < _LEAST_UP


def world_angle(T_world_camera: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return sine and cosine of the angle θ of Eq. 8-9.

    θ is the clockwise angle, seen from above, from the world's Y axis to the camera's forward
    direction, which is the optical axis projected on the world's xy plane (or the up direction of
    the image, if the camera looks straight down or up). ROS measures yaw counter-clockwise from
    the X axis (REP 103), so θ = π/2 - yaw of the forward direction.

    Args:
        T_world_camera: Transforms from the camera's optical frame to the world, ``(..., 4, 4)``
            float64; world z is up.

    Returns:
        ``sin θ`` and ``cos θ``, each ``(...)`` float64; NaN if the pose is NaN.
    """
    optical, up = T_world_camera[..., :2, 2], -T_world_camera[..., :2, 1]
    length = norm(optical)[..., None]
    forward = np.where(length < 1e-9, up, optical)
    forward = forward / norm(forward)[..., None]
    return forward[..., 0], forward[..., 1]


def to_world(corners: np.ndarray, T_world_camera: np.ndarray) -> np.ndarray:
    """Transform corners from the ground frame to the world (Eq. 8-9).

    ``X = y sin θ + x cos θ + X0`` and ``Y = y cos θ - x sin θ + Y0`` with θ of
    :func:`world_angle` and the camera at ``(X0, Y0)``.

    Args:
        corners: Outlines of P corners in the ground frame, right and forward, ``(B, M, P, 2)``
            float64 [m].
        T_world_camera: Poses of the camera, ``(B, 4, 4)`` float64, NaN if unknown.

    Returns:
        World X and Y ``(B, M, P, 2)`` float64 [m]; NaN if the pose is unknown.

    Raises:
        InputError: The arrays have other shapes or types.
    """
    poses = numeric("T_world_camera", T_world_camera)
    corners = numeric("corners", corners)
    if poses.shape[1:] != (4, 4) or corners.shape != (len(poses), *corners.shape[1:3], 2):
        problem = f"shape {corners.shape}, with poses of shape {poses.shape}"
        raise InputError(problem, topic="corners", remedy="pass (B, M, P, 2) and (B, 4, 4)")
    sin, cos = (a[:, None, None] for a in world_angle(poses))
    x, y = corners[..., 0], corners[..., 1]
    X0, Y0 = (poses[:, i, 3][:, None, None] for i in (0, 1))
    return np.stack([y * sin + x * cos + X0, y * cos - x * sin + Y0], axis=-1)
