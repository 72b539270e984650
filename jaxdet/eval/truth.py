"""Ground truth of a batch of frames, and the selection of required obstacles."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import numpy as np

from jaxdet.camera import pixel_rays
from jaxdet.config import FootprintConfig
from jaxdet.floor.plane import down_vector
from jaxdet.results.metric import to_world, world_angle
from jaxdet.types import Calibration


@dataclass(frozen=True)
class EvalConfig:
    """Selection of required obstacles, and tolerances of the evaluation."""

    min_depth_m: float = 0.15
    """Minimum depth of a required obstacle [m]."""
    max_depth_m: float = 4.0
    """Maximum depth of the nearest visible point of a required obstacle [m]."""
    min_visible_pixels: int = 400
    """Minimum number of visible colour pixels of a required obstacle."""
    tolerance_px: int = 2
    """Maximum distance from an object at which a feature counts for it, along rows and columns
    [pixel]."""
    smear_px: int = 4
    """Maximum distance from an object at which a pixel with the object's depth counts for it, along
    rows and columns [pixel]; used if the true depth is known."""
    depth_slack_m: float = 0.05
    """Tolerance of a measured depth [m]."""
    depth_slack_per_m2: float = 0.01
    """Increase of the tolerance in proportion to z squared [1/m], about four standard deviations of
    a D435."""
    merge_share: float = 0.2
    """Minimum fraction of a detection's votes that an object must have to count as merged into the
    detection."""
    match_share: float = 0.5
    """Minimum fraction of a detection's votes that an obstacle must have to be matched to it."""
    step_height_m: float = 0.05
    """Minimum height of required obstacles, exclusive [m]: the height that the wheels can climb."""
    footprint: FootprintConfig = field(default_factory=FootprintConfig)
    """Parameters of the rectangles on the floor."""
    coverage_range_m: float = 3.0
    """Maximum distance of footprint points for the coverage [m]."""
    coverage_margin_m: float = 0.02
    """Maximum distance of covered footprint points from the rectangle [m], the accuracy stated in
    the paper."""
    floor_range_m: float = 4.0
    """Maximum distance of the evaluated floor from the camera's ground projection [m]."""
    hanging_m: float = 0.5
    """Minimum height of an obstacle's lowest cell above the floor at which the robot can drive
    below the obstacle, so that it covers no floor [m].
    """
    indices: bool = False
    """Whether to compute the silhouette and the Davies-Bouldin index, which take longer."""

    def depth_slack(self, z_m: np.ndarray) -> np.ndarray:
        """Return the tolerance of a measured depth at each z [m]."""
        return self.depth_slack_m + self.depth_slack_per_m2 * z_m * z_m


class FrameTruth(NamedTuple):
    """Ground truth of ``B`` frames with ``J`` objects; object ``j`` has the number ``j + 1``.

    If an optional field is None, the metrics that depend on it are NaN. Extents of an object that
    is not visible are NaN. The ground frame (right, forward) is that of the camera to which lengths
    in the detections refer.
    """

    obstacle_id: np.ndarray
    """Object number in each colour pixel, ``(B, H, W)`` integer, 0 = floor or nothing."""
    visible_pixels: np.ndarray
    """Number of colour pixels that show each object, ``(B, J)`` integer."""
    nearest_m: np.ndarray
    """Minimum z of each object's visible surface in the colour camera, ``(B, J)`` float [m]."""
    nearest_forward_m: np.ndarray
    """Distance of the object's nearest face: minimum forward coordinate of its visible surface in
    the ground frame, ``(B, J)`` float [m]."""
    is_wall: np.ndarray
    """Whether the object is a wall, ``(J,)`` bool; walls are not required, and detections on them
    are ignored."""
    ground_min: np.ndarray | None = None
    """Minimum coordinates (right, forward) of each visible surface, ``(B, J, 2)`` float [m]."""
    ground_max: np.ndarray | None = None
    """Maximum coordinates (right, forward) of each visible surface, ``(B, J, 2)`` float [m]."""
    footprint: np.ndarray | None = None
    """Outline on the floor in the ground frame, ``(B, J, V, 2)`` float [m], NaN after the last
    point."""
    height_m: np.ndarray | None = None
    """Height of the object, ``(B, J)`` float [m]."""
    depth_m: np.ndarray | None = None
    """True z in each colour pixel, ``(B, H, W)`` float [m], inf without a surface. If it is None,
    features vote only by their pixel, not by the measured depth."""
    drivable: np.ndarray | None = None
    """Whether the pixel shows drivable floor, outside all footprints, ``(B, H, W)`` bool."""
    nearest_floor_m: np.ndarray | None = None
    """Distance on the floor from the camera's ground projection to the nearest visible point of
    each object, ``(B, J)`` float [m], NaN if unknown, see :func:`nearest_on_floor`."""

    def required(self, config: EvalConfig) -> np.ndarray:
        """Return which objects are required, ``(B, J)`` bool.

        A required object is not a wall, shows at least ``min_visible_pixels``, has its nearest
        visible point in the depth range, and is higher than the step.
        """
        seen = ~self.is_wall & (self.visible_pixels >= config.min_visible_pixels)
        seen &= (self.nearest_m >= config.min_depth_m) & (self.nearest_m <= config.max_depth_m)
        return seen if self.height_m is None else seen & (self.height_m > config.step_height_m)

    @property
    def kinds(self) -> np.ndarray:
        """Kind by object number, ``(J + 1,)`` int64: 0 floor or nothing, 1 wall, 2 obstacle."""
        return np.concatenate([[0], np.where(self.is_wall, 1, 2)])


