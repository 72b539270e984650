"""Conversion of a detector's arguments to arrays and calibrations of the pipeline.

All arguments are checked here, and errors name the argument.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from jaxdet.arguments import named_type, numbers
from jaxdet.camera import check_steepness, corner_rays, fixed_rays
from jaxdet.checks import MAX_FRAMES, check_calibration, check_numbers
from jaxdet.errors import CalibrationError, ConfigError, InputError, JaxdetError
from jaxdet.types import (
    Calibration,
    Distortion,
    Extrinsics,
    Intrinsics,
    focal_and_center,
    is_rigid,
)

ColorOrder = Literal["rgb", "bgr"]
Pinhole = tuple[float, float, float, float]
"""``fx fy cx cy`` of a camera whose image size is unknown until the first frame."""
MAX_UNITS = 65535
"""Maximum depth [depth units]."""
MAX_PIXELS = 1 << 25
"""Maximum number of pixels per image, as for images in logs."""


@contextmanager
def named(argument: str, remedy: str = "") -> Iterator[None]:
    """Add the argument's name to errors in the block.

    ``remedy`` replaces a remedy that names a command-line flag.
    """
    try:
        yield
    except JaxdetError as error:
        remedy = remedy if remedy and "--" in error.remedy else error.remedy
        part = "" if error.topic in ("", argument) else f"{error.topic}: "
        raise type(error)(part + error.problem, topic=argument, remedy=remedy) from None


@contextmanager
def untraced() -> Iterator[None]:
    """Raise a one-line error if the block is traced by JAX, so that arrays have no values.

    Raises:
        InputError: The block is traced.
    """
    try:
        yield
    except TypeError as error:  # NumPy's error for a tracer
        if not type(error).__module__.startswith("jax."):
            raise
        problem = "a Detector can't be called under jax.jit, jax.vmap or jax.grad"
        raise InputError(problem, remedy="call it outside of the transformed function") from None


class Cameras:
    """Calibration of a detector, which is complete once the image sizes are known.

    Args:
        K: Depth camera, see :class:`jaxdet.detector.Detector`.
        color_K: Colour camera; None: colour is aligned with depth, or unused.
        T_color_depth: Transform from depth to colour camera; required with ``color_K``.
        depth_unit_m: Metres per unit of a uint16 depth image.

    Raises:
        CalibrationError: See :class:`jaxdet.detector.Detector`.
    """

    def __init__(
        self,
        K: ArrayLike | Intrinsics,
        color_K: ArrayLike | Intrinsics | None,
        T_color_depth: ArrayLike | Extrinsics | None,
        depth_unit_m: float,
    ) -> None:
        unit = numbers("depth_unit_m", depth_unit_m, float)
        if unit.ndim:
            raise InputError(f"expected a number, got shape {unit.shape}", topic="depth_unit_m")
        self.depth_unit_m = float(unit)
        self._depth, self._color = _camera("K", K), None
        self._motion = None
        self._known: Calibration | None = None
        if (color_K is None) != (T_color_depth is None):
            present, missing = ("color_K", "T_color_depth")[:: 1 if T_color_depth is None else -1]
            raise CalibrationError(
                f"{present} needs {missing}",
                remedy="pass both if colour is not aligned with depth, neither otherwise",
            )
        if color_K is not None and T_color_depth is not None:
            self._color = _camera("color_K", color_K)
            with named("T_color_depth", _TRANSFORM):
                self._motion = _motion(T_color_depth)
        # Checks that do not depend on the image size.
        small = [_sized(camera, (2, 2)) for camera in (self._depth, self._color)]
        whole = Calibration(small[0] or _NOTHING, small[1], self._motion, self.depth_unit_m)
        self._check(whole, check_numbers)

    @classmethod
    def of(cls, calibration: Calibration) -> "Cameras":
        """Return the cameras of a calibration."""
        color, motion = calibration.color, calibration.color_from_depth
        return cls(calibration.depth, color, motion, calibration.depth_unit)

    def __str__(self) -> str:
        """Return a short description."""
        camera = self._depth
        fx, fy, cx, cy = camera[2:6] if isinstance(camera, Intrinsics) else camera
        focal = f"fx {fx:g} fy {fy:g} cx {cx:g} cy {cy:g}"
        if isinstance(camera, Intrinsics) and camera.distortion is not Distortion.NONE:
            focal += f" {camera.distortion}"
        return focal + (", with a colour camera" if self._color else "")

    def calibration(self, depth: tuple[int, ...], color: tuple[int, ...] | None) -> Calibration:
        """Return the calibration of images of these shapes ``(B, H, W, ...)``.

        Raises:
            CalibrationError: The calibration is for another image size.
        """
        depths, colors = self._depth, self._color
        if self._known is not None:
            depths, colors = self._known.depth, self._known.color
        for name, camera, shape in (("depth", depths, depth), ("color", colors, color)):
            if not isinstance(camera, Intrinsics) or shape is None:
                continue
            if (camera.height, camera.width) != shape[1:3]:
                raise CalibrationError(
                    f"images have {shape[2]}x{shape[1]} pixels, but the calibration is for "
                    f"{camera.width}x{camera.height}",
                    topic=name,
                    remedy="create a Detector per image size",
                )
        if self._color is None and color is not None and color[1:3] != depth[1:3]:
            raise CalibrationError(
                f"colour images of {color[2]}x{color[1]} pixels are not aligned with depth images "
                f"of {depth[2]}x{depth[1]}",
                topic="color",
                remedy="pass color_K and T_color_depth",
            )
        if self._known is None:
            self._known = self._complete(depth, color)
        return self._known

    def _complete(self, depth: tuple[int, ...], color: tuple[int, ...] | None) -> Calibration:
        for name, camera, shape in (("K", self._depth, depth), ("color_K", self._color, color)):
            if camera is not None and not isinstance(camera, Intrinsics):
                if shape is None:
                    raise CalibrationError(
                        "the size of the colour images is unknown",
                        topic=name,
                        remedy="pass jaxdet.Intrinsics.from_matrix(K, width, height), or a colour "
                        "image with the first frame",
                    )
                height, width = shape[1:3]
                _, _, cx, cy = camera
                if not (0 <= cx < width and 0 <= cy < height):
                    raise CalibrationError(
                        f"the optical centre ({cx:g}, {cy:g}) is outside of images of "
                        f"{width}x{height} pixels",
                        topic=name,
                        remedy="pass the camera matrix for this image size",
                    )
        whole = Calibration(
            _sized(self._depth, depth[1:3]) or _NOTHING,
            _sized(self._color, () if color is None else color[1:3]),
            self._motion,
            self.depth_unit_m,
        )
        self._check(whole, check_calibration)
        with named("K", _LENS):
            for rays in corner_rays(whole.depth):
                check_steepness(rays, "--log.depth-intrinsics")
        if whole.color is not None:
            with named("color_K", _LENS):
                fixed_rays(whole.color)
        return whole

    def _check(self, whole: Calibration, check: Callable[[Calibration], None]) -> None:
        """Check the parts of the calibration, argument by argument."""
        pinhole = "pass a (3, 3) matrix, fx fy cx cy, or jaxdet.Intrinsics, in pixels"
        with named("K", pinhole):
            check(Calibration(whole.depth))
        if whole.color is not None:
            with named("color_K", pinhole):
                check(Calibration(whole.color))
            with named("T_color_depth", _TRANSFORM):
                check(whole._replace(depth_unit=0.001))
        with named("depth_unit_m", "pass metres, for example 0.001 for millimetres"):
            check(whole)


_NOTHING = Intrinsics(0, 0, 0.0, 0.0, 0.0, 0.0)
_ORDER = "pass depth first: detector(depth, color)"
_LENS = "pass the focal length and lens model of these images"
_TRANSFORM = "pass the (4, 4) matrix of a rigid transform, in metres"


def _camera(name: str, value: ArrayLike | Intrinsics) -> Intrinsics | Pinhole:
    if isinstance(value, Intrinsics):
        return value
    with named(name):
        with suppress(InputError):  # the check of the matrix has a better message
            array = numbers(name, value, np.float64)
            if array.shape == (4,):
                fx, fy, cx, cy = array.tolist()
                return fx, fy, cx, cy
        return focal_and_center(value)


def _sized(camera: Intrinsics | Pinhole | None, size: tuple[int, ...]) -> Intrinsics | None:
    if camera is None or isinstance(camera, Intrinsics):
        return camera
    return Intrinsics(size[1], size[0], *camera)


def _motion(value: ArrayLike | Extrinsics) -> Extrinsics:
    return value if isinstance(value, Extrinsics) else Extrinsics.from_matrix(value)


def color_images(images: Any, order: ColorOrder) -> np.ndarray:
    """Return a copy of colour images, ``(B, H, W, 3)`` uint8, RGB.

    Args:
        images: Colour ``(B, H, W, 3)`` or grey images ``(B, H, W)``, uint8, or a sequence of
            images.
        order: Channel order, ``rgb`` or ``bgr``.

    Raises:
        InputError: The type or shape of the images is wrong.
    """
    array = _stacked("color", images)
    if array.dtype == np.uint16:
        raise InputError("expected uint8 images, got uint16", topic="color", remedy=_ORDER)
    if array.dtype != np.uint8:
        raise InputError(f"expected uint8 images, got {array.dtype}", topic="color")
    if array.ndim == 3:
        return np.repeat(array[..., None], 3, axis=-1)
    if array.ndim != 4 or array.shape[-1] not in (1, 3):
        remedy = "pass (H, W, 3) or grey (H, W), with a leading axis for Detector.batch"
        if array.ndim == 4 and array.shape[-1] == 4:
            remedy = "remove the fourth channel: image[..., :3]"
        raise InputError(f"unexpected frame shape {array.shape[1:]}", topic="color", remedy=remedy)
    if array.shape[-1] == 1:
        return np.repeat(array, 3, axis=-1)
    return np.array(array[..., ::-1] if order == "bgr" else array, order="C")


def depth_images(images: Any, unit_m: float) -> np.ndarray:
    """Return a copy of depth images, ``(B, Hd, Wd)`` uint16 in units of ``unit_m``.

    Args:
        images: Depth images ``(B, Hd, Wd)`` uint16, or float32 or float64 in metres, or a sequence
            of images. NaN, infinity, 0 and masked values of :mod:`numpy.ma` mean "no measurement".
        unit_m: Metres per unit.

    Raises:
        InputError: The type or shape of the images is wrong, or floats are not in metres.
    """
    array = _stacked("depth", images)
    if array.dtype == np.uint8:
        raise InputError("expected depth images, got uint8", topic="depth", remedy=_ORDER)
    if array.ndim == 4 and array.shape[-1] == 1:
        array = array[..., 0]
    if array.ndim != 3:
        raise InputError(
            f"unexpected frame shape {array.shape[1:]}",
            topic="depth",
            remedy="pass (Hd, Wd), with a leading axis for Detector.batch",
        )
    if array.dtype.newbyteorder("=") == np.uint16:  # some cameras are big-endian
        return np.array(array, np.uint16, order="C")
    if not np.issubdtype(array.dtype, np.floating):
        raise InputError(
            f"expected uint16 or float images, got {array.dtype}",
            topic="depth",
            remedy="pass uint16 in units of depth_unit_m, or float32 in metres",
        )
    return _from_metres(array.astype(np.float32), unit_m)


def _from_metres(metres: np.ndarray, unit_m: float) -> np.ndarray:
    from jaxdet.io.images import metres_to_units

    measured = metres[np.isfinite(metres) & (metres > 0)]
    farthest = MAX_UNITS * unit_m
    if measured.size and measured.min() > farthest:
        raise InputError(
            f"the smallest depth is {measured.min():g} m",
            topic="depth",
            remedy=f"pass floats in metres, at most {farthest:g}, or uint16 with depth_unit_m",
        )
    units = np.empty(metres.shape, np.uint16)
    for row, frame in zip(units, metres, strict=True):
        metres_to_units(frame, unit_m, row)
    return units


def one_frame(name: str, image: Any) -> np.ndarray:
    """Add a batch axis to a single frame.

    Raises:
        InputError: The argument is not a single image.
    """
    array = _array(name, image)
    if name == "depth" and array.dtype == np.uint8:
        raise InputError("expected a depth image, got uint8", topic=name, remedy=_ORDER)
    if array.ndim not in (2, 3) or (name == "depth" and array.ndim == 3 and array.shape[2] != 1):
        expected = "(H, W, 3) or (H, W)" if name == "color" else "(Hd, Wd)"
        color = array.ndim == 3 and array.shape[2] in (3, 4)
        several = array.ndim > 2 and not color
        remedy = "pass several frames to Detector.batch" if several else "pass an image"
        problem = f"expected a frame of shape {expected}, got {array.shape}"
        raise InputError(problem, topic=name, remedy=remedy)
    return array[None]


def _stacked(name: str, images: Any) -> np.ndarray:
    """Return an array whose first axis is the frame."""
    if isinstance(images, Sequence) and not isinstance(images, str | bytes | memoryview):
        frames = [_array(name, frame) for frame in images]
        if len({(frame.shape, frame.dtype) for frame in frames}) > 1:
            raise InputError(
                "frames differ in size or type", topic=name, remedy="pass them one by one"
            )
        images = np.stack(frames) if frames else np.zeros(0)
    array = _array(name, images)
    if not array.ndim:
        problem = f"expected an array or a list of frames, got {type(images).__name__}"
        raise InputError(problem, topic=name)
    if not array.size:
        raise InputError("expected at least one frame, got none", topic=name)
    if len(array) > MAX_FRAMES:
        problem = f"a batch has at most {MAX_FRAMES} frames, got {len(array)}"
        raise InputError(problem, topic=name, remedy="pass smaller batches")
    if math.prod(array.shape[1:3]) > MAX_PIXELS:
        problem = f"an image of shape {array.shape[1:]} exceeds the maximum of {MAX_PIXELS} pixels"
        raise InputError(problem, topic=name, remedy="scale the image")
    return array


def _array(name: str, images: Any) -> np.ndarray:
    """Return a NumPy array; masked depths become 0."""
    kind = type(images)
    try:
        if isinstance(images, np.ma.MaskedArray):
            return images.filled(0) if name == "depth" else images.data
        if hasattr(kind, "__dlpack__") and not hasattr(kind, "__array__"):
            return np.from_dlpack(images)
        return np.asarray(images)
    except Exception as error:  # e.g. a traced JAX array, or an array on a GPU
        remedy = "pass NumPy arrays"
        if kind.__module__.startswith("jax"):
            remedy += "; a Detector can't be called under jax.jit, jax.vmap or jax.grad"
        elif reason := str(error).partition("\n")[0]:
            remedy += f" ({reason})"
        problem = f"expected an array, got {kind.__name__}"
        raise InputError(problem, topic=name, remedy=remedy) from error


def world_poses(values: Any, count: int) -> np.ndarray:
    """Return poses ``(count, 4, 4)`` float64; poses that contain NaN are unknown.

    Raises:
        InputError: The type or shape of the poses is wrong, or they are not rigid transforms.
    """
    poses = numbers("T_world_camera", values, np.float64)
    if poses.shape != (count, 4, 4):
        problem = f"expected shape ({count}, 4, 4), got {poses.shape}"
        remedy = "pass a (4, 4) matrix per frame"
        raise InputError(problem, topic="T_world_camera", remedy=remedy)
    for T in poses[~np.isnan(poses).any(axis=(1, 2))]:
        if not is_rigid(T):
            remedy = "pass (4, 4) matrices in metres, NaN if unknown"
            raise InputError("expected rigid transforms", topic="T_world_camera", remedy=remedy)
    return poses


def times(name: str, values: Any) -> np.ndarray:
    """Return timestamps ``(B,)`` int64 [ns].

    Raises:
        InputError: The type or shape is wrong, for instance floats in seconds.
    """
    array = _array(name, values)
    if array.dtype.kind == "M":
        if np.isnat(array).any():
            raise InputError("must not be NaT", topic=name, remedy="omit the frame")
        array = array.astype("M8[ns]").astype(np.int64)
    whole = array.dtype.kind in "iu" or not array.size
    if not whole or array.max(initial=0) > np.iinfo(np.int64).max:
        problem = f"expected integers of 64 bits in nanoseconds, got {array.dtype}"
        raise InputError(problem, topic=name)
    if array.ndim != 1:
        raise InputError(f"expected shape (B,), got {array.shape}", topic=name)
    return array.astype(np.int64)


def one_of(name: str, value: Any, literal: Any) -> None:
    """Check that a value is one of the values of a Literal type.

    Raises:
        ConfigError: The value is unknown.
    """
    allowed = get_args(literal)
    if not isinstance(value, str) or value not in allowed:
        remedy = f"use one of {', '.join(allowed)}"
        raise ConfigError(f"unknown value {named_type(value)}", topic=name, remedy=remedy)
