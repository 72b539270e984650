"""How much of the floor that can truly be driven on lies inside of found outlines."""

import numpy as np

from jaxdet.camera import pixel_rays
from jaxdet.eval.polygon import inside
from jaxdet.eval.tally import Tally
from jaxdet.eval.truth import EvalConfig, depth_poses
from jaxdet.results.metric import floors, rectangles, world_angle
from jaxdet.types import Calibration, Detections


def floor_positions(
    depth_m: np.ndarray,
    drivable: np.ndarray,
    calibration: Calibration,
    T_world_camera: np.ndarray,
) -> np.ndarray:
    """Return where the drivable floor is that each colour pixel shows.

    Args:
        depth_m: ``(B, H, W)`` true z [m].
        drivable: ``(B, H, W)`` bool, see :class:`jaxdet.eval.FrameTruth`.
        calibration: Of the log; one without a colour camera where lengths refer to that camera.
        T_world_camera: ``(B, 4, 4)`` float64, of the colour camera, exact; world z is up.

    Returns:
        ``(B, H, W, 2)`` float64, right and forward in the depth camera's ground frame [m], NaN
        where the pixel shows no such floor.
    """
    x, y = pixel_rays(calibration.image)
    z = np.where(drivable, np.asarray(depth_m, np.float64), np.nan)
    # The rows of the world's axes, turned by the angle of Eq. 8-9, and the way between the cameras.
    depth = depth_poses(T_world_camera, calibration)
    sin, cos = (a[:, None] for a in world_angle(depth))
    T = np.concatenate([T_world_camera[..., :3], T_world_camera[..., 3:] - depth[..., 3:]], axis=-1)
    X, Y = T[:, 0], T[:, 1]
    positions = np.empty((*z.shape, 2))
    for k, axis in enumerate((X * cos - Y * sin, X * sin + Y * cos)):
        for b, (along_x, along_y, along_z, shift) in enumerate(axis):
            positions[b, ..., k] = z[b] * (x * along_x + y * along_y + along_z) + shift
    return positions


def measured_floor(
    positions_m: np.ndarray, true_depth_m: np.ndarray, z_m: np.ndarray, config: EvalConfig
) -> np.ndarray:
    """The floor that a method could have seen.

    Args:
        positions_m: ``(..., H, W, 2)``, right and forward, NaN where no drivable floor is [m].
        true_depth_m: ``(..., H, W)`` true z [m].
        z_m: ``(..., H, W)`` z measured at each colour pixel [m], 0 = none.
        config: Range and slack.

    Returns:
        The positions, NaN also beyond ``floor_range_m`` and where the depth of something else or
        none was measured.
    """
    slack = config.depth_slack(z_m)
    true = (z_m > 0) & (np.abs(z_m - np.asarray(true_depth_m, np.float64)) <= slack)
    near = np.hypot(positions_m[..., 0], positions_m[..., 1]) <= config.floor_range_m
    return np.where((true & near)[..., None], positions_m, np.nan)


def claimed_floor(
    detections: Detections,
    floor_m: np.ndarray,
    depth_unit: float = 0.001,
    config: EvalConfig | None = None,
    valid: np.ndarray | None = None,
) -> list[Tally]:
    """Counts the pixels of drivable floor inside of any outline.

    What hangs higher than ``hanging_m`` above the floor takes none of it; without a scene that is
    not known and every outline counts.

    Args:
        detections: Of ``B`` frames.
        floor_m: ``(B, H, W, 2)``, right and forward in the ground frame, NaN where nothing is
            asked for [m]; from :func:`measured_floor`.
        depth_unit: Metres in one depth unit.
        config: Its footprint makes the rectangles.
        valid: ``(B,)`` bool, False marks padding; None: all frames count.

    Returns:
        A tally for each frame that is not padding; :func:`jaxdet.eval.score` makes figures. Frames
        with fewer than ``min_visible_pixels`` have no share of their own.
    """
    config = config or EvalConfig()
    outlines = rectangles(detections.obstacles, depth_unit, config.footprint)
    scene = detections.scene
    known = None if scene is None else floors(scene, depth_unit).plane.valid
    tallies: list[Tally] = []
    for b, floor in enumerate(floor_m):
        if valid is None or valid[b]:
            points = floor[np.isfinite(floor).all(axis=-1)]
            standing = _standing(detections, b, known, depth_unit, config)
            claimed = _inside_any(outlines[b, standing], points)
            share = float(claimed.mean()) if len(points) >= config.min_visible_pixels else None
            claims = () if share is None else (share,)
            count = int(claimed.sum())
            tallies.append(
                Tally(drivable_pixels=len(points), drivable_claimed=count, claims=claims)
            )
    return tallies


def _standing(
    detections: Detections, b: int, known: np.ndarray | None, unit: float, config: EvalConfig
) -> np.ndarray:
    """The obstacles of frame ``b`` that the robot can't drive under, ``(L,)``.

    ``known`` says which frames' floor is, ``(B,)`` bool; None without heights.
    """
    numbers = np.arange(int(detections.num_obstacles[b]))
    scene = detections.scene
    if scene is None or known is None or not known[b]:
        return numbers
    bottom = np.asarray(scene.bottom_top[b])[numbers, 0] * unit
    return numbers[bottom <= config.hanging_m]


def _inside_any(outlines: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Which points ``(n, 2)`` lie in any of the outlines ``(L, 4, 2)``, ``(n,)`` bool."""
    found = np.zeros(len(points), bool)
    x, y = np.ascontiguousarray(points.T)
    for outline in outlines:
        (left, first), (right, last) = outline.min(axis=0), outline.max(axis=0)
        box = (x >= left) & (x <= right) & (y >= first) & (y <= last)
        near = np.flatnonzero(box & ~found)
        found[near] = inside(outline, points[near])
    return found
