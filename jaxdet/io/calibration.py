"""Calibration for the chosen topics, with the source of each part."""

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxdet.checks import check_calibration, check_depth_unit
from jaxdet.errors import CalibrationError, TransformError, printable
from jaxdet.io.body_frames import T_BODY_OPTICAL, body_frame_text, optical_frame
from jaxdet.io.contents import LogContents
from jaxdet.io.extrinsics import find_extrinsics
from jaxdet.io.folders.basic import LISTED_DEPTH
from jaxdet.io.intrinsics import CameraSource, Found, find_intrinsics
from jaxdet.io.messages import CameraInfoMessage, Kind
from jaxdet.io.namespaces import affinity
from jaxdet.io.options import LogOptions
from jaxdet.io.streams import ImageStream
from jaxdet.io.topics import (
    NO_COLOR_TOPIC,
    Choice,
    camera_name,
    is_color_name,
    is_rectified,
    listed,
)
from jaxdet.types import Calibration, Extrinsics, Intrinsics

DEPTH_UNIT_M = 0.001
"""Default metres per depth unit."""
_ASSUMED = "the default"
"""Source reported for the default depth unit."""
_NEAR_M, _FAR_M = 0.05, 65.535
"""Range of plausible median depths of an image [m]."""
_TYPICAL_M = 0.4, 6.0
"""Range of usual median depths of an image, by which centimetres and millimetres are distinguished
[m]."""
_FAR_16_BIT_M = 10.0
"""Median depth from which on a unit of 1 mm is doubted, as 16 bits reach up to 65 m [m]."""
_AS_FOLDERS = "as in TUM's and Open3D's folders"
_ONE_LENS = 0.01
"""Maximum difference between camera matrices of the same lens, as a fraction of the image size."""
_CROPPED = 1e-3
"""Relative tolerance for the integer ratio of focal lengths of a cropped and another image."""


class Calibrated(NamedTuple):
    """Calibration of a log, with the sources of its parts."""

    calibration: Calibration
    unit_in_floats: float
    """Depth unit, expressed in the unit of recorded 32FC1 depth."""
    camera_frame: str
    """TF frame of the depth camera; for aligned depth, that of the colour camera."""
    tf_frame: str
    """TF frame of this camera, from the images or a flag; may be a body frame."""
    T_frame_camera: np.ndarray | None
    """Transform ``(4, 4)`` float64 from ``camera_frame`` to ``tf_frame``; None if equal."""
    color_frame: str
    """TF frame of the colour images; empty if colour is not used."""
    has_color: bool
    """Whether there are usable colour or grey images, with the pixels of ``calibration.image``."""
    has_color_camera: bool
    """Whether ``calibration.image`` is a colour camera."""
    color_problem: str
    """Why ``has_color`` is False, and the remedy; else empty."""
    color_error: CalibrationError | None
    """Error in the colour camera's calibration; None if the camera is usable or does not exist."""
    origins: tuple[str, ...]
    """Descriptions of the cameras and the depth unit with their sources, for users."""
    extrinsics_source: str
    used: dict[str, CameraInfoMessage]
    """Calibration messages used, by topic."""
    of_depth: str
    """Topic in ``used`` with the calibration of depth; empty if flags supply the calibration."""
    warnings: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def used_for_depth(self) -> dict[str, CameraInfoMessage]:
        """Calibration messages of depth, by topic; frames with another calibration are unusable."""
        return {name: info for name, info in self.used.items() if name == self.of_depth}


class _Color(NamedTuple):
    """Calibration of the colour images, and their extrinsics relative to the depth images."""

    usable: bool
    camera: Found | None = None
    """Camera of the colour images, if their pixels differ from those of the depth images."""
    extrinsics: Extrinsics | None = None
    origin: str = ""
    """Source of the extrinsics."""
    warnings: tuple[str, ...] = ()
    error: CalibrationError | None = None
    """Error because of which the colour images are unusable."""
    depth_is_body: bool = False
    """Whether the extrinsics show that the TF frame of depth is a body frame."""


