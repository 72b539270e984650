"""What is true of a batch of frames, and what of it counts."""

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
    """What counts as an obstacle to be found, and when it is."""

    min_depth_m: float = 0.15
    """An obstacle nearer than this is not asked for [m]."""
    max_depth_m: float = 4.0
    """An obstacle whose nearest visible point is farther is not asked for [m]."""
    min_visible_pixels: int = 400
    """An obstacle with fewer visible colour pixels is not asked for."""
    tolerance_px: int = 2
    """How far beside an object its features may lie [pixel], along rows and columns."""
    smear_px: int = 4
    """How far beside an object its depth may be measured [pixel], along rows and columns, where
    the true depth is known."""
    depth_slack_m: float = 0.05
    """A measured depth this far from a true one may be of it [m]."""
    depth_slack_per_m2: float = 0.01
    """Added in proportion to z squared [1/m], about four standard deviations of a D435."""
    merge_share: float = 0.2
    """An object with at least this share of a detection's votes is part of it."""
    match_share: float = 0.5
    """Share of a detection's votes that must lie on an obstacle for the two to match."""
    step_height_m: float = 0.05
    """An obstacle that is not higher is not asked for [m]; the wheels climb it."""
    footprint: FootprintConfig = field(default_factory=FootprintConfig)
    """For the rectangles on the floor."""
    coverage_range_m: float = 3.0
    """Footprint points farther from the camera don't count for the coverage [m]."""
    coverage_margin_m: float = 0.02
    """How far outside its rectangle a footprint point may lie [m]: the accuracy that the paper
    states."""
    floor_range_m: float = 4.0
    """Drivable floor farther from the camera's foot doesn't count [m]."""
    hanging_m: float = 0.5
    """An obstacle whose lowest cell is higher above the floor takes none of it [m]."""
    indices: bool = False
    """Whether the silhouette and the Davies-Bouldin index are computed too; they take longer."""

    def depth_slack(self, z_m: np.ndarray) -> np.ndarray:
        """How far from a true depth a measured one may be of it, at each measured z [m]."""
        return self.depth_slack_m + self.depth_slack_per_m2 * z_m * z_m


class FrameTruth(NamedTuple):
    """The truth of ``B`` frames with ``J`` objects; object ``j`` has the number ``j + 1``.

    Where an optional part is None, the scores that need it are NaN. Extents of an object out of
    sight are NaN. The ground frame is that of the camera that lengths refer to: right, forward [m].
    """

    obstacle_id: np.ndarray
    """``(B, H, W)`` integer, number of the object at each colour pixel, 0 = floor or nothing."""
    visible_pixels: np.ndarray
    """``(B, J)`` integer, colour pixels that show the object."""
    nearest_m: np.ndarray
    """``(B, J)`` float, smallest z of its visible surface in the colour camera [m]."""
    nearest_forward_m: np.ndarray
    """``(B, J)`` float, distance of its nearest face: smallest forward coordinate of its visible
    surface in the ground frame [m]."""
    is_wall: np.ndarray
    """``(J,)`` bool, walls need not be found and are no mistake."""
    ground_min: np.ndarray | None = None
    """``(B, J, 2)`` float, smallest right, forward of its visible surface."""
    ground_max: np.ndarray | None = None
    """``(B, J, 2)`` float, largest right, forward of the same."""
    footprint: np.ndarray | None = None
    """``(B, J, V, 2)`` float, outline on the floor in the ground frame, NaN after the last."""
    height_m: np.ndarray | None = None
    """``(B, J)`` float, height of the object itself [m]."""
    depth_m: np.ndarray | None = None
    """``(B, H, W)`` float, z of what each colour pixel shows [m], inf where nothing is; without
    it a feature is of what its pixel shows, whatever depth was measured there."""
    drivable: np.ndarray | None = None
    """``(B, H, W)`` bool, the pixel truly shows floor that the robot can drive on, outside all
    footprints."""
    nearest_floor_m: np.ndarray | None = None
    """``(B, J)`` float, distance on the floor from the camera's foot to the nearest point of its
    visible surface [m], NaN where that is not known, see :func:`nearest_on_floor`."""

    def asked(self, config: EvalConfig) -> np.ndarray:
        """Which objects have to be found: ``(B, J)`` bool.

        Those that are no wall, show ``min_visible_pixels``, have their nearest visible point in
        the range of depth, and are higher than the step.
        """
        seen = ~self.is_wall & (self.visible_pixels >= config.min_visible_pixels)
        seen &= (self.nearest_m >= config.min_depth_m) & (self.nearest_m <= config.max_depth_m)
        return seen if self.height_m is None else seen & (self.height_m > config.step_height_m)

    @property
    def kinds(self) -> np.ndarray:
        """``(J + 1,)`` int64 by number: 0 the floor or nothing, 1 a wall, 2 an obstacle."""
        return np.concatenate([[0], np.where(self.is_wall, 1, 2)])


