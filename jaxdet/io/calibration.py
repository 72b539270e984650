"""The calibration of the chosen topics, each part with where it comes from."""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxdet.checks import check_calibration, check_depth_unit
from jaxdet.errors import CalibrationError, printable
from jaxdet.io.contents import LogContents
from jaxdet.io.extrinsics import find_extrinsics
from jaxdet.io.image_folder import LISTED_DEPTH
from jaxdet.io.intrinsics import CameraSource, find_intrinsics
from jaxdet.io.messages import CameraInfoMessage, Kind
from jaxdet.io.options import LogOptions
from jaxdet.io.streams import ImageSize, ImageStream
from jaxdet.io.topics import Choice, affinity, listed
from jaxdet.types import Calibration, Intrinsics

DEPTH_UNIT_M = 0.001
"""Metres in one depth unit, where nothing else is said."""
_ASSUMED = "the default"
"""Where that depth unit comes from."""
_AS_FOLDERS = "as in TUM's and Open3D's folders"
_ONE_LENS = 0.01
"""How much camera matrices of one lens may differ, in widths and heights of their images."""


class Calibrated(NamedTuple):
    """A log's calibration and how it was found."""

    calibration: Calibration
    color_frame: str
    """TF frame of the colour camera."""
    depth_size: ImageSize
    """Of the depth images."""
    origins: tuple[str, ...]
    """Sentences."""
    extrinsics_source: str
    used: dict[str, CameraInfoMessage]
    """The calibrations used, by topic."""
    warnings: tuple[str, ...]


def calibrate(contents: LogContents, choice: Choice, options: LogOptions) -> Calibrated:
    """The calibration for the chosen topics.

    Raises:
        CalibrationError: A part is missing, unknown or contradicts another; the text names the
            flag that supplies it.
    """
    color_stream, depth_stream = contents.streams[choice.color], contents.streams[choice.depth]
    image_frame, depth_frame = color_stream.frame_id(False), depth_stream.frame_id(True)
    color_frame = options.camera_frame or image_frame
    color_source = _source(contents, color_stream, False, options)
    color = find_intrinsics(color_source)
    depth_source = _source(contents, depth_stream, True, options)
    unit, unit_source = _depth_unit(contents, options, choice.depth)
    origins = [_line("colour", color.intrinsics, color.origin)]
    warnings = [*color.warnings, *_unit_doubts(unit_source, contents.path)]
    same_frame = bool(color_frame) and image_frame == depth_frame
    aligned, why = _aligned(color.intrinsics, depth_source, choice, same_frame, options)
    if aligned:
        size = ImageSize(color.intrinsics.width, color.intrinsics.height)
        warnings += _aligned_doubts(depth_source, color.intrinsics, choice.depth)
        if why == _AS_FOLDERS and color_source.matrix is not None:  # no camera as Open3D's
            text = f"depth is taken to be aligned to colour, {why}; else give "
            warnings.append(f"{text}--log.depth-intrinsics and --log.color-from-depth")
        calibration = Calibration(color.intrinsics, None, None, unit)
        extrinsics_source = f"not needed: depth is aligned to colour ({why})"
        sources = [color_source]
    else:
        sources = [color_source, depth_source]
        depth = find_intrinsics(depth_source)
        topics = choice.color, choice.depth
        one_lens = _one_lens(color.intrinsics, depth.intrinsics)
        frames = color_frame, depth_frame
        found = find_extrinsics(contents, options, topics, *frames, one_lens=one_lens)
        origins.append(_line("depth", depth.intrinsics, depth.origin))
        warnings += [*depth.warnings, *found.warnings]
        calibration = Calibration(color.intrinsics, depth.intrinsics, found.extrinsics, unit)
        extrinsics_source = found.origin
        size = ImageSize(depth.intrinsics.width, depth.intrinsics.height)
    try:
        check_calibration(calibration)
    except CalibrationError as error:
        raise CalibrationError(error.problem, path=contents.path, remedy=error.remedy) from error
    origins.append(f"depth unit: {unit:g} m, {unit_source}")
    used = {item.topic: item.info for item in sources if item.info and item.matrix is None}
    warnings += _changes(contents, used)
    return Calibrated(
        calibration, color_frame, size, tuple(origins), extrinsics_source, used, tuple(warnings)
    )


