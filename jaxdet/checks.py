"""Validation of arrays and calibrations before kernels read them.

All input from logs, flags and callers is checked here once; the kernels do not check it again.
"""

import math
import sys
from collections import deque
from functools import lru_cache, reduce
from numbers import Integral, Real
from typing import Any

import numpy as np

from jaxdet.arguments import of_type
from jaxdet.camera import cell_side
from jaxdet.config import DEPTH_UNITS_M, MAX_POINTS, Config, SurfaceConfig
from jaxdet.elementary import arctan2, hypot
from jaxdet.errors import CalibrationError, ConfigError, InputError
from jaxdet.types import (
    MAX_CONTOUR,
    NUM_COEFFICIENTS,
    Calibration,
    Distortion,
    Extrinsics,
    Frames,
    GroundPlane,
    Intrinsics,
    is_rotation,
)

MAX_CELL_SIDE = 128
"""Maximum side of a cell [pixel], so that sums of depths fit in 31 bits."""
MAX_DEPTH_COLUMNS = 4096
"""Maximum number of columns of a depth image that is divided into cells."""
MAX_FRAMES = 1 << 16
"""Maximum number of frames per batch."""

FOCAL_LENGTHS = 1.0, 1e6
"""Minimum and maximum focal length [pixel], for images of any size."""
VIEW_DEG = 1.0, 179.0
"""Minimum and maximum field of view, the larger of horizontal and vertical [degree]."""
MAX_PIXEL_ASPECT = 4.0
"""Maximum ratio between fx and fy; the ratio is 2 if only rows or only columns are binned."""
MAX_COEFFICIENT = 1e4
"""Maximum magnitude of a distortion coefficient."""
MAX_BASELINE_M = 10.0
"""Maximum distance between depth and colour camera [m]; the depth range limits it further, so that
sums of products fit in 32 bits."""


def check_calibration(calibration: Calibration) -> None:
    """Check that a calibration is plausible.

    Raises:
        CalibrationError: See :func:`check_numbers`; or a camera's field of view or optical centre
            does not fit its image size.
    """
    check_numbers(calibration)
    for name, camera in (("color", calibration.color), ("depth", calibration.depth)):
        if camera is not None:
            _check_view(name, camera)


def check_camera(name: str, camera: Intrinsics) -> None:
    """Check that intrinsics are plausible.

    Args:
        name: ``color`` or ``depth``, as in the flags.
        camera: Intrinsics of plain numbers.

    Raises:
        CalibrationError: See :func:`check_calibration`.
    """
    _check_camera(name, camera)
    _check_view(name, camera)


def check_numbers(calibration: Calibration) -> None:
    """Check the numbers of a calibration, regardless of the image size.

    Raises:
        CalibrationError: A size is not positive; a focal length, an optical centre, a distortion
            coefficient, the rotation, the translation or the depth unit is not a number or out of
            range; a lens model is unknown.
    """
    _check_types(calibration)
    _check_ranges(calibration)


def _check_types(calibration: Calibration) -> None:
    """Check that a calibration consists of plain numbers, so that it can be hashed."""

    def check(name: str, value: Any, kind: type) -> None:
        of_type(name, value, kind, CalibrationError)

    check("calibration", calibration, Calibration)
    check("depth unit", calibration.depth_unit, Real)
    cameras: dict[str, Any] = {"depth": calibration.depth}
    if calibration.color is not None:
        cameras["colour"] = calibration.color
    for name, camera in cameras.items():
        check(f"{name} camera", camera, Intrinsics)
        for field, value in zip(camera._fields, camera, strict=True):
            whole = Integral if field in ("width", "height") else Real
            kind = {"distortion": str, "coefficients": tuple}.get(field, whole)
            check(f"{field} of the {name} camera", value, kind)
        for value in camera.coefficients:
            check(f"coefficients of the {name} camera", value, Real)
    motion = calibration.color_from_depth
    if motion is not None:
        check("color_from_depth", motion, Extrinsics)
        for field, values in zip(motion._fields, motion, strict=True):
            check(f"{field} of color_from_depth", values, tuple)
            for value in values:
                check(f"{field} of color_from_depth", value, Real)


