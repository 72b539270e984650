"""Intrinsics from CameraInfo and CameraCalibration messages."""

from typing import NamedTuple

import numpy as np

from jaxdet.checks import check_camera
from jaxdet.errors import CalibrationError, printable
from jaxdet.io.messages import CameraInfoMessage
from jaxdet.io.options import LogOptions
from jaxdet.io.streams import ImageSize
from jaxdet.io.topics import listed
from jaxdet.types import Distortion, Intrinsics

_ALIASES = {
    "": Distortion.PLUMB_BOB,
    "brown_conrady": Distortion.PLUMB_BOB,
    "fisheye": Distortion.EQUIDISTANT,
    "kannala_brandt": Distortion.EQUIDISTANT,
    "kannala_brandt4": Distortion.EQUIDISTANT,
}
_COUNTS = {
    Distortion.NONE: 0,
    Distortion.PLUMB_BOB: 5,
    Distortion.RATIONAL: 8,
    Distortion.EQUIDISTANT: 4,
    Distortion.INVERSE_BROWN_CONRADY: 5,
}
OFF_MIDDLE = 0.2
"""Distance of the optical centre from the image centre, as a fraction of the image size, above
which a warning is given."""
_EQUAL_PX = 0.5
"""Maximum difference between equal camera matrices [pixel]."""
_Matrix = tuple[float, float, float, float]
"""fx fy cx cy of a camera matrix [pixel]."""


class CameraSource(NamedTuple):
    """Sources for the intrinsics of a camera."""

    name: str
    """``color`` or ``depth``, as in the flags."""
    topic: str
    """Topic of the calibration; empty if there is none."""
    info: CameraInfoMessage | None
    size: ImageSize | None
    """Size of the images; None if no image could be decoded."""
    rectified: bool
    """Whether the images are rectified, according to the name or the type of their topic."""
    matrix: _Matrix | None
    """fx fy cx cy from a flag."""
    model: str | None
    """Distortion model from a flag."""
    path: str
    max_pixels: int = LogOptions.max_pixels
    known: tuple[str, ...] = ()
    """Topics in the log with calibrations."""
    images: str = ""
    """Topic of the images."""
    frame: str = ""
    """TF frame of the images; empty if unknown."""

    @property
    def camera(self) -> str:
        """Name of the camera in errors and warnings."""
        return {"color": "colour"}.get(self.name, self.name)

    def shares_frame(self, other: "CameraSource") -> bool:
        """Return whether the images of both cameras are in the same TF frame."""
        return bool(self.frame) and self.frame == other.frame

    def error(self, problem: str, remedy: str) -> CalibrationError:
        """Return a CalibrationError about this camera."""
        return CalibrationError(problem, path=self.path, topic=self.topic, remedy=remedy)


class Found(NamedTuple):
    """Intrinsics with their source and warnings."""

    intrinsics: Intrinsics
    origin: str
    warnings: tuple[str, ...]


