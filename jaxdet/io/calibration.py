"""The calibration of the chosen topics, each part with where it comes from."""

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
from jaxdet.io.image_folder import LISTED_DEPTH
from jaxdet.io.intrinsics import CameraSource, Found, find_intrinsics
from jaxdet.io.messages import CameraInfoMessage, Kind
from jaxdet.io.namespaces import affinity
from jaxdet.io.options import LogOptions
from jaxdet.io.streams import ImageStream
from jaxdet.io.topics import Choice, camera_name, is_color_name, listed
from jaxdet.types import Calibration, Extrinsics, Intrinsics

DEPTH_UNIT_M = 0.001
"""Metres in one depth unit, where nothing else is said."""
_ASSUMED = "the default"
"""Source that is reported for the default depth unit."""
_NEAR_M, _FAR_M = 0.05, 65.535
"""Between these is the median depth of an image."""
_AS_FOLDERS = "as in TUM's and Open3D's folders"
_ONE_LENS = 0.01
"""How much camera matrices of one lens may differ, in widths and heights of their images."""
_CROPPED = 1e-3
"""How much the focal lengths of a cropped image may differ from a whole multiple of another's."""


class Calibrated(NamedTuple):
    """A log's calibration and how it was found."""

    calibration: Calibration
    unit_in_floats: float
    """A depth unit, in the unit of recorded 32FC1 depth."""
    camera_frame: str
    """TF frame of the depth camera; of aligned depth, that of the colour camera."""
    tf_frame: str
    """The same as the images name it, which may be a body frame."""
    T_frame_camera: np.ndarray | None
    """``(4, 4)`` float64, from the camera to that frame; None if they are the same."""
    color_frame: str
    """TF frame of the colour images; empty if none are used."""
    has_color: bool
    """Whether colour images have the pixels of ``calibration.image``."""
    has_color_camera: bool
    """Whether that image is a colour camera's."""
    color_problem: str
    """Why ``has_color`` is False, and what to do; else empty."""
    color_error: CalibrationError | None
    """What the colour camera lacks; None if it lacks nothing, or there is none."""
    origins: tuple[str, ...]
    """Sentences."""
    extrinsics_source: str
    used: dict[str, CameraInfoMessage]
    """The calibrations used, by topic."""
    of_depth: str
    """The topic of these that describes depth; empty if flags do."""
    warnings: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def used_for_depth(self) -> dict[str, CameraInfoMessage]:
        """The calibration without which a frame can't be judged."""
        return {name: info for name, info in self.used.items() if name == self.of_depth}


class _Sources(NamedTuple):
    """Both cameras before their calibration is settled."""

    depth: CameraSource
    color: CameraSource | None
    """None: there are no colour images."""
    depth_frame: str
    color_frame: str

    @property
    def same_frame(self) -> bool:
        """Whether both images are in one and the same frame."""
        return bool(self.color_frame) and self.color_frame == self.depth_frame


class _Color(NamedTuple):
    """What colour images are to depth images."""

    usable: bool
    camera: Found | None = None
    """Their camera, where it is not that of the depth images."""
    extrinsics: Extrinsics | None = None
    origin: str = ""
    """Of the extrinsics."""
    warnings: tuple[str, ...] = ()
    error: CalibrationError | None = None
    """Why they can't be used."""
    depth_is_body: bool = False
    """Whether depth's frame is a body frame by its place to colour's."""


def calibrate(
    contents: LogContents, choice: Choice, options: LogOptions, *, is_body: bool = False
) -> Calibrated:
    """Return the calibration for the chosen topics: depth's, and the pose of colour to it.

    Depth that is aligned to colour has the calibration of the colour camera, or, where that has
    none, its own. A colour camera that isn't calibrated, or whose place isn't known, is an error
    only where options are about its calibration; else its images aren't used.

    Args:
        contents: What is in the log.
        choice: The topics.
        options: What the user says.
        is_body: Whether the depth images show that their frame is a body frame.

    Raises:
        CalibrationError: A part of depth's is missing, unknown or contradicts another; the text
            names the flag that supplies it.
    """
    sources = _sources(contents, choice, options)
    stream = contents.streams[choice.depth]
    unit, unit_source, recorded = _units(contents, options, stream)
    aligned, why = _aligned(sources, choice, options)
    if aligned and choice.infrared:  # which has other pixels
        sources = sources._replace(color=None, color_frame="")
    source = _of_depth(contents, sources, options) if aligned else sources.depth
    found = find_intrinsics(source)
    warnings = [*found.warnings, *_unit_doubts(unit_source, contents.path)]
    warnings += _float_doubts(stream, recorded)
    if aligned:
        color = _aligned_color(sources, source, found.intrinsics, choice.depth)
        if source is sources.color:
            warnings += _aligned_doubts(sources.depth, found.intrinsics)
        if why == _AS_FOLDERS and source.matrix is not None:  # no camera as Open3D's
            text = f"depth is taken to be aligned to colour, {why}; else give "
            warnings.append(f"{text}--log.depth-intrinsics and --log.color-from-depth")
    elif choice.infrared:
        color = _Color(_same_pixels(sources, found.intrinsics))
    else:
        color = _other_color(contents, choice, options, sources, found.intrinsics, is_body)
    calibration = _calibration(found, color, unit, contents.path)
    origins = [_line("depth" if source is sources.depth else "colour", found)]
    origins += [_line("colour", color.camera)] if color.camera else []
    origins.append(f"depth unit: {unit:g} m, {unit_source}")
    described = [source, *([sources.color] if color.camera and sources.color else [])]
    used = {item.topic: item.info for item in described if item.info and item.matrix is None}
    of_depth = source.topic if source.topic in used else ""
    problem, note = _without_color(choice, color)
    frame = options.camera_frame or (aligned and sources.color_frame) or sources.depth_frame
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
        color_frame=sources.color_frame if color.usable else "",
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
    """Return the calibration of both cameras, checked."""
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
    """Return metres in a depth unit, where that is from, and metres in a unit of 32FC1 depth."""
    if not stream.has_floats:
        return *_depth_unit(contents, options, stream.topic), 1.0
    recorded = options.depth_unit_m or 1.0
    what = "metres" if recorded == 1 else f"units of {recorded:g} m (--log.depth-unit-m)"
    return DEPTH_UNIT_M, f"to which 32FC1 in {what} is rounded", recorded


