"""Where is the floor? The ground plane from depth images alone.

One plane for a sample of frames: planes through random triples of pixels are proposed in each
frame, those that could not be a floor are put aside, and the one that most points of *all*
frames lie on while few lie below it is refined by weighted least squares. A wall is put aside by
its direction, an obstacle or a table by the floor points below it, and a frame without floor by
the other frames. In time windows, a ramp ahead is looked for too. Everything is seeded, so the same
frames give the same floor.
"""

from typing import NamedTuple

import numpy as np

from jaxdet.camera import pixel_rays
from jaxdet.config import GroundConfig
from jaxdet.plane import down_vector, flat_plane, plane_from_down, unknown_plane
from jaxdet.ramp import Floor, find_ramp, refine, score
from jaxdet.types import Calibration, GroundPlane

MAX_TILT = np.radians(50.0)
"""Largest angle between the camera's down and the floor's normal."""
HEIGHT_M = (0.05, 3.0)
"""Heights of a robot's camera."""
TRIPLES = 600
"""Proposals a frame."""
BEST = 4
"""Proposals a frame that are tried on all frames."""
MIN_SHARE = 0.04
"""Least share of all points on the plane for it to be called a floor."""


class PlaneEstimate(NamedTuple):
    """An estimated floor, and how sure of it one can be."""

    plane: GroundPlane
    """``B = 1``; not valid where no floor was found."""
    inlier_share: float
    """Share of the sampled points that lie on the plane, before its last refinement."""
    height_spread_m: float
    """Standard deviation of the height over the frames that see the floor [m], likewise."""
    frames_used: int
    """Frames that see the floor."""
    message: str
    """One sentence for the user."""


def fit_floor(z: np.ndarray, calibration: Calibration, config: GroundConfig) -> PlaneEstimate:
    """Estimates the floor plane that a fixed camera sees over several frames.

    Args:
        z: ``(S, H, W)`` uint16 depth at the colour pixels [depth units], 0 = none.
        calibration: For the colour camera and the depth unit.
        config: For the depth range.

    Returns:
        The plane, rounded to 0.1 mm and 10 microradians, so that the last bits of a linear
        algebra library don't reach any decision; not valid when no floor was found.
    """
    points = [p for p in _sample_points(z, calibration, config) if len(p) >= 50]
    if not points:
        return _no_floor(f"no usable depth in {len(z)} sampled frames")
    rng = np.random.default_rng(20230521)
    proposals = np.concatenate([_propose(p, rng) for p in points])
    if not len(proposals):
        return _no_floor(f"no floor-like plane in {len(points)} sampled frames")
    cloud = np.concatenate(points)
    scores = np.sum([_score(proposals, p) for p in points], axis=0)
    best = proposals[np.argmax(scores)]
    floor = refine(Floor(best[:3], float(best[3])), cloud, _roughly, rounds=5)
    found = _judge(floor.down, floor.height, points)
    if not found.plane.valid[0]:
        return found
    floor = refine(floor, cloud)
    if config.window_s:
        floor = find_ramp(floor, cloud, fixed=False)
    return found._replace(plane=_rounded(floor)) if _is_floor(floor.down, floor.height) else found


def fit_ramp(
    z: np.ndarray, plane: GroundPlane, calibration: Calibration, config: GroundConfig
) -> GroundPlane:
    """Looks for a ramp ahead of a camera whose floor plane is known.

    Args:
        z: As in :func:`fit_floor`, of a camera that keeps its place.
        plane: ``B = 1``, for instance of the camera's mount on the robot; an unknown one stays so.
        calibration: For the colour camera and the depth unit.
        config: For the depth range.

    Returns:
        The plane, with the ramp that most points speak for, or without one.
    """
    plane = flat_plane(plane.height, plane.pitch, plane.roll, plane.valid)
    cloud = np.concatenate([np.zeros((0, 3)), *_sample_points(z, calibration, config)])
    if len(cloud) < 50 or not plane.valid[0]:
        return plane
    known = Floor(down_vector(plane.pitch, plane.roll)[0], float(plane.height[0]))
    ramp = _rounded(find_ramp(known, cloud, fixed=True))
    return plane._replace(ramp_start=ramp.ramp_start, ramp_slope=ramp.ramp_slope)