@lru_cache(maxsize=64)
def _check_ranges(calibration: Calibration) -> None:
    for name, camera in (("color", calibration.color), ("depth", calibration.depth)):
        if camera is not None:
            _check_camera(name, camera)
    check_depth_unit(calibration.depth_unit)
    motion = calibration.color_from_depth
    remedy = "pass --log.color-from-depth tx ty tz qx qy qz qw"
    if motion is None:
        if calibration.color is not None:
            problem = "the transform from depth to colour camera is missing"
            raise CalibrationError(problem, remedy=f"{remedy}, or omit the colour camera")
        return
    if calibration.color is None:
        problem = "a transform from depth to colour camera needs a colour camera"
        raise CalibrationError(problem, remedy="omit color_from_depth, or set color")
    if not is_rotation(motion.rotation):
        problem = "the rotation from depth to colour camera is not a rotation matrix"
        raise CalibrationError(problem, remedy=remedy)
    distance = float(reduce(hypot, motion.translation, 0.0))
    farthest = min(MAX_BASELINE_M, 65535 * calibration.depth_unit)
    if len(motion.translation) != 3 or not distance <= farthest:
        raise CalibrationError(
            f"the depth camera is {distance:g} m from the colour camera, more than the maximum of "
            f"{farthest:g} m with a depth unit of {calibration.depth_unit:g} m",
            remedy=remedy,
        )


def check_depth_unit(unit: float) -> None:
    """Check a depth unit [m].

    Raises:
        CalibrationError: The unit is outside of ``DEPTH_UNITS_M``.
    """
    smallest, largest = DEPTH_UNITS_M
    if not smallest <= unit <= largest:
        raise CalibrationError(
            f"the depth unit must be from {smallest:g} to {largest:g} m, got {unit:g} m",
            remedy="pass --log.depth-unit-m",
        )


def _check_view(name: str, camera: Intrinsics) -> None:
    """Check the field of view and the optical centre against the image size.

    The optical centre may be outside of the image by up to its width and height, as in cropped
    images.
    """
    width, height, fx, fy, cx, cy = camera[:6]
    remedy = f"pass --log.{name}-intrinsics fx fy cx cy"
    name, size = _spelled(name), f"images of {width}x{height} pixels"
    if not (-width <= cx <= 2 * width and -height <= cy <= 2 * height):
        problem = f"the optical centre ({cx:g}, {cy:g}) is far outside of the {name} {size}"
        raise CalibrationError(problem, remedy=remedy)
    sides = (width, fx, cx), (height, fy, cy)
    view = max(
        math.degrees(arctan2(size - center, focal) + arctan2(center, focal))
        for size, focal, center in sides
    )
    narrowest, widest = VIEW_DEG
    if not narrowest <= view <= widest:
        raise CalibrationError(
            f"the field of view of the {name} camera is {view:.3g}° (fx {fx:g}, fy {fy:g}, "
            f"{size}), not {narrowest:g}° to {widest:g}°",
            remedy=remedy,
        )


def _spelled(name: str) -> str:
    return "colour" if name == "color" else name


def _check_camera(name: str, camera: Intrinsics) -> None:
    flag = f"--log.{name}-intrinsics fx fy cx cy"
    width, height, fx, fy, cx, cy, model, coefficients = camera
    name = _spelled(name)
    if min(width, height) < 1:
        problem = f"the {name} camera's image size is {width}x{height} pixels"
        raise CalibrationError(problem, remedy="set the size of its images")
    shortest, longest = FOCAL_LENGTHS
    if not all(shortest <= focal <= longest for focal in (fx, fy)):
        problem = f"the {name} camera is not calibrated (fx {fx:g}, fy {fy:g})"
        raise CalibrationError(problem, remedy=f"pass {flag}")
    if max(fx, fy) > MAX_PIXEL_ASPECT * min(fx, fy):
        problem = f"fx {fx:g} and fy {fy:g} of the {name} camera differ by more than a factor of"
        raise CalibrationError(f"{problem} {MAX_PIXEL_ASPECT:g}", remedy=f"pass {flag}")
    if not (abs(cx) <= longest and abs(cy) <= longest):
        problem = f"the optical centre ({cx:g}, {cy:g}) is far outside of the {name} image"
        raise CalibrationError(problem, remedy=f"pass {flag}")
    if model not in tuple(Distortion):
        models = ", ".join(Distortion)
        problem = f"the {name} camera's lens model {str(model)[:60]!a} is unknown"
        raise CalibrationError(problem, remedy=f"use one of {models}")
    if len(coefficients) > NUM_COEFFICIENTS or not all(
        abs(value) <= MAX_COEFFICIENT for value in coefficients
    ):
        listed = " ".join(f"{value:g}" for value in coefficients[:12])
        raise CalibrationError(
            f"the {name} camera's distortion coefficients {listed} are implausible",
            remedy=f"correct the calibration: at most {NUM_COEFFICIENTS} coefficients, each of at "
            f"most {MAX_COEFFICIENT:g}",
        )