def _camera_frame(
    contents: LogContents, options: LogOptions, frame: str, turned: bool
) -> tuple[str, np.ndarray | None]:
    """Return the name of the optical frame, and the transform from it to ``frame`` if turned."""
    if not turned or options.camera_frame:
        return frame, None
    return optical_frame(contents.tree, frame) or f"{frame}_optical", T_BODY_OPTICAL


def _sources(contents: LogContents, choice: Choice, options: LogOptions) -> _Sources:
    depth = contents.streams[choice.depth]
    color = contents.streams[choice.color] if choice.color else None
    return _Sources(
        _source(contents, depth, True, options),
        _source(contents, color, False, options) if color is not None else None,
        depth.frame_id(True),
        color.frame_id(False) if color is not None else "",
    )


def _of_depth(contents: LogContents, sources: _Sources, options: LogOptions) -> CameraSource:
    """Return the source of the calibration of depth that is aligned to colour."""
    depth, color = sources.depth, sources.color
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
    """Return the colour camera of aligned depth without colour images: by flags, or the log's."""
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
    sources: _Sources, source: CameraSource, camera: Intrinsics, topic: str
) -> _Color:
    """Return colour to which depth is aligned, of the same or of another number of pixels."""
    color, size = sources.color, (camera.width, camera.height)
    if color is None:
        return _Color(False)
    if source is color and sources.depth.size not in (None, size):
        width, height = sources.depth.size or size
        problem = f"aligned depth is {width}x{height} but colour is {camera.width}x{camera.height}"
        remedy = "say --log.no-depth-aligned or choose another --log.depth"
        raise CalibrationError(problem, path=color.path, topic=topic, remedy=remedy)
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
    choice: Choice,
    options: LogOptions,
    sources: _Sources,
    depth: Intrinsics,
    is_body: bool,
) -> _Color:
    """Colour of a camera of its own.

    Raises:
        CalibrationError: Its calibration or place isn't known, though options are about it.
    """
    if sources.color is None:
        return _Color(False)
    try:
        camera = find_intrinsics(sources.color)
        found = find_extrinsics(
            contents,
            options,
            (choice.color, choice.depth),
            sources.color_frame,
            options.camera_frame or sources.depth_frame,
            one_lens=_one_lens(camera.intrinsics, depth),
            depth_is_body=is_body,
        )
        calibration = Calibration(depth, camera.intrinsics, found.extrinsics)
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
    """Return why a log has no colour, with a remedy, and a note."""
    if color.usable:
        return "", f"no colour: pictures show infrared ({choice.color})" * choice.infrared
    if color.error is not None:
        unplaced = isinstance(color.error, TransformError)
        text = "place relative to the depth camera" if unplaced else "calibration"
        note = f"the colour camera's {text} is not known: pictures show depth"
        return str(color.error), f"{note} ({color.error.problem})"
    if choice.infrared:
        why, remedy = "no colour image topic", "name a topic with --log.color"
    else:
        why, remedy = choice.why_no_color, choice.remedy
    return f"{why}; {remedy}", f"no colour ({why}): pictures show depth"


def _same_pixels(sources: _Sources, camera: Intrinsics) -> bool:
    """Return whether infrared images have the depth camera's pixels: size, and matrix or frame."""
    color = sources.color
    if color is None or color.size not in (None, (camera.width, camera.height)):
        return False
    if color.info is None:
        return sources.same_frame
    try:
        return np.allclose(find_intrinsics(color).intrinsics[2:6], camera[2:6], rtol=0, atol=0.5)
    except CalibrationError:
        return False