def calibrate(
    contents: LogContents, choice: Choice, options: LogOptions, *, is_body: bool = False
) -> Calibrated:
    """Return the calibration of the chosen topics.

    Depth that is aligned to colour uses the calibration of the colour camera or, if it is missing,
    that of the depth topic. If the colour camera has no calibration or extrinsics, its images are
    not used; this is an error only if options for its calibration are set.

    The frame of the depth images is taken as a body frame if the images show that (``is_body``) or
    if the extrinsics show it.

    Raises:
        CalibrationError: A part of the calibration of depth is missing, unknown or contradicts
            another. The message names the flag that supplies it.
    """
    stream = contents.streams[choice.depth]
    depth, camera = _source(contents, stream, True, options), None
    if choice.color:
        camera = _source(contents, contents.streams[choice.color], False, options)
    unit, unit_source, recorded = _units(contents, options, stream)
    aligned, why = _aligned(depth, camera, choice, options)
    if aligned and choice.infrared:  # aligned depth does not have their pixels
        camera = None
    source = _of_depth(contents, depth, camera, options) if aligned else depth
    found = find_intrinsics(source)
    warnings = [*found.warnings, *_unit_doubts(stream, unit_source, recorded, contents.path)]
    if aligned:
        color = _aligned_color(depth, camera, source, found.intrinsics)
        if source is camera:
            warnings += _aligned_doubts(depth, found.intrinsics)
        if why == _AS_FOLDERS and source.matrix is not None:  # a folder's calibration is exact
            text = f"depth is assumed to be aligned to colour, {why}; otherwise pass "
            warnings.append(f"{text}--log.depth-intrinsics and --log.color-from-depth")
    elif choice.infrared:
        color = _Color(camera is not None and _same_pixels(depth, camera, found.intrinsics))
    elif camera is None:
        color = _Color(False)
    else:
        color = _other_color(contents, options, depth, camera, found.intrinsics, is_body)
    calibration = _calibration(found, color, unit, contents.path)
    origins = [_line("depth" if source is depth else "colour", found)]
    origins += [_line("colour", color.camera)] if color.camera else []
    origins.append(f"depth unit: {unit:g} m, {unit_source}")
    described = [source, *([camera] if color.camera and camera else [])]
    used = {item.topic: item.info for item in described if item.info and item.matrix is None}
    of_depth = source.topic if source.topic in used else ""
    problem, note = _without_color(choice, color)
    color_frame = camera.frame if camera else ""
    frame = options.camera_frame or (aligned and color_frame) or depth.frame
    turned = is_body or color.depth_is_body
    camera_frame, T_frame_camera = _camera_frame(contents, options, frame, turned)
    warnings += [body_frame_text(frame)] if is_body else []
    not_needed = f"not needed: depth is aligned to colour ({why})" if aligned else ""
    return Calibrated(
        calibration=calibration,
        unit_in_floats=unit / recorded,
        camera_frame=camera_frame,
        tf_frame=frame,
        T_frame_camera=T_frame_camera,
        color_frame=color_frame if color.usable else "",
        has_color=color.usable,
        has_color_camera=aligned or color.camera is not None,
        color_problem=problem,
        color_error=color.error,
        origins=tuple(origins),
        extrinsics_source=color.origin or not_needed,
        used=used,
        of_depth=of_depth,
        warnings=(*warnings, *color.warnings, *_changes(contents, used, of_depth)),
        notes=(note,) if note else (),
    )


def _calibration(found: Found, color: _Color, unit: float, path: str) -> Calibration:
    """Assemble and check the calibration of both cameras."""
    other = color.camera and color.camera.intrinsics
    calibration = Calibration(found.intrinsics, other, color.extrinsics, unit)
    try:
        check_calibration(calibration)
    except CalibrationError as error:
        raise CalibrationError(error.problem, path=path, remedy=error.remedy) from error
    return calibration


def _units(
    contents: LogContents, options: LogOptions, stream: ImageStream
) -> tuple[float, str, float]:
    """Return metres per depth unit, its source, and metres per unit of 32FC1 depth."""
    if not stream.has_floats:
        return *_depth_unit(contents, options, stream.topic), 1.0
    recorded = options.depth_unit_m or 1.0
    what = "metres" if recorded == 1 else f"units of {recorded:g} m (--log.depth-unit-m)"
    return DEPTH_UNIT_M, f"to which 32FC1 in {what} is rounded", recorded


def _camera_frame(
    contents: LogContents, options: LogOptions, frame: str, turned: bool
) -> tuple[str, np.ndarray | None]:
    """Return the optical frame's name, and its transform to ``frame`` if that is a body frame."""
    if not turned or options.camera_frame:
        return frame, None
    return optical_frame(contents.tree, frame) or f"{frame}_optical", T_BODY_OPTICAL