def check_frames(frames: Frames, config: Config, *, floor_only: bool = False) -> None:
    """Check that kernels support the frames.

    Args:
        frames: Frames.
        config: Configuration. ``paper`` requires colour images, other presets depth cells of a
            valid size.
        floor_only: Whether only the floor is estimated, which requires cells but no colour.

    Raises:
        CalibrationError: See :func:`check_calibration`; or the size of a camera differs from that
            of its images.
        InputError: Images are not arrays of uint8 and uint16; the numbers of colour images, depth
            images and planes differ or exceed :data:`MAX_FRAMES`; or a plane is not finite.
        ConfigError: The size of depth cells or their number per image is not supported.
    """
    of_type("frames", frames, Frames)
    _check_images("depth", frames.depth, "uint16", 3)
    _check_camera_once(frames.calibration)
    check_size("depth", frames.depth.shape, frames.calibration.depth)
    rows = {"depth images": len(frames.depth)}
    if frames.color is not None and not floor_only:
        _check_images("colour", frames.color, "uint8", 4)
        check_size("colour", frames.color.shape, frames.calibration.image)
        rows["colour images"] = len(frames.color)
    elif config.cluster.points and not floor_only:
        problem = "the preset paper needs colour images, got none"
        raise InputError(problem, remedy="pass colour images, or use another preset")
    ground = config.ground
    stated = frames.plane is not None or ground.camera_height_m is not None
    if config.cluster.points and not (floor_only or stated or ground.source == "none"):
        problem = "the preset paper needs a floor plane, got none"
        remedy = "set frames.plane, for instance by jaxdet.estimate_plane(frames)"
        raise InputError(problem, remedy=remedy)
    if floor_only or not config.cluster.points:
        _check_cells(frames.calibration.depth, config.surface)
    if frames.plane is not None:
        rows["planes"] = _check_planes(frames.plane)
    rows["entries of valid"] = len(_column("valid", frames.valid, "b"))
    if not any(rows.values()):
        raise InputError("the batch is empty", remedy="pass at least one frame")
    if len(frames.depth) > MAX_FRAMES:
        problem = f"a batch has at most {MAX_FRAMES} frames, got {len(frames.depth)}"
        raise InputError(problem, remedy="pass smaller batches")
    if len(set(rows.values())) > 1:
        counts = ", ".join(f"{count} {name}" for name, count in rows.items())
        problem = f"the arrays of the batch differ in length ({counts})"
        raise InputError(problem, remedy="pass one entry per frame")


_checked_calibrations: deque[Calibration] = deque(maxlen=16)
"""Calibrations that were checked, compared by identity: equal values may differ in type."""


def _check_camera_once(calibration: Calibration) -> None:
    """Run :func:`check_calibration` once per calibration object."""
    if not any(calibration is one for one in _checked_calibrations):
        check_calibration(calibration)
        _checked_calibrations.append(calibration)


def _check_planes(planes: GroundPlane) -> int:
    """Check planes and return their number."""
    of_type("plane", planes, GroundPlane)
    columns = [
        _column(f"plane.{name}", values, "b" if name == "valid" else "fiu")
        for name, values in planes._asdict().items()
    ]
    if len({len(column) for column in columns}) > 1:
        raise InputError("the arrays of a plane differ in length", remedy=_PLANES)
    *pose, valid, start, slope = columns
    if not np.isfinite(np.stack([*pose, slope])[:, valid]).all() or np.isnan(start[valid]).any():
        raise InputError(
            "the height, pitch, roll or ramp of a valid plane is not finite",
            remedy="set valid to False if the floor is unknown",
        )
    return len(valid)