class LogTruth(Protocol):
    """Ground truth of a log with ``F`` frames, implemented by the simulator's ``Truth``."""

    @property
    def T_world_camera(self) -> np.ndarray:
        """Poses of the colour camera, ``(F, 4, 4)`` float64."""
        ...

    @property
    def visible_pixels(self) -> np.ndarray:
        """Number of visible pixels, ``(F, J)``."""
        ...

    @property
    def nearest_m(self) -> np.ndarray:
        """Minimum z, ``(F, J)`` [m]."""
        ...

    @property
    def ground_min(self) -> np.ndarray:
        """Minimum right, forward, ``(F, J, 2)`` [m]."""
        ...

    @property
    def ground_max(self) -> np.ndarray:
        """Maximum right, forward, ``(F, J, 2)`` [m]."""
        ...

    @property
    def is_wall(self) -> np.ndarray:
        """Whether each object is a wall, ``(J,)`` bool."""
        ...

    @property
    def height_m(self) -> np.ndarray:
        """Height of each object, ``(F, J)`` [m]."""
        ...

    @property
    def footprint_world(self) -> np.ndarray:
        """Footprints ``(F, J, V, 2)``, NaN after the last corner [m]."""
        ...


def truth_of(
    log: LogTruth,
    frames: np.ndarray | Sequence[int],
    obstacle_id: np.ndarray,
    depth_m: np.ndarray | None = None,
    drivable: np.ndarray | None = None,
    calibration: Calibration | None = None,
) -> FrameTruth:
    """Return the ground truth of selected frames of a log, with outlines in the ground frame.

    Args:
        log: Ground truth of the log.
        frames: Frame indices ``(B,)`` integer.
        obstacle_id: Images of object numbers, ``(B, H, W)`` integer.
        depth_m: True depth ``(B, H, W)`` float [m], if known.
        drivable: Drivable pixels ``(B, H, W)`` bool, if known.
        calibration: Calibration of the log, if lengths refer to the depth camera; None: they refer
            to the colour camera.

    Returns:
        Ground truth without ``nearest_floor_m``.
    """
    which = np.asarray(frames, np.int64)
    poses = log.T_world_camera[which]
    truth = FrameTruth(
        obstacle_id,
        log.visible_pixels[which],
        log.nearest_m[which],
        log.ground_min[which, :, 1],
        log.is_wall,
        log.ground_min[which],
        log.ground_max[which],
        to_ground_frame(log.footprint_world[which], poses),
        log.height_m[which],
        depth_m,
        drivable,
    )
    return truth if calibration is None else in_depth_camera(truth, poses, calibration)


def in_depth_camera(
    truth: FrameTruth, T_world_color: np.ndarray, calibration: Calibration
) -> FrameTruth:
    """Convert the lengths of ground truth from the colour camera to the depth camera.

    Args:
        truth: Ground truth of ``B`` frames, with outlines.
        T_world_color: Exact poses of the colour camera, ``(B, 4, 4)`` float64.
        calibration: Calibration of the log; without a colour camera nothing is changed.
    """
    if calibration.color_from_depth is None:
        return truth
    assert truth.ground_min is not None and truth.ground_max is not None
    assert truth.footprint is not None
    poses = depth_poses(T_world_color, calibration)
    low, high = _moved(truth.ground_min, truth.ground_max, T_world_color, poses)
    outlines = to_ground_frame(to_world(truth.footprint, T_world_color), poses)
    return truth._replace(
        nearest_forward_m=low[..., 1], ground_min=low, ground_max=high, footprint=outlines
    )