class LogTruth(Protocol):
    """What :func:`truth_of` reads, ``F`` frames; the simulator's ``Truth`` has it."""

    @property
    def T_world_camera(self) -> np.ndarray:
        """``(F, 4, 4)`` float64, of the colour camera."""
        ...

    @property
    def visible_pixels(self) -> np.ndarray:
        """``(F, J)``."""
        ...

    @property
    def nearest_m(self) -> np.ndarray:
        """``(F, J)`` [m]."""
        ...

    @property
    def ground_min(self) -> np.ndarray:
        """``(F, J, 2)`` [m]."""
        ...

    @property
    def ground_max(self) -> np.ndarray:
        """``(F, J, 2)`` [m]."""
        ...

    @property
    def is_wall(self) -> np.ndarray:
        """``(J,)`` bool."""
        ...

    @property
    def height_m(self) -> np.ndarray:
        """``(F, J)`` [m]."""
        ...

    @property
    def footprint_world(self) -> np.ndarray:
        """``(F, J, V, 2)``, NaN after the last [m]."""
        ...


def truth_of(
    log: LogTruth,
    frames: np.ndarray | Sequence[int],
    obstacle_id: np.ndarray,
    depth_m: np.ndarray | None = None,
    drivable: np.ndarray | None = None,
    calibration: Calibration | None = None,
) -> FrameTruth:
    """Return the truth of some frames of a simulated log, with outlines in the ground frame.

    Args:
        log: The truth of the whole log.
        frames: ``(B,)`` integer, which of its frames.
        obstacle_id: ``(B, H, W)`` integer, their pictures of object numbers.
        depth_m: ``(B, H, W)`` float, their true depth [m], if known.
        drivable: ``(B, H, W)`` bool, whether their pixels show floor to drive on, if known.
        calibration: Of the log, whose lengths refer to the depth camera; None: they refer to the
            colour camera.

    Returns:
        All other parts filled.
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
    """Return a truth whose lengths refer to the colour camera with those of the depth camera.

    Args:
        truth: Of ``B`` frames, with outlines.
        T_world_color: ``(B, 4, 4)`` float64, exact.
        calibration: Of the log; the truth stays as it is without a colour camera.
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
    """Return the poses ``(B, 4, 4)`` of the depth camera from those of the colour camera."""
    motion = calibration.color_from_depth
    return T_world_color if motion is None else T_world_color @ motion.T


def _moved(
    low: np.ndarray, high: np.ndarray, source: np.ndarray, target: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return extents ``(B, J, 2)`` of one camera's ground frame in that of another."""
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
    """Return how far each object is from the depth camera's foot, as ``distance_m`` is.

    Of the colour pixels that show the object the least distance between the foot and the point
    below what they show, both on the plane of the floor. What is no higher above that plane than
    the step is left out, unless that is all. Of what the picture cuts at its left, right or lower
    edge it is not known: the depth camera may see nearer parts, which ``distance_m`` counts.

    Args:
        truth: With ``depth_m``.
        calibration: Of the log; one without a colour camera where lengths refer to that camera.
        height_m: ``(B,)`` of the colour camera over its true floor [m].
        pitch_rad: ``(B,)`` of the same [rad].
        roll_rad: ``(B,)`` of the same [rad].
        step_height_m: What the wheels can climb [m].

    Returns:
        ``(B, J)`` float64 [m], NaN for objects out of sight and for those cut.

    Raises:
        ValueError: The truth has no depth.
    """
    if truth.depth_m is None:
        raise ValueError("distances need depth_m")
    camera, center = calibration.image, np.zeros(3)
    if calibration.color_from_depth is not None:
        center = calibration.color_from_depth.T[:3, 3]  # of the depth camera
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
    found = np.where(np.isfinite(nearest[0]), *nearest)
    return np.where(np.isfinite(found), found, np.nan)


def to_ground_frame(points: np.ndarray, T_world_camera: np.ndarray) -> np.ndarray:
    """World points in the ground frame: Eq. 8-9 solved for ``x`` and ``y``.

    ``x = dX cos θ - dY sin θ`` and ``y = dX sin θ + dY cos θ`` with ``(dX, dY)`` from the camera.

    Args:
        points: ``(B, J, V, 2)`` float64, world X, Y [m].
        T_world_camera: ``(B, 4, 4)`` float64.

    Returns:
        ``(B, J, V, 2)`` float64, right and forward [m].
    """
    sin, cos = (a[:, None, None] for a in world_angle(T_world_camera))
    dx, dy = np.moveaxis(points - T_world_camera[:, None, None, :2, 3], -1, 0)
    return np.stack([dx * cos - dy * sin, dx * sin + dy * cos], axis=-1)