_PLANES = "pass (B,) arrays of numbers, for instance from jaxdet.flat_plane"


def _column(name: str, values: Any, kinds: str) -> np.ndarray:
    """Return values as an array with one axis; ``kinds`` has the valid NumPy kinds of its dtype."""
    array = np.asarray(values) if hasattr(values, "dtype") else np.zeros((), object)
    if array.dtype.kind not in kinds or array.ndim != 1:
        kind = str(getattr(values, "dtype", type(values).__name__))
        problem = f"expected an array with one axis, got {kind} of shape {np.shape(array)}"
        remedy = "pass a (B,) array of bool" if kinds == "b" else _PLANES
        raise InputError(problem, topic=name, remedy=remedy)
    return array


def _check_images(what: str, images: Any, kind: str, axes: int) -> None:
    """Check that images are a NumPy or JAX array with values, not a masked or traced array."""
    jax = sys.modules.get("jax")
    is_array = isinstance(images, np.ndarray) or (jax is not None and isinstance(images, jax.Array))
    actual = str(images.dtype) if is_array else type(images).__name__
    shape: Any = getattr(images, "shape", ())
    if actual != kind or len(shape) != axes or (axes == 4 and shape[-1] != 3):
        wanted = "(B, H, W, 3)" if axes == 4 else "(B, H, W)"
        raise InputError(f"expected {what} images {wanted} {kind}, got {actual} of shape {shape}")
    if isinstance(images, np.ma.MaskedArray):
        remedy = "pass images.filled(0); 0 means no depth"
        raise InputError(f"{what} images are a masked array", remedy=remedy)
    if jax is not None and isinstance(images, jax.core.Tracer):
        raise InputError(
            f"{what} images are traced arrays without values",
            remedy="call detect outside of jax.jit, jax.vmap and jax.grad",
        )


def check_size(what: str, shape: tuple[int, ...], camera: Intrinsics) -> None:
    """Check the size of images ``(B, H, W, ...)`` against their camera.

    Raises:
        CalibrationError: The sizes differ.
    """
    if tuple(shape[1:3]) != (camera.height, camera.width):
        size = "x".join(str(n) for n in shape[2:0:-1])
        raise CalibrationError(
            f"{what} images have {size} pixels, but their calibration is for {camera.width}x"
            f"{camera.height}",
            remedy="pass the calibration of these images",
        )


def _check_cells(camera: Intrinsics, config: SurfaceConfig) -> None:
    """Check the number and size of cells in a depth image against the limits of the kernels.

    Raises:
        ConfigError: No cell fits, or there are more than ``MAX_CONTOUR`` cells along a side, more
            than ``MAX_CELL_SIDE`` pixels along a side of a cell, or more than ``MAX_DEPTH_COLUMNS``
            columns.
    """
    side = cell_side(camera, config.cell_rad)
    rows, columns = camera.height // side, camera.width // side
    size = f"depth images of {camera.width}x{camera.height} pixels"
    if camera.width > MAX_DEPTH_COLUMNS:
        raise ConfigError(
            f"{size} exceed the maximum of {MAX_DEPTH_COLUMNS} columns",
            remedy="record smaller images or scale them",
        )
    if side > MAX_CELL_SIDE or not min(rows, columns):
        raise ConfigError(
            f"{size} do not fit cells of {side}x{side}: at least one must fit, with at most "
            f"{MAX_CELL_SIDE} pixels per side",
            remedy="lower --surface.cell-rad, the angular size of a cell",
        )
    if max(rows, columns) > MAX_CONTOUR:
        raise ConfigError(
            f"{size} have {columns}x{rows} cells, more than the maximum of {MAX_CONTOUR} per side",
            remedy="raise --surface.cell-rad, the angular size of a cell",
        )


def check_points(points: int) -> None:
    """Check the number of points per frame against the limits of keys, sums and kernel memory.

    Raises:
        ConfigError: There are more than ``MAX_POINTS`` points.
    """
    if points > MAX_POINTS:
        raise ConfigError(
            f"{points} points per frame exceed the maximum of {MAX_POINTS}",
            remedy="lower --features.max-corners",
        )