def depth_poses(T_world_color: np.ndarray, calibration: Calibration) -> np.ndarray:
    """Compute the poses ``(B, 4, 4)`` of the depth camera from those of the colour camera."""
    motion = calibration.color_from_depth
    return T_world_color if motion is None else T_world_color @ motion.T


def _moved(
    low: np.ndarray, high: np.ndarray, source: np.ndarray, target: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Transform extents ``(B, J, 2)`` between the ground frames of two cameras."""
    corners = [np.stack([a[..., 0], b[..., 1]], axis=-1) for a in (low, high) for b in (low, high)]
    ground = to_ground_frame(to_world(np.stack(corners, axis=2), source), target)
    return ground.min(axis=2), ground.max(axis=2)


def nearest_on_floor(
    truth: FrameTruth,
    calibration: Calibration,
    height_m: np.ndarray,
    pitch_rad: np.ndarray,
    roll_rad: np.ndarray,
    step_height_m: float,
) -> np.ndarray:
    """Return the distance of each object from the depth camera's ground projection.

    The result is the minimum over the object's colour pixels of the distance on the floor plane,
    like ``distance_m``. Points not higher than the step are ignored if there are higher points. The
    distance is unknown for objects cut off by the left, right or lower image border, as the depth
    camera may see nearer parts, which ``distance_m`` includes.

    Args:
        truth: Ground truth with ``depth_m``.
        calibration: Calibration of the log. In the preset ``paper``, whose lengths refer to the
            colour camera, a calibration of this camera only.
        height_m: True height of the colour camera above the floor, ``(B,)`` [m].
        pitch_rad: True pitch of the colour camera, ``(B,)`` [rad].
        roll_rad: True roll of the colour camera, ``(B,)`` [rad].
        step_height_m: Height that the wheels can climb [m].

    Returns:
        Distances ``(B, J)`` float64 [m], NaN for objects that are not visible or cut off.

    Raises:
        ValueError: The ground truth has no depth.
    """
    if truth.depth_m is None:
        raise ValueError("distances need depth_m")
    camera, center = calibration.image, np.zeros(3)
    if calibration.color_from_depth is not None:
        center = calibration.color_from_depth.T[:3, 3]  # depth camera's centre
    rays = np.stack([*pixel_rays(camera), np.ones((camera.height, camera.width))], axis=-1)
    nearest = np.full((2, len(truth.depth_m), len(truth.is_wall)), np.inf)
    for b, down in enumerate(down_vector(pitch_rad, roll_rad)):
        shown = truth.obstacle_id[b] > 0
        number = truth.obstacle_id[b][shown].astype(np.int64) - 1
        points = rays[shown] * truth.depth_m[b][shown].astype(np.float64)[:, None] - center
        depth = points @ down  # below the depth camera
        distance = np.linalg.norm(points - depth[:, None] * down, axis=1)
        high = height_m[b] - center @ down - depth > step_height_m
        np.minimum.at(nearest[0, b], number[high], distance[high])
        np.minimum.at(nearest[1, b], number, distance)
        edges = [truth.obstacle_id[b][edge] for edge in (np.s_[:, 0], np.s_[:, -1], np.s_[-1])]
        cut = np.unique(np.concatenate(edges).astype(np.int64))
        nearest[:, b, cut[cut > 0] - 1] = np.inf
    shortest = np.where(np.isfinite(nearest[0]), *nearest)
    return np.where(np.isfinite(shortest), shortest, np.nan)


def to_ground_frame(points: np.ndarray, T_world_camera: np.ndarray) -> np.ndarray:
    """Transform world points to the ground frame: Eq. 8-9 solved for ``x`` and ``y``.

    ``x = dX cos θ - dY sin θ`` and ``y = dX sin θ + dY cos θ`` with ``(dX, dY)`` from the camera.

    Args:
        points: World X, Y, ``(B, J, V, 2)`` float64 [m].
        T_world_camera: Poses ``(B, 4, 4)`` float64.

    Returns:
        Right and forward, ``(B, J, V, 2)`` float64 [m].
    """
    sin, cos = (a[:, None, None] for a in world_angle(T_world_camera))
    dx, dy = np.moveaxis(points - T_world_camera[:, None, None, :2, 3], -1, 0)
    return np.stack([dx * cos - dy * sin, dx * sin + dy * cos], axis=-1)
