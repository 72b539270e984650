"""Fraction of the drivable floor covered by detected outlines."""

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
    """Return the position of the drivable floor in each colour pixel.

    Args:
        depth_m: True z ``(B, H, W)`` [m].
        drivable: Drivable pixels ``(B, H, W)`` bool, see :class:`jaxdet.eval.FrameTruth`.
        calibration: Calibration of the log. In the preset ``paper``, whose lengths refer to the
            colour camera, a calibration of this camera only.
        T_world_camera: Exact poses ``(B, 4, 4)`` float64 of the colour camera; world z is up.

    Returns:
        Right and forward in the depth camera's ground frame, ``(B, H, W, 2)`` float64 [m], NaN for
        other pixels.
    """
    x, y = pixel_rays(calibration.image)
    z = np.where(drivable, np.asarray(depth_m, np.float64), np.nan)
    # The world's axes rotated by the angle of Eq. 8-9, and the translation between the cameras.
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
    """Return the part of the drivable floor that was measured correctly.

    Args:
        positions_m: Right and forward ``(..., H, W, 2)``, NaN outside of drivable floor [m].
        true_depth_m: True z ``(..., H, W)`` [m].
        z_m: Measured z at each colour pixel, ``(..., H, W)`` [m], 0 = none.
        config: Range and tolerance of the evaluation.

    Returns:
        Positions, NaN also beyond ``floor_range_m`` and where the measured depth is missing or not
        that of the floor.
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
    """Count the pixels of drivable floor inside of any outline.

    Obstacles higher than ``hanging_m`` above the floor are excluded if the detections have heights.

    Args:
        detections: Detections of ``B`` frames.
        floor_m: Evaluated floor from :func:`measured_floor`, right and forward in the ground frame,
            ``(B, H, W, 2)``, NaN elsewhere [m].
        depth_unit: Metres per depth unit.
        config: Evaluation parameters, with the footprint parameters of the rectangles.
        valid: Mask ``(B,)`` bool, False for padding; None: all frames count.

    Returns:
        A tally per frame without padding, for :func:`jaxdet.eval.score`. Frames with fewer pixels
        than ``min_visible_pixels`` have no fraction of their own.
    """
    config = config or EvalConfig()
    outlines = rectangles(detections.obstacles, depth_unit, config.footprint)
    scene = detections.scene
    floor_known = None if scene is None else floors(scene, depth_unit).plane.valid
    tallies: list[Tally] = []
    for b, floor in enumerate(floor_m):
        if valid is None or valid[b]:
            points = floor[np.isfinite(floor).all(axis=-1)]
            standing = _standing(detections, b, floor_known, depth_unit, config)
            claimed = _inside_any(outlines[b, standing], points)
            share = float(claimed.mean()) if len(points) >= config.min_visible_pixels else None
            claims = () if share is None else (share,)
            count = int(claimed.sum())
            tallies.append(
                Tally(drivable_pixels=len(points), drivable_claimed=count, claims=claims)
            )
    return tallies


def _standing(
    detections: Detections, b: int, floor_known: np.ndarray | None, unit: float, config: EvalConfig
) -> np.ndarray:
    """Return the obstacles of frame ``b`` under which the robot can't drive, ``(L,)``.

    ``floor_known`` states for each frame whether its floor is known, ``(B,)`` bool; None if the
    detections have no heights.
    """
    numbers = np.arange(int(detections.num_obstacles[b]))
    scene = detections.scene
    if scene is None or floor_known is None or not floor_known[b]:
        return numbers
    bottom = np.asarray(scene.bottom_top[b])[numbers, 0] * unit
    return numbers[bottom <= config.hanging_m]


def _inside_any(outlines: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return which points ``(n, 2)`` are in any of the outlines ``(L, 4, 2)``, ``(n,)`` bool."""
    covered = np.zeros(len(points), bool)
    x, y = np.ascontiguousarray(points.T)
    for outline in outlines:
        (left, first), (right, last) = outline.min(axis=0), outline.max(axis=0)
        box = (x >= left) & (x <= right) & (y >= first) & (y <= last)
        near = np.flatnonzero(box & ~covered)
        covered[near] = inside(outline, points[near])
    return covered