def _depth_unit(contents: LogContents, options: LogOptions, depth_topic: str) -> tuple[float, str]:
    """Metres in a depth unit, and where that comes from."""
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
    """A line where nothing tells the depth unit of what looks like TUM's benchmark."""
    if source != _ASSUMED or not Path(path, LISTED_DEPTH).is_file():
        return []
    return [
        f"the depth unit is not told, and taken to be {DEPTH_UNIT_M:g} m: for TUM's benchmark give "
        "--log.depth-unit-m 0.0002"
    ]


def _aligned(
    color: Intrinsics,
    depth: CameraSource,
    choice: Choice,
    same_frame: bool,
    options: LogOptions,
) -> tuple[bool, str]:
    if options.depth_aligned is not None:
        flag = "--log.depth-aligned" if options.depth_aligned else "--log.no-depth-aligned"
        return options.depth_aligned, f"given by {flag}"
    if options.color_from_depth is not None or options.depth_intrinsics is not None:
        return False, "depth's own calibration is given"
    if choice.aligned_by_name:
        return True, _AS_FOLDERS if Path(depth.path).is_dir() else "by the topic's name"
    if not same_frame or depth.size != (color.width, color.height):
        return False, ""
    if depth.info is None:
        return True, "same frame and size as colour"
    try:
        own = find_intrinsics(depth).intrinsics
    except CalibrationError:
        return False, ""
    same = np.allclose(own[2:6], color[2:6], rtol=0, atol=1e-3)
    return bool(same), "same frame, size and camera matrix as colour"


def _one_lens(color: Intrinsics, depth: Intrinsics) -> bool:
    """Whether two images can be of one lens, perhaps at different sizes."""
    values = [
        (one.fx / one.width, one.fy / one.height, one.cx / one.width, one.cy / one.height)
        for one in (color, depth)
    ]
    return np.allclose(*values, rtol=0, atol=_ONE_LENS)


def _aligned_doubts(depth: CameraSource, color: Intrinsics, topic: str) -> list[str]:
    if depth.size is not None and depth.size != (color.width, color.height):
        problem = f"aligned depth is {depth.size.width}x{depth.size.height} but colour is "
        problem += f"{color.width}x{color.height}"
        remedy = "say --log.no-depth-aligned or choose another --log.depth"
        raise CalibrationError(problem, path=depth.path, topic=topic, remedy=remedy)
    if depth.info is None or len(depth.info.K) != 9:
        return []
    K = depth.info.K
    own = (K[0], K[4], K[2], K[5])
    if np.allclose(own, color[2:6], rtol=0, atol=0.5):
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
        rectified="rect" in stream.topic.lower().replace("/", "_").split("_"),
        matrix=options.depth_intrinsics if depth else options.color_intrinsics,
        model=options.depth_distortion if depth else options.color_distortion,
        path=contents.path,
        max_pixels=options.max_pixels,
        known=tuple(sorted(contents.calibrations)),
    )


def _info_topic(
    contents: LogContents, stream: ImageStream, depth: bool, override: str | None
) -> str:
    """The flag's topic, else the one beside the images, else the only one of their frame."""
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
    return nearest[0] if len(nearest) == 1 else ""


def _changes(contents: LogContents, used: Mapping[str, CameraInfoMessage]) -> list[str]:
    return [
        f"{printable(name)} changes: frames with another calibration than the one used are left out"
        for name in sorted(used)
        if len(contents.calibrations[name].changes) > 1
    ]


def _line(name: str, value: Intrinsics, origin: str) -> str:
    matrix = f"fx {value.fx:.6g} fy {value.fy:.6g} cx {value.cx:.6g} cy {value.cy:.6g}"
    lens = value.distortion.value
    if value.coefficients:
        lens += " " + " ".join(f"{item:.6g}" for item in value.coefficients)
    return f"{name}: {value.width}x{value.height}, {matrix}, distortion {lens}; from {origin}"
