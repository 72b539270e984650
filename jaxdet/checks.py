"""Checks of arrays and calibrations before kernels read them.

Everything from a log, a flag or a caller passes here once; kernels check nothing again.
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
"""Most pixels of a cell's side: sums of depths have 31 bits."""
MAX_DEPTH_COLUMNS = 4096
"""Most columns of a depth image in cells."""
MAX_FRAMES = 1 << 16
"""Most frames of a batch."""

FOCAL_LENGTHS = 1.0, 1e6
"""Shortest and longest focal length [pixel], of images of any size."""
VIEW_DEG = 1.0, 179.0
"""Narrowest and widest field of view, along the side of the images that shows more [degree]."""
MAX_PIXEL_ASPECT = 4.0
"""Most that fx and fy differ by, as a factor: rows or columns that are binned make it 2."""
MAX_COEFFICIENT = 1e4
"""Largest magnitude of a distortion coefficient."""
MAX_BASELINE_M = 10.0
"""Farthest that the depth camera may be from the colour camera; and no farther than depth reaches,
so that sums of products have 32 bits."""


def check_calibration(calibration: Calibration) -> None:
    """Refuses a calibration that no cameras have.

    Raises:
        CalibrationError: See :func:`check_numbers`; or a camera's field of view or optical centre
            is not one of images of its size.
    """
    check_numbers(calibration)
    for name, camera in (("color", calibration.color), ("depth", calibration.depth)):
        if camera is not None:
            _check_view(name, camera)


def check_camera(name: str, camera: Intrinsics) -> None:
    """Refuses intrinsics that no camera has.

    Args:
        name: ``color`` or ``depth``, as in the flags.
        camera: Of plain numbers.

    Raises:
        CalibrationError: See :func:`check_calibration`.
    """
    _check_camera(name, camera)
    _check_view(name, camera)


def check_numbers(calibration: Calibration) -> None:
    """Refuses a calibration that no cameras have, whatever the size of their images.

    Raises:
        CalibrationError: A size is not positive; a focal length, an optical centre, a distortion
            coefficient, the rotation, the translation or the depth unit is no number or out of the
            range that cameras have; a lens model is unknown.
    """
    _check_types(calibration)
    _check_ranges(calibration)


def _check_types(calibration: Calibration) -> None:
    """Refuses what is no calibration of plain numbers, which can be hashed."""

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
    remedy = "give --log.color-from-depth tx ty tz qx qy qz qw"
    if motion is None:
        if calibration.color is not None:
            problem = "a colour camera, but no motion from the depth camera to it"
            raise CalibrationError(problem, remedy=f"{remedy}, or leave the colour camera out")
        return
    if calibration.color is None:
        problem = "a motion from depth to colour, but no colour camera"
        raise CalibrationError(problem, remedy="leave color_from_depth out, or give color")
    if not is_rotation(motion.rotation):
        raise CalibrationError("the rotation from depth to colour is none", remedy=remedy)
    distance = float(reduce(hypot, motion.translation, 0.0))
    farthest = min(MAX_BASELINE_M, 65535 * calibration.depth_unit)
    if len(motion.translation) != 3 or not distance <= farthest:
        raise CalibrationError(
            f"the depth camera is {distance:g} m from the colour camera, but at most "
            f"{farthest:g} m are taken with a depth unit of {calibration.depth_unit:g} m",
            remedy=remedy,
        )


def check_depth_unit(unit: float) -> None:
    """Refuses a depth unit [m] that no camera has.

    Raises:
        CalibrationError: It is out of ``DEPTH_UNITS_M``.
    """
    smallest, largest = DEPTH_UNITS_M
    if not smallest <= unit <= largest:
        raise CalibrationError(
            f"a depth unit of {unit:g} m, but cameras have {smallest:g} to {largest:g}",
            remedy="give --log.depth-unit-m",
        )


def _check_view(name: str, camera: Intrinsics) -> None:
    """Refuses a camera that does not see what images of its size show.

    An optical centre may be as far outside of the image as that is large, as in parts of images.
    """
    width, height, fx, fy, cx, cy = camera[:6]
    remedy = f"give --log.{name}-intrinsics fx fy cx cy"
    name, size = _said(name), f"images of {width}x{height} pixels"
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
            f"the {name} camera sees {view:.3g}° (fx {fx:g}, fy {fy:g}, {size}), but cameras see "
            f"{narrowest:g}° to {widest:g}°",
            remedy=remedy,
        )


def _said(name: str) -> str:
    return "colour" if name == "color" else name