def _rounded(floor: Floor) -> GroundPlane:
    """To 0.1 mm and 10 microradians, the ramp's start to a millimetre."""
    plane = plane_from_down(floor.down[None], np.array([floor.height]))
    return GroundPlane(
        np.round(plane.height, 4),
        np.round(plane.pitch, 5),
        np.round(plane.roll, 5),
        plane.valid,
        np.round([floor.start], 3),
        np.round([floor.slope], 5),
    )


def _no_floor(reason: str) -> PlaneEstimate:
    return PlaneEstimate(unknown_plane(1), 0.0, float("nan"), 0, reason)


def _sample_points(
    z: np.ndarray, calibration: Calibration, config: GroundConfig
) -> list[np.ndarray]:
    """About 5,000 points of each frame, ``(K, 3)`` float64 [m]."""
    step = max(1, round((calibration.color.width * calibration.color.height / 5000) ** 0.5))
    rows, columns = slice(step // 2, None, step), slice(step // 2, None, step)
    x, y = (ray[rows, columns] for ray in pixel_rays(calibration.color))
    depth = z[:, rows, columns] * calibration.depth_unit
    used = (depth >= config.min_depth_m) & (depth <= min(config.max_depth_m, 6.0))
    return [
        np.stack([x[u], y[u], np.ones(u.sum())], axis=1) * d[u][:, None]
        for d, u in zip(depth, used, strict=True)
    ]


def _tolerance(depth: np.ndarray) -> np.ndarray:
    """How far from the floor a floor point may lie [m]: stereo noise grows with z squared."""
    return 0.012 + 0.004 * depth * depth


def _roughly(floor: Floor, points: np.ndarray) -> np.ndarray:
    return _tolerance(points[:, 2])


def _propose(points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The best floor-like planes through three points of a frame, ``(n, 4)``: down, height."""
    triple = points[rng.integers(0, len(points), (TRIPLES, 3))]
    down = np.cross(triple[:, 1] - triple[:, 0], triple[:, 2] - triple[:, 0])
    length = np.linalg.norm(down, axis=1)
    down = down[length > 1e-4] / length[length > 1e-4, None]
    down *= np.where(down[:, 1:2] < 0, -1.0, 1.0)
    height = np.sum(down * triple[length > 1e-4, 0], axis=1)
    planes = np.column_stack([down, height])[
        (down[:, 1] > np.cos(MAX_TILT)) & (height > HEIGHT_M[0]) & (height < HEIGHT_M[1])
    ]
    return planes[np.argsort(-_score(planes, points), kind="stable")[:BEST]]


def _score(planes: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points on each plane, less twice those clearly below it, ``(n,)``."""
    below = points @ planes[:, :3].T - planes[:, 3]
    return score(below.T, _tolerance(points[:, 2]))


def _is_floor(down: np.ndarray, height: float) -> bool:
    """Whether a robot's camera can be that high and so tilted."""
    return HEIGHT_M[0] < height < HEIGHT_M[1] and bool(down[1] > np.cos(MAX_TILT))


def _judge(down: np.ndarray, height: float, points: list[np.ndarray]) -> PlaneEstimate:
    """Says whether the plane is a floor, and how steady it is over the frames."""
    plane = np.append(down, height)[None]
    on = [np.abs(p @ down - height) < _tolerance(p[:, 2]) for p in points]
    share = sum(int(o.sum()) for o in on) / sum(len(p) for p in points)
    balance = sum(float(_score(plane, p)[0]) for p in points)
    seen = [p[o] for p, o in zip(points, on, strict=True) if o.mean() > MIN_SHARE]
    if share < MIN_SHARE or balance <= 0 or not seen or not _is_floor(down, height):
        return _no_floor(f"no floor in {len(points)} sampled frames (best plane {share:.0%})")
    heights = [float(np.median(p @ down)) for p in seen]
    message = f"floor seen in {len(seen)} of {len(points)} sampled frames, {share:.0%} of points"
    return PlaneEstimate(
        _rounded(Floor(down, height)), share, float(np.std(heights)), len(seen), message
    )