def _of_depth(
    contents: LogContents, depth: CameraSource, color: CameraSource | None, options: LogOptions
) -> CameraSource:
    """Return the source of calibration for depth that is aligned to colour."""
    if color is None:
        color = _without_images(contents, depth, options)
    if (depth.info or depth.matrix) and not (color.info or color.matrix):
        return depth
    if depth.info and depth.size and color.size and depth.size != color.size:
        return depth if depth.size in depth.info.image_sizes() else color
    return color


def _without_images(
    contents: LogContents, depth: CameraSource, options: LogOptions
) -> CameraSource:
    """Return the colour camera of aligned depth in a log without colour images."""
    known = [
        topic
        for topic in contents.calibrations
        if is_color_name(topic) and camera_name(topic) == camera_name(depth.topic)
    ]
    topic = options.color_info or (known[0] if len(known) == 1 else "")
    calibrations = contents.calibrations.get(topic)
    info = calibrations.of(depth.size) if calibrations else None
    sizes = (None, *info.image_sizes()) if info else ()
    if info and not options.color_info and depth.size not in sizes:
        topic, info = "", None
    return depth._replace(
        name="color",
        topic=topic,
        info=info,
        matrix=options.color_intrinsics,
        model=options.color_distortion,
    )


def _aligned_color(
    depth: CameraSource, color: CameraSource | None, source: CameraSource, camera: Intrinsics
) -> _Color:
    """Return the calibration of colour images to which depth is aligned; the sizes may differ.

    The depth images have the intrinsics ``camera``, from ``source``.
    """
    size = camera.width, camera.height
    if color is None:
        return _Color(False)
    if source is color and depth.size not in (None, size):
        width, height = depth.size or size
        problem = f"aligned depth is {width}x{height}, but colour is {camera.width}x{camera.height}"
        remedy = "pass --log.no-depth-aligned, or choose another topic with --log.depth"
        raise CalibrationError(problem, path=color.path, topic=depth.images, remedy=remedy)
    if color.size in (None, size):
        return _Color(True)
    try:
        found = find_intrinsics(color)
    except CalibrationError as error:
        return _Color(False, error=error)
    none = Extrinsics.from_matrix(np.eye(4))
    return _Color(True, found, none, "none: depth is aligned to colour", found.warnings)


def _other_color(
    contents: LogContents,
    options: LogOptions,
    depth: CameraSource,
    color: CameraSource,
    depth_camera: Intrinsics,
    is_body: bool,
) -> _Color:
    """Return the calibration and the extrinsics of a separate colour camera.

    Raises:
        CalibrationError: The calibration or extrinsics of the colour camera are missing, and
            options for them are set.
    """
    try:
        camera = find_intrinsics(color)
        one_lens = _one_lens(camera.intrinsics, depth_camera)
        found = find_extrinsics(
            contents, options, color, depth, one_lens=one_lens, depth_is_body=is_body
        )
        calibration = Calibration(depth_camera, camera.intrinsics, found.extrinsics)
        check_calibration(calibration)
    except CalibrationError as error:
        of_color = "color_info", "color_intrinsics", "color_distortion", "color_from_depth"
        if any(getattr(options, name) is not None for name in of_color):
            raise
        return _Color(False, error=error)
    warnings = *camera.warnings, *found.warnings
    error, turned = None, found.depth_is_body
    return _Color(True, camera, found.extrinsics, found.origin, warnings, error, turned)


def _without_color(choice: Choice, color: _Color) -> tuple[str, str]:
    """Return why a log has no colour, with a remedy, and a note for the user."""
    if color.usable:
        return "", f"no colour: pictures show infrared ({choice.color})" * choice.infrared
    if color.error is not None:
        unplaced = isinstance(color.error, TransformError)
        text = "extrinsics" if unplaced else "calibration"
        note = f"colour camera without {text}: pictures show depth"
        return str(color.error), f"{note} ({color.error.problem})"
    why, remedy = NO_COLOR_TOPIC if choice.infrared else choice.why_no_color
    return f"{why}; {remedy}", f"no colour ({why}): pictures show depth"