def find_intrinsics(source: CameraSource) -> Found:
    """Determine the intrinsics of a camera from flags and its calibration message.

    Flags override the message. If the images are rectified but the message has distortion
    coefficients, the projection matrix P is used, without distortion.

    Raises:
        CalibrationError: There is no calibration, it is implausible, its size differs from the
            images, or its distortion is not supported. The error names the flag to set.
    """
    info, flag = source.info, f"--log.{source.name}-intrinsics"
    if info is None and source.matrix is None:
        problem = f"no calibration of the {source.camera} camera"
        remedy = f"pass {flag} fx fy cx cy"
        if source.known:
            topics = listed(source.known)
            remedy = f"set its topic with --log.{source.name}-info ({topics}) or {remedy}"
        raise source.error(problem, remedy)
    warnings: list[str] = []
    size = _size(source, flag, warnings)
    name, origin = "K", f"topic {printable(source.topic)}"
    if source.matrix is not None:
        fx, fy, cx, cy = source.matrix
        origin = flag + (f", distortion of topic {printable(source.topic)}" if info else "")
    else:
        assert info is not None
        name, matrix, why = _declared(source, info)
        if matrix is None:
            problem = f"the {source.camera} camera is not calibrated: {name} has no focal length"
            raise source.error(problem, f"pass {flag}")
        fx, fy, cx, cy = _of_images(info, size, matrix)
        origin += why + _part_text(info, size)
    model, coefficients = _distortion(source, warnings) if name == "K" else (Distortion.NONE, ())
    found = Intrinsics(size.width, size.height, fx, fy, cx, cy, model, coefficients)
    try:
        check_camera(source.name, found)
    except CalibrationError as error:
        raise source.error(error.problem, error.remedy) from error
    is_whole = not info or size not in info.image_sizes() or size == (info.width, info.height)
    if is_whole and not _is_central((fx, fy, cx, cy), size.width, size.height):
        warnings.append(
            f"the optical centre ({cx:g}, {cy:g}) is far from the centre of the {source.camera} "
            f"images ({size.width}x{size.height}); it may belong to another image size"
        )
    return Found(found, origin, tuple(warnings))


def _declared(source: CameraSource, info: CameraInfoMessage) -> tuple[str, _Matrix | None, str]:
    """Return the name of the matrix to use, its fx fy cx cy for the full sensor, and the reason.

    By definition (sensor_msgs/CameraInfo) K and D describe raw images, and P rectified ones without
    distortion. But drivers leave P at zero, at the identity or at another image size, or set K to
    zero. So the other matrix is used if only that one suits the size; P for raw images only if D is
    all zero, as both matrices then describe the same kind of camera.
    """
    matrices: dict[str, _Matrix] = {}
    if len(info.K) == 9 and info.K[0] > 0:
        matrices["K"] = info.K[0], info.K[4], info.K[2], info.K[5]
    if len(info.P) == 12 and info.P[0] > 0:
        matrices["P"] = info.P[0], info.P[5], info.P[2], info.P[6]
    differ = len(matrices) < 2 or not np.allclose(*matrices.values(), rtol=0, atol=_EQUAL_PX)
    central = {n for n, one in matrices.items() if _is_central(one, info.width, info.height)}
    is_plain = _means_none(_lens_name(source), info.D)
    used, other, why = "K", "P", ""
    if source.rectified and source.model is None:
        used, other, why = "P", "K", ", P, since the images are rectified" if differ else ""
    is_worse = (used in central, used in matrices) < (other in central, other in matrices)
    if is_worse and (used == "P" or is_plain):
        used, other, why = other, used, f", {other}, since {used} doesn't fit the images"
    elif differ and is_plain and len(central) == 2:
        values = " ".join(f"{value:.6g}" for value in matrices[other])
        why += f" ({other} is {values}; --log.{source.name}-intrinsics overrides both)"
    return used, matrices.get(used), why


def _is_central(matrix: _Matrix, width: int, height: int) -> bool:
    """Return whether the optical centre is near the middle of the images."""
    _, _, cx, cy = matrix
    off = abs((cx + 0.5) / max(width, 1) - 0.5), abs((cy + 0.5) / max(height, 1) - 0.5)
    return max(off) <= OFF_MIDDLE


def _of_images(info: CameraInfoMessage, size: ImageSize, matrix: _Matrix) -> _Matrix:
    """Return fx fy cx cy of binned or cropped images, by the conventions of ROS.

    The centre of the first pixel stays at 0, as in ``image_geometry::PinholeCameraModel``.
    """
    fx, fy, cx, cy = matrix
    x, y, bx, by = info.image_sizes().get(size, (0, 0, 1, 1))
    return fx / bx, fy / by, (cx - x) / bx, (cy - y) / by


