"""Floor planes on the host: directions, and the depth at which a pixel becomes floor.

With pitch ``p`` and roll ``r`` (see :class:`jaxdet.types.GroundPlane`) the direction *down* in
the camera optical frame is ``(sin r cos p, cos r cos p, sin p)``.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from jaxdet.arguments import numbers
from jaxdet.camera import cell_side, pixel_rays
from jaxdet.config import ClusterConfig, Config, FootprintConfig, GroundConfig
from jaxdet.elementary import arctan2, dot, hypot, matmul, norm, sin_cos
from jaxdet.errors import InputError
from jaxdet.types import MAX_LATERAL, Calibration, Frames, GroundPlane, Intrinsics

GROUND_BITS = 13  # fraction bits of the ground frame's axes
DIRECTIONS = 90  # candidate directions of a rectangle, one per degree
DIRECTION_BITS = 9  # fraction bits of a direction, few enough for 32-bit products


def flat_plane(
    height: ArrayLike, pitch: ArrayLike, roll: ArrayLike, valid: np.ndarray | None = None
) -> GroundPlane:
    """Build a floor without ramps.

    Args:
        height: Height of the optical centre above the floor, ``(B,)`` float64, or a number for one
            frame [m].
        pitch: Pitch ``(B,)`` float64 [rad], positive looks down.
        roll: Roll ``(B,)`` float64 [rad], positive clockwise seen from behind.
        valid: Whether each floor is known, ``(B,)`` bool; None: all are known.

    Raises:
        InputError: An argument is not an array of numbers, or their lengths differ.
    """
    arrays = {"height": height, "pitch": pitch, "roll": roll}
    height, pitch, roll = (np.atleast_1d(numbers(n, a, np.float64)) for n, a in arrays.items())
    valid = np.ones(height.shape, bool) if valid is None else np.asarray(valid, bool)
    if not height.shape == pitch.shape == roll.shape == valid.shape or height.ndim != 1:
        shapes = ", ".join(str(a.shape) for a in (height, pitch, roll, valid))
        problem = f"height, pitch, roll and valid have the shapes {shapes}"
        raise InputError(problem, remedy="pass (B,) arrays, or a number each")
    return GroundPlane(height, pitch, roll, valid, np.full(height.shape, np.inf), 0 * height)


def down_vector(pitch: np.ndarray, roll: np.ndarray) -> np.ndarray:
    """Compute the direction of gravity in the camera optical frame.

    Args:
        pitch: Pitch ``(B,)`` float64 [rad], positive looks down.
        roll: Roll ``(B,)`` float64 [rad], positive clockwise seen from behind.

    Returns:
        Unit vectors ``(B, 3)`` float64.
    """
    (sin_p, sin_r), (cos_p, cos_r) = sin_cos(np.stack([pitch, roll]))
    return np.stack([sin_r * cos_p, cos_r * cos_p, sin_p], axis=-1)


def plane_from_down(down: np.ndarray, height: np.ndarray) -> GroundPlane:
    """Return the planes with the given unit down vectors ``(B, 3)`` and heights ``(B,)`` [m]."""
    pitch = arctan2(down[:, 2], hypot(down[:, 0], down[:, 1]))
    roll = arctan2(down[:, 0], down[:, 1])
    return flat_plane(height, pitch, roll, np.isfinite(height))


def plane_from_transform(T_base_camera: np.ndarray) -> GroundPlane:
    """Return the floor for a camera pose ``(4, 4)`` in a base frame with z = 0 on the floor.

    Returns:
        A :class:`GroundPlane` with ``B = 1``.
    """
    return plane_from_down(-T_base_camera[2:3, :3], T_base_camera[2:3, 3])


def plane_in_color(plane: GroundPlane, calibration: Calibration) -> GroundPlane:
    """Transform planes from the depth camera to the colour camera; ramps are dropped."""
    if calibration.color_from_depth is None:
        return plane
    T = calibration.color_from_depth.T
    down = down_vector(plane.pitch, plane.roll)
    center = -dot(T[:3, :3].T, T[:3, 3])  # colour camera's centre in the depth camera's frame
    moved = plane_from_down(matmul(down, T[:3, :3].T), plane.height - dot(down, center))
    height, pitch, roll = (np.where(plane.valid, ours, 0.0) for ours in moved[:3])
    return flat_plane(height, pitch, roll, plane.valid)


def flagged_plane(config: GroundConfig) -> GroundPlane:
    """Return the plane of the configuration, ``B = 1``; its camera height must be set."""
    height, pitch = config.camera_height_m, config.camera_pitch_rad
    assert height is not None and pitch is not None
    return flat_plane(height, pitch, config.camera_roll_rad)


def floor_prior(frames: Frames, config: Config) -> GroundPlane:
    """Return the floor priors: those of the frames, else of the configuration, else none."""
    batch = len(frames.depth)
    if config.ground.source == "none":
        return unknown_plane(batch)
    if frames.plane is not None:
        return frames.plane
    if config.ground.camera_height_m is not None:
        return repeat_plane(flagged_plane(config.ground), batch)
    return unknown_plane(batch)


def unknown_plane(batch: int) -> GroundPlane:
    """Return ``batch`` unknown planes, for a level camera and without points on the floor."""
    zeros = np.zeros(batch)
    return flat_plane(zeros, zeros, zeros, np.zeros(batch, bool))


def repeat_plane(plane: GroundPlane, batch: int) -> GroundPlane:
    """Repeat a plane (``B = 1``) for ``batch`` frames."""
    return GroundPlane(*(np.repeat(a, batch) for a in plane))


def join_planes(planes: Sequence[GroundPlane]) -> GroundPlane:
    """Concatenate the planes of several batches."""
    return GroundPlane(*(np.concatenate(parts) for parts in zip(*planes, strict=True)))


def depth_range(min_depth_m: float, max_depth_m: float, depth_unit: float) -> tuple[int, int]:
    """Return the depth range in depth units, bounds rounded to nearest, at least 1."""
    nearest, farthest = round(min_depth_m / depth_unit), round(max_depth_m / depth_unit)
    return max(1, nearest), min(65535, farthest)


def max_height(config: GroundConfig, depth_unit: float) -> int:
    """Return ``max_height_m`` in depth units, 2^30 for no limit."""
    return min(round(config.max_height_m / depth_unit) or 1 << 30, 1 << 30)


def floor_limits(
    camera: Intrinsics, plane: GroundPlane, config: GroundConfig, depth_unit: float
) -> tuple[np.ndarray, np.ndarray]:
    """Compute the maximum z at which each colour pixel is above the floor (Eq. 5, any tilt).

    A point ``z (x, y, 1)`` is floor if its height above the plane is below the step height
    ``step + c z``: ``z s >= h - step`` with ``s = down . (x, y, 1) + c``. With zero tilt and roll
    and ``c = 0`` this is Eq. 5, ``v - c_y >= f (h - step) / z``. So for a pixel with ``s > 0`` the
    floor begins at ``ceil((h - step) / (s unit))`` depth units, and the limit is one less.

    A ramp of slope ``t`` that begins at the distance ``y0`` raises the floor by
    ``t max(0, y - y0)``, with ``y = z forward . (x, y, 1)``. Its own plane has ``h + t y0`` for h
    and ``s + t forward . (x, y, 1)`` for s. On a rising ramp, points below either plane are floor;
    on a falling one, points below both. A ray that falls less than a falling ramp can't meet it: it
    meets the plane before the crest, or no floor.

    Args:
        camera: Colour camera.
        plane: ``B`` planes.
        config: ``step_height_m`` and ``step_height_per_m`` (``c``).
        depth_unit: Metres per depth unit.

    Returns:
        ``limits`` ``(P, H, W)`` uint16 [depth units] for the P distinct planes, and ``which``
        ``(B,)`` int32, the plane of each frame. A depth above the limit is floor.
    """
    rows = np.stack([np.asarray(part, np.float64) for part in plane], axis=1)
    unique, which = np.unique(rows, axis=0, return_inverse=True)
    step = config.step_height_m, config.step_height_per_m
    limits = [_floor_limit(camera, tuple(r), step, depth_unit) for r in unique.tolist()]
    return np.stack(limits), which.reshape(-1).astype(np.int32)


@lru_cache(maxsize=64)
def _floor_limit(
    camera: Intrinsics, row: tuple[float, ...], step: tuple[float, float], depth_unit: float
) -> np.ndarray:
    height, pitch, roll, valid, start, slope = row
    if not valid:
        return np.full((camera.height, camera.width), 65535, np.uint16)
    x, y = pixel_rays(camera)
    down = down_vector(np.array([pitch]), np.array([roll]))
    forward = forward_vector(down)
    s, ahead = (a[0, 0] * x + a[0, 1] * y + a[0, 2] for a in (down, forward))
    first = _crossing(height - step[0], s + step[1], depth_unit)
    if np.isfinite(start) and slope:
        s_ramp = s + step[1] + slope * ahead
        ramp = _crossing(height - step[0] + slope * start, s_ramp, depth_unit)
        if slope > 0:
            first = np.minimum(first, ramp)
        else:
            before = (s_ramp <= 0) & (height * ahead <= start * s)
            first = np.maximum(first, np.where(before, 0.0, ramp))
    # A tie is floor; the factor compensates the rounding of the operations above.
    last = np.ceil(first * (1 - 1e-12)) - 1
    return np.clip(last, 0, 65535).astype(np.uint16)


def _crossing(height: float, s: np.ndarray, depth_unit: float) -> np.ndarray:
    """Return the z at which rays meet a plane ``height`` [m] below the camera [depth units]."""
    drop = max(height, 0.0) / depth_unit
    return np.divide(drop, s, out=np.full_like(s, np.inf), where=s > 0)


def gap_units(config: ClusterConfig, depth_unit: float) -> tuple[int, int]:
    """Return the gaps d_z and d_x [depth units]."""
    depth_m, lateral_m = config.gaps_m
    return round(depth_m / depth_unit), round(lateral_m / depth_unit)


class StepHeight(NamedTuple):
    """Maximum height of a floor cell.

    The depth error of a stereo camera is ``c z^2``, with c inversely proportional to the focal
    length, so floor seen from a height h appears up to ``c z h`` higher or lower. Cells have the
    same angular size in all cameras, so their side s in pixels is proportional to the focal length:
    the step is ``step_height_m + step_height_per_m z / s``, and at least the noise of the floor,
    which is at most ``noise_per_m h z / s``.
    """

    table: np.ndarray
    """First term of the step height, indexed by z [depth units], ``(65536,)`` int64 [depth units],
    read-only."""
    noise: int
    """Factor ``noise_per_m / s`` [1/depth unit], with ``NOISE_BITS`` fraction bits, below 2^31."""

    def most_noise(self, height: int) -> int:
        """Return the maximum noise per depth seen from this camera height [depth units].

        It has ``SLOPE_BITS`` fraction bits.
        """
        slope = max(height, 0) * self.noise >> (NOISE_BITS - SLOPE_BITS)
        return min(slope, STEEPEST_NOISE)

    def at(self, z: np.ndarray, noise: int) -> np.ndarray:
        """Return the step height of cells at depths z, for this noise per depth."""
        return np.maximum(self.table[z], z * noise >> SLOPE_BITS)


NOISE_BITS = 34  # fraction bits of a noise factor
SLOPE_BITS = 14  # fraction bits of a slope, rise over run
STEEPEST_NOISE = 32767
"""Maximum increase of the step height with depth, ``SLOPE_BITS`` fraction bits, so that products
fit in 32 bits."""


@lru_cache(maxsize=16)
def step_height(calibration: Calibration, config: Config) -> StepHeight:
    """Return the step height for cells of this camera."""
    side = cell_side(calibration.depth, config.surface.cell_rad)
    ground, unit = config.ground, calibration.depth_unit
    slope = ground.step_height_per_m / side
    table = np.rint(ground.step_height_m / unit + slope * np.arange(65536)).astype(np.int64)
    table.setflags(write=False)
    noise = round(ground.noise_per_m / side * unit * (1 << NOISE_BITS))
    return StepHeight(table, min(noise, (1 << 31) - 1))


@lru_cache(maxsize=64)
def quadratic_table(constant_m: float, per_m: float, depth_unit: float) -> np.ndarray:
    """Tabulate a length that grows as stereo noise does, ``constant + per z^2``.

    Args:
        constant_m: Length at z = 0 [m].
        per_m: Factor of z squared [1/m].
        depth_unit: Metres per depth unit.

    Returns:
        Lengths by z in depth units, ``(65536,)`` int64 [depth units], read-only.
    """
    z = np.arange(65536) * depth_unit
    table = np.rint((constant_m + per_m * z * z) / depth_unit).astype(np.int64)
    table.setflags(write=False)
    return table


def band_table(config: FootprintConfig, depth_unit: float) -> np.ndarray:
    """Tabulate the widths of the bands from which the points A, B and C of outlines are computed.

    They are ``side_band_per_m z`` for A and B and ``near_band_per_m2 z^2`` for C, where z is the
    distance of the obstacle's nearest point.

    Returns:
        Widths of both bands by z in depth units, ``(65536, 2)`` int32 [depth units], read-only.
    """
    z = np.arange(65536) * depth_unit
    bands = np.stack([config.side_band_per_m * z, config.near_band_per_m2 * z * z], axis=1)
    bands = np.minimum(np.rint(bands / depth_unit), MAX_LATERAL).astype(np.int32)
    bands.setflags(write=False)
    return bands


@lru_cache(maxsize=1)
def direction_table() -> np.ndarray:
    """Return the candidate directions of a rectangle on the floor.

    Returns:
        Directions by angle from 0 on, ``(DIRECTIONS, 2)`` int64, right and forward with
        ``DIRECTION_BITS`` fraction bits, read-only.
    """
    angle = np.radians(np.arange(DIRECTIONS) * 90.0 / DIRECTIONS)
    sine, cosine = sin_cos(angle)
    table = np.rint(np.stack([cosine, sine], -1) * (1 << DIRECTION_BITS))
    table = table.astype(np.int64)
    table.setflags(write=False)
    return table


def forward_vector(down: np.ndarray) -> np.ndarray:
    """Project the optical axis onto the floor, in the camera optical frame.

    For a camera that looks straight down, the result is the image's up direction.

    Args:
        down: Unit vectors ``(B, 3)`` float64.

    Returns:
        Unit vectors ``(B, 3)`` float64.
    """
    axis = np.where(np.abs(down[:, 2:]) > 1 - 1e-9, [[0.0, -1.0, 0.0]], [[0.0, 0.0, 1.0]])
    forward = axis - down * dot(axis, down)[:, None]
    return forward / norm(forward)[:, None]


def ground_axes(plane: GroundPlane) -> np.ndarray:
    """Compute the axes of the ground frame, right and forward, in the camera optical frame.

    Forward is :func:`forward_vector`.

    Returns:
        Axes ``(B, 2, 3)`` int32 with ``GROUND_BITS`` fraction bits; those of a level camera if the
        plane is unknown.
    """
    down = down_vector(plane.pitch, plane.roll)
    down[~plane.valid] = (0.0, 1.0, 0.0)
    forward = forward_vector(down)
    right = np.cross(down, forward)
    return np.rint(np.stack([right, forward], axis=1) * (1 << GROUND_BITS)).astype(np.int32)