def _check_camera(name: str, camera: Intrinsics) -> None:
    flag = f"--log.{name}-intrinsics fx fy cx cy"
    width, height, fx, fy, cx, cy, model, coefficients = camera
    name = _said(name)
    if min(width, height) < 1:
        problem = f"the {name} camera has images of {width}x{height} pixels"
        raise CalibrationError(problem, remedy="give the size of its images")
    shortest, longest = FOCAL_LENGTHS
    if not all(shortest <= focal <= longest for focal in (fx, fy)):
        problem = f"the {name} camera is not calibrated (fx {fx:g}, fy {fy:g})"
        raise CalibrationError(problem, remedy=f"give {flag}")
    if max(fx, fy) > MAX_PIXEL_ASPECT * min(fx, fy):
        problem = f"fx {fx:g} and fy {fy:g} of the {name} camera differ by more than a factor of"
        raise CalibrationError(f"{problem} {MAX_PIXEL_ASPECT:g}", remedy=f"give {flag}")
    if not (abs(cx) <= longest and abs(cy) <= longest):
        problem = f"the optical centre ({cx:g}, {cy:g}) is nowhere near the {name} image"
        raise CalibrationError(problem, remedy=f"give {flag}")
    if model not in tuple(Distortion):
        known = ", ".join(Distortion)
        problem = f"the {name} camera's lens model {str(model)[:60]!a} is unknown"
        raise CalibrationError(problem, remedy=f"it can be: {known}")
    if len(coefficients) > NUM_COEFFICIENTS or not all(
        abs(value) <= MAX_COEFFICIENT for value in coefficients
    ):
        listed = " ".join(f"{value:g}" for value in coefficients[:12])
        raise CalibrationError(
            f"the {name} camera's distortion coefficients {listed} are not those of a lens",
            remedy=f"at most {NUM_COEFFICIENTS} are taken, each a number of at most "
            f"{MAX_COEFFICIENT:g}; correct the calibration",
        )


def check_frames(frames: Frames, config: Config, *, floor_only: bool = False) -> None:
    """Refuse frames that kernels can't take.

    Args:
        frames: The frames.
        config: The preset ``paper`` needs colour images, others need depth cells of a fitting size.
        floor_only: Whether only the floor is searched, which needs cells and reads no colour.

    Raises:
        CalibrationError: See :func:`check_calibration`; or a camera of the calibration has another
            size than its images.
        InputError: Images are not arrays of uint8 and uint16; numbers of colour images, depth
            images and planes differ, or are more than :data:`MAX_FRAMES`; or a plane is not finite.
        ConfigError: Depth cells have a size, or images a number of cells, that is not taken.
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
        problem = "no colour images, but the preset paper finds corners in them"
        raise InputError(problem, remedy="give colour images, or use another preset")
    ground = config.ground
    stated = frames.plane is not None or ground.camera_height_m is not None
    if config.cluster.points and not (floor_only or stated or ground.source == "none"):
        problem = "no floor, but the preset paper takes the plane as it is"
        remedy = "give frames.plane, for instance of jaxdet.estimate_plane(frames)"
        raise InputError(problem, remedy=remedy)
    if floor_only or not config.cluster.points:
        _check_cells(frames.calibration.depth, config.surface)
    if frames.plane is not None:
        rows["planes"] = _check_planes(frames.plane)
    rows["entries of valid"] = len(_column("valid", frames.valid, "b"))
    if not any(rows.values()):
        raise InputError("there are no frames", remedy="give at least one")
    if len(frames.depth) > MAX_FRAMES:
        problem = f"a batch of {len(frames.depth)} frames, but at most {MAX_FRAMES} are taken"
        raise InputError(problem, remedy="give them in parts")
    if len(set(rows.values())) > 1:
        counts = ", ".join(f"{count} {name}" for name, count in rows.items())
        raise InputError(f"a batch with {counts}", remedy="give one of each for every frame")


_checked_calibrations: deque[Calibration] = deque(maxlen=16)
"""Calibrations that have passed; compared by identity, as equal values may be of other types."""


def _check_camera_once(calibration: Calibration) -> None:
    """Refuse what :func:`check_calibration` does, once for each object."""
    if not any(calibration is one for one in _checked_calibrations):
        check_calibration(calibration)
        _checked_calibrations.append(calibration)


def _check_planes(planes: GroundPlane) -> int:
    """How many planes there are."""
    of_type("plane", planes, GroundPlane)
    columns = [
        _column(f"plane.{name}", values, "b" if name == "valid" else "fiu")
        for name, values in planes._asdict().items()
    ]
    if len({len(column) for column in columns}) > 1:
        raise InputError("a plane whose parts are of several lengths", remedy=_PLANES)
    *known, valid, start, slope = columns
    if not np.isfinite(np.stack([*known, slope])[:, valid]).all() or np.isnan(start[valid]).any():
        raise InputError(
            "a plane with a height, pitch, roll or ramp that is no number",
            remedy="set its valid to False where the floor is not known",
        )
    return len(valid)


_PLANES = "give (B,) numbers each, for instance by jaxdet.flat_plane"


def _column(name: str, values: Any, kinds: str) -> np.ndarray:
    """An array with one axis, of some kinds of NumPy's types."""
    found = np.asarray(values) if hasattr(values, "dtype") else np.zeros((), object)
    if found.dtype.kind not in kinds or found.ndim != 1:
        said = str(getattr(values, "dtype", type(values).__name__))
        problem = f"{said} of shape {np.shape(found)}"
        remedy = "give a (B,) array of bool" if kinds == "b" else _PLANES
        raise InputError(problem, topic=name, remedy=remedy)
    return found