def _depth_unit(contents: LogContents, options: LogOptions, depth_topic: str) -> tuple[float, str]:
    """Return metres in a depth unit, and where that comes from."""
    if options.depth_unit_m:
        return options.depth_unit_m, "--log.depth-unit-m"
    near = [name for name in sorted(contents.depth_units) if affinity(name, depth_topic) > 1]
    if not near:
        return DEPTH_UNIT_M, _ASSUMED
    topic = max(near, key=lambda name: affinity(name, depth_topic))
    # The shortest decimal that is this float32: 0.001, not 0.0010000000475.
    unit = float(str(np.float32(contents.depth_units[topic])))
    try:
        check_depth_unit(unit)
    except CalibrationError as error:
        problem, remedy = error.problem, error.remedy
        raise CalibrationError(problem, path=contents.path, topic=topic, remedy=remedy) from error
    return unit, f"topic {printable(topic)}"


def _unit_doubts(source: str, path: str) -> list[str]:
    """Return a warning if the depth unit of what looks like TUM's benchmark is unknown."""
    if source != _ASSUMED or not Path(path, LISTED_DEPTH).is_file():
        return []
    return [
        f"the depth unit is not told, and taken to be {DEPTH_UNIT_M:g} m: for TUM's benchmark give "
        "--log.depth-unit-m 0.0002"
    ]


def _float_doubts(stream: ImageStream, recorded: float) -> list[str]:
    """Return a warning if the values of 32FC1 depth don't fit their unit."""
    values = [value for value in stream.typical if np.isfinite(value)]
    if not values:
        return []
    middle = float(np.median(values))
    text = f"{printable(stream.topic)}: 32FC1 depth of about {middle:.3g}"
    if middle * recorded > _FAR_M and _NEAR_M < middle * 0.001 < _FAR_M:
        return [f"{text} looks like millimetres: give --log.depth-unit-m 0.001"]
    if recorded < 1 and middle * recorded < _NEAR_M < middle < _FAR_M:
        return [f"{text} looks like metres: leave --log.depth-unit-m out"]
    return []


def _aligned(sources: _Sources, choice: Choice, options: LogOptions) -> tuple[bool, str]:
    """Return whether depth is aligned to colour, and why."""
    depth, color = sources.depth, sources.color
    if options.depth_aligned is not None:
        flag = "--log.depth-aligned" if options.depth_aligned else "--log.no-depth-aligned"
        return options.depth_aligned, f"given by {flag}"
    if options.color_from_depth is not None or options.depth_intrinsics is not None:
        return False, "depth's own calibration is given"
    if choice.aligned_by_name:
        return True, _AS_FOLDERS if Path(depth.path).is_dir() else "by the topic's name"
    if color is None or choice.infrared or not sources.same_frame or depth.size != color.size:
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
    """Return whether two images can be of one lens, scaled or cropped."""
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
    """Return a warning if aligned depth has another camera matrix; P counts if rectified."""
    if depth.info is None or depth.matrix is not None:
        return []
    own = []
    for rectified in (False, True):
        with suppress(CalibrationError):
            own.append(find_intrinsics(depth._replace(rectified=rectified)).intrinsics[2:6])
    if not own or any(np.allclose(one, color[2:6], rtol=0, atol=0.5) for one in own):
        return []
    text = "depth counts as aligned but has another camera matrix than colour"
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
        topic=topic,
        info=info,
        size=size,
        rectified=stream.kind is Kind.DISPARITY
        or "rect" in stream.topic.lower().replace("/", "_").split("_"),
        matrix=options.depth_intrinsics if depth else options.color_intrinsics,
        model=options.depth_distortion if depth else options.color_distortion,
        path=contents.path,
        max_pixels=options.max_pixels,
        known=tuple(sorted(contents.calibrations)),
    )


def _info_topic(
    contents: LogContents, stream: ImageStream, depth: bool, override: str | None
) -> str:
    """Return the flag's topic, else that next to the images, else the only one of their frame."""
    known = contents.calibrations
    if override:
        if override not in known:
            flag = "--log.depth-info" if depth else "--log.color-info"
            remedy = f"{flag} can be: {listed(sorted(known)) or 'none'}"
            problem = "no calibration on this topic"
            raise CalibrationError(problem, path=contents.path, topic=override, remedy=remedy)
        return override
    if stream.kind is Kind.RGBD:
        topic = f"{stream.topic} ({'depth' if depth else 'rgb'})"
        return topic if topic in known else ""
    parts = stream.topic.split("/")
    for end in range(len(parts) - 1, max(len(parts) - 3, 0), -1):
        for name in ("camera_info", "info/camera_info"):  # the second is librealsense's
            topic = "/".join([*parts[:end], name])
            if topic in known:
                return topic
    frame = stream.frame_id(depth)
    same = [name for name, item in known.items() if frame and item.frame_id == frame]
    best = max((affinity(name, stream.topic) for name in same), default=0)
    nearest = [name for name in same if affinity(name, stream.topic) == best]
    if stream.kind is Kind.DISPARITY:  # which is of the left image
        nearest = [name for name in nearest if "left" in name.split("/")] or nearest
    return nearest[0] if len(nearest) == 1 else ""


def _changes(
    contents: LogContents, used: Mapping[str, CameraInfoMessage], of_depth: str
) -> list[str]:
    lost = "frames with another calibration than the one used are left out"
    kept = "boxes and pictures of later frames may be off"
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