def _same_pixels(depth: CameraSource, infrared: CameraSource, camera: Intrinsics) -> bool:
    """Return whether infrared and depth have the same size, and camera matrix or TF frame."""
    if infrared.size not in (None, (camera.width, camera.height)):
        return False
    if infrared.info is None:
        return depth.shares_frame(infrared)
    try:
        own = find_intrinsics(infrared).intrinsics
    except CalibrationError:
        return False
    return np.allclose(own[2:6], camera[2:6], rtol=0, atol=0.5)


def _depth_unit(contents: LogContents, options: LogOptions, depth_topic: str) -> tuple[float, str]:
    """Return metres per depth unit, and their source."""
    if options.depth_unit_m:
        return options.depth_unit_m, "--log.depth-unit-m"
    near = [name for name in sorted(contents.depth_units) if affinity(name, depth_topic) > 1]
    if not near:
        return DEPTH_UNIT_M, _ASSUMED
    topic = max(near, key=lambda name: affinity(name, depth_topic))
    # Use the shortest decimal of the float32: 0.001, not 0.0010000000475.
    unit = float(str(np.float32(contents.depth_units[topic])))
    try:
        check_depth_unit(unit)
    except CalibrationError as error:
        problem, remedy = error.problem, error.remedy
        raise CalibrationError(problem, path=contents.path, topic=topic, remedy=remedy) from error
    return unit, f"topic {printable(topic)}"


def _unit_doubts(stream: ImageStream, source: str, recorded: float, path: str) -> list[str]:
    """Return a warning if the typical depth is implausible in its unit, or the unit is unknown.

    Args:
        stream: Depth images.
        source: Source of the depth unit.
        recorded: Metres per unit of 32FC1 depth.
        path: Path of the log.
    """
    if source == _ASSUMED and Path(path, LISTED_DEPTH).is_file():
        return [
            f"the depth unit is unknown, {DEPTH_UNIT_M:g} m is assumed; for TUM's benchmark pass "
            "--log.depth-unit-m 0.0002"
        ]
    if not stream.typical or not (stream.has_floats or source == _ASSUMED):
        return []
    middle = float(np.median(stream.typical))
    kind = "32FC1" if stream.has_floats else "16-bit"
    text = f"{printable(stream.topic)}: {kind} depth of about {middle:.3g} looks like"
    if not stream.has_floats:
        flag = "if distances are ten times too large, pass --log.depth-unit-m 0.0001"
        is_far = middle * DEPTH_UNIT_M > _FAR_16_BIT_M
        return [f"{text} tenths of a millimetre; {flag}"] if is_far else []
    if recorded < 1 and middle * recorded < _NEAR_M < middle < _FAR_M:
        return [f"{text} metres; omit --log.depth-unit-m"]
    if middle * recorded <= _FAR_M:
        return []
    (near, far), names = _TYPICAL_M, {"0.01": "centimetres", "0.001": "millimetres"}
    likely = [unit for unit in names if near < middle * float(unit) < far] or ["0.001"]
    kinds = " or ".join(names[unit] for unit in likely)
    return [f"{text} {kinds}; pass --log.depth-unit-m {' or '.join(likely)}"]


def _aligned(
    depth: CameraSource, color: CameraSource | None, choice: Choice, options: LogOptions
) -> tuple[bool, str]:
    """Return whether depth is aligned to colour, and the reason."""
    if options.depth_aligned is not None:
        flag = "--log.depth-aligned" if options.depth_aligned else "--log.no-depth-aligned"
        return options.depth_aligned, f"set by {flag}"
    if options.color_from_depth is not None or options.depth_intrinsics is not None:
        return False, "depth has its own calibration"
    if choice.aligned_by_name:
        return True, _AS_FOLDERS if Path(depth.path).is_dir() else "by the topic's name"
    if color is None or choice.infrared:
        return False, ""
    if not depth.shares_frame(color) or depth.size != color.size:
        return False, ""
    if depth.info is None:
        return True, "same frame and size as colour"
    try:
        own, other = (find_intrinsics(one).intrinsics for one in (depth, color))
    except CalibrationError:
        return False, ""
    same = np.allclose(own[2:6], other[2:6], rtol=0, atol=1e-3)
    return bool(same), "same frame, size and camera matrix as colour"