def _check_images(what: str, images: Any, kind: str, axes: int) -> None:
    """Refuse what is not an array of NumPy or JAX with values: lists, masked and traced arrays."""
    jax = sys.modules.get("jax")
    is_array = isinstance(images, np.ndarray) or (jax is not None and isinstance(images, jax.Array))
    given = str(images.dtype) if is_array else type(images).__name__
    shape: Any = getattr(images, "shape", ())
    if given != kind or len(shape) != axes or (axes == 4 and shape[-1] != 3):
        wanted = "(B, H, W, 3)" if axes == 4 else "(B, H, W)"
        raise InputError(
            f"{what} images are {given} of shape {shape}", remedy=f"give {wanted} {kind}"
        )
    if isinstance(images, np.ma.MaskedArray):
        remedy = "give images.filled(0): a pixel of 0 has no depth"
        raise InputError(f"{what} images are a masked array", remedy=remedy)
    if jax is not None and isinstance(images, jax.core.Tracer):
        raise InputError(
            f"{what} images are no arrays but traced",
            remedy="give a whole batch; detect can't be called under jax.jit, jax.vmap or jax.grad",
        )


def check_size(what: str, shape: tuple[int, ...], camera: Intrinsics) -> None:
    """Refuses images ``(B, H, W, ...)`` of another size than their camera's.

    Raises:
        CalibrationError: They have another size.
    """
    if tuple(shape[1:3]) != (camera.height, camera.width):
        found = "x".join(str(n) for n in shape[2:0:-1])
        raise CalibrationError(
            f"{what} images of {found} pixels, but the calibration has {camera.width}x"
            f"{camera.height}",
            remedy="give the calibration of these images",
        )


def _check_cells(camera: Intrinsics, config: SurfaceConfig) -> None:
    """Refuse depth images without a cell, or with more than contours and kernels have room for.

    Raises:
        ConfigError: No cell fits, a side has more than ``MAX_CONTOUR`` of them, a cell has more
            than ``MAX_CELL_SIDE`` pixels a side, or images have more than ``MAX_DEPTH_COLUMNS``.
    """
    side = cell_side(camera, config.cell_rad)
    rows, columns = camera.height // side, camera.width // side
    size = f"depth images of {camera.width}x{camera.height} pixels"
    if camera.width > MAX_DEPTH_COLUMNS:
        raise ConfigError(
            f"{size}, but at most {MAX_DEPTH_COLUMNS} columns are taken",
            remedy="record or scale them smaller",
        )
    if side > MAX_CELL_SIDE or not min(rows, columns):
        raise ConfigError(
            f"{size} in cells of {side}x{side}, but one must fit, and at most {MAX_CELL_SIDE} "
            "pixels a side are taken",
            remedy="lower --surface.cell-rad, the angle that a cell takes up",
        )
    if max(rows, columns) > MAX_CONTOUR:
        raise ConfigError(
            f"{size} in {columns}x{rows} cells, but at most {MAX_CONTOUR} a side are taken",
            remedy="raise --surface.cell-rad, the angle that a cell takes up",
        )


def check_points(points: int) -> None:
    """Refuses more points a frame than keys, sums and the kernels' memory hold.

    Raises:
        ConfigError: There are more than ``MAX_POINTS``.
    """
    if points > MAX_POINTS:
        raise ConfigError(
            f"{points} points a frame are more than {MAX_POINTS}",
            remedy="lower --features.max-corners",
        )