def _part_text(info: CameraInfoMessage, size: ImageSize) -> str:
    """Return a description of the applied binning and region of interest."""
    x, y, bx, by = info.image_sizes().get(size, (0, 0, 1, 1))
    binned = f", binned {bx}x{by}" if (bx, by) != (1, 1) else ""
    is_cut = size != (info.width, info.height) and info.roi[2:] not in ((0, 0), info[2:4])
    cut = f", region of interest at ({x}, {y})" if is_cut else ""
    return binned + cut


def _size(source: CameraSource, flag: str, warnings: list[str]) -> ImageSize:
    info = source.info
    declared = ImageSize(info.width, info.height) if info else ImageSize(0, 0)
    if source.size is None and (not info or 0 in declared):
        raise source.error(
            "neither images nor calibration have an image size", "record the log again"
        )
    size = source.size or declared
    if size.width * size.height > source.max_pixels:
        problem = f"the {source.camera} images have too many pixels ({size.width}x{size.height})"
        raise source.error(problem, "allow them with --log.max-pixels")
    if info and source.size and 0 in declared:
        warnings.append(f"{printable(source.topic)} has no image size; that of the images is used")
    elif info and size not in info.image_sizes() and source.matrix is None:
        sizes = f"{size.width}x{size.height}, but their calibration is for "
        problem = f"the {source.camera} images are {sizes}{declared.width}x{declared.height}"
        if info.binning != (1, 1) or any(info.roi):
            x, y, width, height = info.roi
            part = f"{width}x{height} at ({x}, {y})" if width else "all of it"
            binning = f"binning {info.binning[0]}x{info.binning[1]}"
            problem += f" (region of interest: {part}, {binning})"
        raise source.error(problem, f"set the topic with --log.{source.name}-info, or pass {flag}")
    return size


def _distortion(source: CameraSource, warnings: list[str]) -> tuple[Distortion, tuple[float, ...]]:
    flag = f"--log.{source.name}-distortion"
    D = source.info.D if source.info else ()
    named = _lens_name(source)
    if named == Distortion.NONE or (source.model is None and _means_none(named, D)):
        if not D and source.info and source.info.model:
            warnings.append(
                f"{printable(source.topic)} has no distortion coefficients; none is assumed"
            )
        return Distortion.NONE, ()
    if not np.isfinite(D).all():
        raise source.error("a distortion coefficient is not a number", f"pass {flag} none")
    model = _model(source, named, flag)
    if model is Distortion.PLUMB_BOB and len(D) == 8 and any(D[5:]) and source.model is None:
        text = "has the model plumb_bob with eight coefficients; rational_polynomial is assumed"
        warnings.append(f"{printable(source.topic)} {text}")
        model = Distortion.RATIONAL
    count = _COUNTS[model]
    if model is Distortion.PLUMB_BOB and len(D) == 4:
        D = (*D, 0.0)
    if len(D) < count or any(D[count:]):
        problem = f"{len(D)} distortion coefficients don't fit {model.value} ({count})"
        raise source.error(problem, f"set the model with {flag}")
    return model, tuple(D[:count])


def _lens_name(source: CameraSource) -> str:
    """Return the name of the distortion model, from a flag or the message."""
    named = source.model if source.model is not None else source.info.model if source.info else ""
    return named.strip().lower().replace(" ", "_")


def _means_none(model: str, D: tuple[float, ...]) -> bool:
    """Return whether a lens has no distortion; equidistant lenses have it even if D is all zero."""
    return not any(D) and (not D or _ALIASES.get(model, model) != Distortion.EQUIDISTANT)


def _model(source: CameraSource, name: str, flag: str) -> Distortion:
    if name in _ALIASES and source.model is None:
        return _ALIASES[name]
    try:
        return Distortion(name)
    except ValueError as error:
        known = ", ".join(model.value for model in Distortion)
        problem = f"distortion model {name[:60]!a} is unknown"
        raise source.error(problem, f"set {flag} to one of {known}") from error