def _one_lens(color: Intrinsics, depth: Intrinsics) -> bool:
    """Return whether two images can be from the same lens, scaled or cropped."""
    values = [
        (one.fx / one.width, one.fy / one.height, one.cx / one.width, one.cy / one.height)
        for one in (color, depth)
    ]
    if np.allclose(*values, rtol=0, atol=_ONE_LENS):
        return True
    ratios = color.fx / depth.fx, color.fy / depth.fy
    steps = [ratio if ratio >= 1 else 1 / ratio for ratio in ratios]
    return np.allclose(steps, np.round(steps), rtol=_CROPPED, atol=0)


def _aligned_doubts(depth: CameraSource, color: Intrinsics) -> list[str]:
    """Return a warning if the matrices of aligned depth (K, P if rectified) differ from colour."""
    if depth.info is None or depth.matrix is not None:
        return []
    own = []
    for rectified in (False, True):
        with suppress(CalibrationError):
            own.append(find_intrinsics(depth._replace(rectified=rectified)).intrinsics[2:6])
    if not own or any(np.allclose(one, color[2:6], rtol=0, atol=0.5) for one in own):
        return []
    text = "depth is treated as aligned, but its camera matrix differs from colour's"
    return [f"{printable(depth.topic)}: {text}"]


def _source(
    contents: LogContents, stream: ImageStream, depth: bool, options: LogOptions
) -> CameraSource:
    name = "depth" if depth else "color"
    override = options.depth_info if depth else options.color_info
    topic = _info_topic(contents, stream, depth, override)
    size, known = stream.size(depth), contents.calibrations.get(topic)
    info = known.of(size) if known else None
    return CameraSource(
        name=name,
        images=stream.topic,
        frame=stream.frame_id(depth),
        topic=topic,
        info=info,
        size=size,
        rectified=stream.kind is Kind.DISPARITY or is_rectified(stream.topic),
        matrix=options.depth_intrinsics if depth else options.color_intrinsics,
        model=options.depth_distortion if depth else options.color_distortion,
        path=contents.path,
        max_pixels=options.max_pixels,
        known=tuple(sorted(contents.calibrations)),
    )


def _info_topic(
    contents: LogContents, stream: ImageStream, depth: bool, override: str | None
) -> str:
    """Return the calibration topic: from a flag, else next to the images, else in their frame."""
    known = contents.calibrations
    if override:
        if override not in known:
            flag = "--log.depth-info" if depth else "--log.color-info"
            remedy = f"set {flag} to one of: {listed(sorted(known)) or 'none'}"
            problem = "topic has no calibration"
            raise CalibrationError(problem, path=contents.path, topic=override, remedy=remedy)
        return override
    if stream.kind is Kind.RGBD:
        topic = f"{stream.topic} ({'depth' if depth else 'rgb'})"
        return topic if topic in known else ""
    parts = stream.topic.split("/")
    for end in range(len(parts) - 1, max(len(parts) - 3, 0), -1):
        for name in ("camera_info", "info/camera_info"):  # the second is used by librealsense
            topic = "/".join([*parts[:end], name])
            if topic in known:
                return topic
    frame = stream.frame_id(depth)
    same = [name for name, item in known.items() if frame and item.frame_id == frame]
    best = max((affinity(name, stream.topic) for name in same), default=0)
    nearest = [name for name in same if affinity(name, stream.topic) == best]
    if stream.kind is Kind.DISPARITY:  # the TF frame is that of the left image
        nearest = [name for name in nearest if "left" in name.split("/")] or nearest
    return nearest[0] if len(nearest) == 1 else ""


def _changes(
    contents: LogContents, used: Mapping[str, CameraInfoMessage], of_depth: str
) -> list[str]:
    lost = "frames with another calibration are skipped"
    kept = "boxes and pictures of later frames may be misplaced"
    return [
        f"{printable(name)} changes: {lost if name == of_depth else kept}"
        for name in sorted(used)
        if len(contents.calibrations[name].changes) > 1
    ]


def _line(name: str, found: Found) -> str:
    value = found.intrinsics
    matrix = f"fx {value.fx:.6g} fy {value.fy:.6g} cx {value.cx:.6g} cy {value.cy:.6g}"
    lens = value.distortion.value
    if value.coefficients:
        lens += " " + " ".join(f"{item:.6g}" for item in value.coefficients)
    size = f"{value.width}x{value.height}"
    return f"{name}: {size}, {matrix}, distortion {lens}; from {found.origin}"
