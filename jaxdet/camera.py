"""Camera models on the host: rays and tables that both backends share.

Tables are computed once per calibration and cached, in float64 unless noted, and never in jitted
programs: trigonometry and iterations would not agree to the bit between NumPy, XLA and CUDA.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from jaxdet.elementary import arctan2, arctangent
from jaxdet.errors import CalibrationError
from jaxdet.types import NUM_COEFFICIENTS, Calibration, Distortion, Extrinsics, Intrinsics

RAY_BITS = 20
"""Fraction bits of a fixed-point ray: x in depth units is ``(ray * z) >> RAY_BITS``, rounded."""

MAX_RAY = 4.0
"""Maximum slope of a ray, x / z or y / z, which is 76 degrees from the optical axis; with steeper
rays 32-bit integers would overflow."""


def distort(x: np.ndarray, y: np.ndarray, camera: Intrinsics) -> tuple[np.ndarray, np.ndarray]:
    """Apply a lens model to undistorted rays, in float64.

    Args:
        x: Ray x over z, any shape.
        y: Ray y over z, same shape.
        camera: Camera with the lens model.

    Returns:
        Distorted ``x`` and ``y``, same shape.

    Raises:
        CalibrationError: The model is inverse Brown-Conrady, which maps the other way.
    """
    if camera.distortion is Distortion.NONE:
        return x, y
    k = coefficients(camera)
    r2 = x * x + y * y
    if camera.distortion is Distortion.EQUIDISTANT:
        r = np.sqrt(r2)
        theta = arctangent(r)
        t2 = theta * theta
        rd = theta * (1 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))))
        scale = np.divide(rd, r, out=np.ones_like(r), where=r > 1e-12)
        return x * scale, y * scale
    if camera.distortion is Distortion.INVERSE_BROWN_CONRADY:
        raise CalibrationError("inverse Brown-Conrady only maps distorted to undistorted rays")
    return _brown_conrady(x, y, k)


def _brown_conrady(x: np.ndarray, y: np.ndarray, k: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    r2 = x * x + y * y
    radial = 1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
    radial = radial / (1 + r2 * (k[5] + r2 * (k[6] + r2 * k[7])))
    dx = 2 * k[2] * x * y + k[3] * (r2 + 2 * x * x)
    dy = 2 * k[3] * x * y + k[2] * (r2 + 2 * y * y)
    return x * radial + dx, y * radial + dy


def coefficients(camera: Intrinsics) -> np.ndarray:
    """Return the lens coefficients, zero-padded to ``(8,)`` float64.

    Raises:
        CalibrationError: There are more than eight coefficients.
    """
    if len(camera.coefficients) > NUM_COEFFICIENTS:
        raise CalibrationError(
            f"{len(camera.coefficients)} distortion coefficients for {camera.distortion} exceed "
            f"the maximum of {NUM_COEFFICIENTS}",
            remedy="pass --log.color-distortion or --log.depth-distortion",
        )
    return np.array([*camera.coefficients, *[0.0] * (8 - len(camera.coefficients))])


def undistort(x: np.ndarray, y: np.ndarray, camera: Intrinsics) -> tuple[np.ndarray, np.ndarray]:
    """Undistort rays, in float64.

    Inverse Brown-Conrady is a formula; the other models are inverted by fixed-point iteration, as
    in ``cv2.undistortPoints``, until no value changes by more than 1e-12.

    Args:
        x: Distorted ray x over z, any shape.
        y: Distorted ray y over z, same shape.
        camera: Camera with the lens model.

    Returns:
        Undistorted ``x`` and ``y``, same shape.

    Raises:
        CalibrationError: The model can't be inverted over the image.
    """
    if camera.distortion is Distortion.NONE:
        return x, y
    if camera.distortion is Distortion.INVERSE_BROWN_CONRADY:
        return _brown_conrady(x, y, coefficients(camera))
    ux, uy = np.array(x, np.float64), np.array(y, np.float64)
    for _ in range(500):
        dx, dy = distort(ux, uy, camera)
        step_x, step_y = x - dx, y - dy
        ux, uy = ux + step_x, uy + step_y
        largest = max(np.abs(step_x).max(initial=0.0), np.abs(step_y).max(initial=0.0))
        if largest < 1e-12:
            return ux, uy
        if not largest < 1e3:
            break
    raise CalibrationError(
        f"the {camera.distortion} coefficients {camera.coefficients} can't be inverted over "
        f"{camera.width}x{camera.height}",
        remedy="check them, or override the model with --log.color-distortion",
    )


@lru_cache(maxsize=16)
def pixel_rays(camera: Intrinsics) -> tuple[np.ndarray, np.ndarray]:
    """Compute the undistorted ray of each pixel centre.

    Returns:
        ``x`` and ``y`` over z, each ``(H, W)`` float64, read-only.

    Raises:
        CalibrationError: The lens model can't be inverted over the image.
    """
    v, u = np.mgrid[0 : camera.height, 0 : camera.width].astype(np.float64)
    x, y = undistort((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, camera)
    return _frozen(x), _frozen(y)


@lru_cache(maxsize=16)
def fixed_rays(camera: Intrinsics) -> tuple[np.ndarray, np.ndarray]:
    """Return :func:`pixel_rays` as integers with ``RAY_BITS`` fraction bits.

    Returns:
        ``x`` and ``y`` over z, each ``(H, W)`` int32, read-only.

    Raises:
        CalibrationError: The slope of a ray exceeds ``MAX_RAY``, or the lens model can't be
            inverted over the image.
    """
    x, y = pixel_rays(camera)
    for ray in (x, y):
        check_steepness(ray, "--log.color-intrinsics")
    one = 1 << RAY_BITS
    return _frozen(np.rint(x * one).astype(np.int32)), _frozen(np.rint(y * one).astype(np.int32))


def check_steepness(rays: np.ndarray, flag: str) -> None:
    """Check the slopes of rays; an error recommends ``flag``.

    Raises:
        CalibrationError: A slope exceeds ``MAX_RAY``.
    """
    if np.abs(rays).max(initial=0.0) > MAX_RAY:
        raise CalibrationError(
            "the field of view is too wide for the pinhole geometry",
            remedy=f"check the focal length, or pass {flag}",
        )


def _extrinsics(calibration: Calibration) -> Extrinsics:
    """Return the transform from the depth camera to the colour camera."""
    if calibration.color_from_depth is None:
        raise CalibrationError(
            "no extrinsics between depth and colour camera",
            remedy="pass --log.color-from-depth, or --log.depth-aligned if depth is aligned",
        )
    return calibration.color_from_depth


def cell_side(camera: Intrinsics, cell_rad: float) -> int:
    """Return the side of a depth cell [pixel] that is about ``cell_rad`` wide."""
    return max(1, round(camera.fx * cell_rad))


@lru_cache(maxsize=16)
def cell_rays(camera: Intrinsics, side: int) -> np.ndarray:
    """Compute the ray through the middle of each cell of the depth image.

    A cell of depth ``d`` is at ``(ray_x d, ray_y d, d)`` (Eq. 1).

    Args:
        camera: Depth camera.
        side: Side of a cell [pixel].

    Returns:
        x and y over z, ``(2, R, C)`` int64 with ``RAY_BITS`` fraction bits, read-only.

    Raises:
        CalibrationError: A slope exceeds ``MAX_RAY``.
    """
    rows, columns = camera.height // side, camera.width // side
    v, u = (np.mgrid[0:rows, 0:columns] * side + (side - 1) / 2).astype(np.float64)
    x, y = undistort((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, camera)
    rays = np.stack([x, y])
    check_steepness(rays, "--log.depth-intrinsics")
    return _frozen(np.rint(rays * (1 << RAY_BITS)).astype(np.int64))


@lru_cache(maxsize=16)
def corner_rays(camera: Intrinsics) -> tuple[np.ndarray, np.ndarray]:
    """Compute the rays through the corners of each depth pixel, in librealsense's float32.

    Corner 0 of pixel ``(v, u)`` is entry ``[v, u]`` (offset -0.5) and corner 1 is
    ``[v + 1, u + 1]`` (offset +0.5). Source: librealsense ``sse-align.cpp``,
    ``pre_compute_x_y_map``; lens models that it does not support are undistorted in float64 and
    rounded once.

    Returns:
        ``x`` and ``y`` over z, each ``(Hd + 1, Wd + 1)`` float32, read-only.

    Raises:
        CalibrationError: The lens model can't be inverted over the image.
    """
    f32 = np.float32
    u = np.arange(camera.width + 1, dtype=f32) - f32(0.5)
    v = np.arange(camera.height + 1, dtype=f32) - f32(0.5)
    x = (u - f32(camera.cx)) / f32(camera.fx)
    y = (v - f32(camera.cy)) / f32(camera.fy)
    x, y = (np.ascontiguousarray(a) for a in np.broadcast_arrays(x[None, :], y[:, None]))
    if camera.distortion is Distortion.INVERSE_BROWN_CONRADY:
        x, y = _inverse_brown_conrady_float32(x, y, coefficients(camera).astype(f32))
    elif camera.distortion is not Distortion.NONE:
        wide = undistort(x.astype(np.float64), y.astype(np.float64), camera)
        x, y = wide[0].astype(f32), wide[1].astype(f32)
    return _frozen(x), _frozen(y)


def _inverse_brown_conrady_float32(
    x: np.ndarray, y: np.ndarray, k: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    two = np.float32(2)
    r2 = x * x + y * y
    f = np.float32(1) + k[0] * r2 + k[1] * r2 * r2 + k[4] * r2 * r2 * r2
    ux = x * f + two * k[2] * x * y + k[3] * (r2 + two * x * x)
    uy = y * f + two * k[3] * x * y + k[2] * (r2 + two * y * y)
    return ux, uy


class SplatParameters(NamedTuple):
    """Constants of the projection into the colour image, as float32 arrays."""

    rotation: np.ndarray  # (9,) float32, row-major R of T_color_depth
    translation: np.ndarray  # (3,) float32 [m]
    pinhole: np.ndarray  # (4,) float32, the colour camera's fx fy cx cy [pixel]
    lens: np.ndarray  # (8,) float32, the colour camera's distortion coefficients
    max_r2: np.float32
    """Maximum squared slope of rays in the colour image. Beyond it a lens polynomial folds back
    and would project rays from far outside the field of view into the image."""
    depth_unit: np.float32  # metres in one depth unit
    model: Distortion
    """Lens model of the colour camera; inverse Brown-Conrady is ignored, as in ``rs.align``."""
    fills_corners: bool  # whether a depth pixel covers all colour pixels between its corners


@lru_cache(maxsize=16)
def splat_parameters(calibration: Calibration) -> SplatParameters:
    """Return the constants of the alignment (Eq. 1-4), rounded as in librealsense.

    Raises:
        CalibrationError: The calibration has no extrinsics.
    """
    motion, color, f32 = _extrinsics(calibration), calibration.image, np.float32
    model = color.distortion
    if model is Distortion.INVERSE_BROWN_CONRADY:
        model = Distortion.NONE
    max_r2 = np.inf
    if model is not Distortion.NONE:
        x, y = pixel_rays(color)
        max_r2 = 1.05 * float((x * x + y * y).max())
    return SplatParameters(
        rotation=np.array(motion.rotation, f32),
        translation=np.array(motion.translation, f32),
        pinhole=np.array([color.fx, color.fy, color.cx, color.cy], f32),
        lens=coefficients(color).astype(f32),
        max_r2=f32(min(max_r2, float(np.finfo(f32).max))),
        depth_unit=f32(calibration.depth_unit),
        model=model,
        fills_corners=_fills_corners(calibration.depth, color),
    )


def _fills_corners(depth: Intrinsics, color: Intrinsics) -> bool:
    """Return whether colour has more pixels per degree than depth (librealsense ``rs2_fov``)."""
    shapes = (depth.width, depth.height), (color.width, color.height)
    if shapes in (((640, 240), (320, 180)), ((640, 480), (640, 360))):
        return True
    fine = _pixels_per_degree(color)
    coarse = _pixels_per_degree(depth)
    return bool(coarse[0] < fine[0] or coarse[1] < fine[1])


def _pixels_per_degree(camera: Intrinsics) -> tuple[np.float32, np.float32]:
    f32 = np.float32

    def along(size: int, focal: float, center: float) -> np.float32:
        c = f32(center) + f32(0.5)
        low, high = (f32(arctan2(side, f32(focal))) for side in (c, f32(size) - c))
        return f32(f32(size) / f32((low + high) * f32(57.2957795)))

    return along(camera.width, camera.fx, camera.cx), along(camera.height, camera.fy, camera.cy)


def _frozen(array: np.ndarray) -> np.ndarray:
    array = np.ascontiguousarray(array)
    array.setflags(write=False)
    return array
