"""All that is found in a log before an image is decoded."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np

from jaxdet.elementary import matmul
from jaxdet.errors import CalibrationError, JaxdetError, RescanError, TransformError
from jaxdet.io.calibration import Calibrated, calibrate
from jaxdet.io.cameras import Cameras, find_cameras
from jaxdet.io.clocks import color_offset, pose_offset
from jaxdet.io.contents import LogContents
from jaxdet.io.decode_messages import MessageDecoder
from jaxdet.io.indexed import IndexedLog
from jaxdet.io.messages import Kind, kind_of
from jaxdet.io.options import LogOptions
from jaxdet.io.poses import Base, PoseSource, find_base, find_poses
from jaxdet.io.repeats import may_repeat
from jaxdet.io.streams import NUM_PROBES
from jaxdet.io.timeline import ScannedFrames, log_time_warnings, order_frames
from jaxdet.io.topics import Choice
from jaxdet.io.validity import CalibrationWindows, other_calibration
from jaxdet.io.windows import IndexedFrames

_POSE_SAMPLE = 8
"""Frames looked at to see how many have a pose."""


class Findings(NamedTuple):
    """Topics, calibration, floor, poses and frames."""

    cameras: Cameras
    choice: Choice
    calibrated: Calibrated
    base: Base
    poses: PoseSource
    frames: ScannedFrames | IndexedFrames
    depth: Sequence[MessageDecoder]
    """Of the depth topic; a message has the one of its ``decoder``."""
    color: Sequence[MessageDecoder]
    """Of the colour topic, which may be the same; empty where no colour is used."""
    warnings: tuple[str, ...]
    """About the transforms and the frames."""
    notes: tuple[str, ...] = ()
    """About the frames."""


def find_scanned(contents: LogContents, options: LogOptions, *, is_body: bool = False) -> Findings:
    """What a log holds that was read as a whole.

    Args:
        contents: What is in it.
        options: What the user says.
        is_body: Whether the depth images show that their frame is a body frame.

    Raises:
        CamerasError: There are several cameras.
        TopicError: No or several topics can be depth, or there is no such camera.
        CalibrationError: A part of the calibration is missing, unknown or contradictory.
    """
    cameras = find_cameras(contents, options)
    choice = cameras.chosen(options, contents.path)
    contents = contents.of_camera(choice.depth)
    calibrated = _calibrate(contents, choice, options, is_body)
    depth = contents.streams[choice.depth]
    color = contents.streams[choice.color] if calibrated.has_color else None
    frames = order_frames(depth, color, options.pair_tolerance_s)
    used = choice.color if color else ""
    of_color = color_offset(contents, options, choice.depth, used, _last_delay(frames))
    if of_color.ns:
        frames = order_frames(depth, color, options.pair_tolerance_s, of_color.ns)
    stamps, tracks = frames.about_ns(), contents.tracks

    def share_known(source: PoseSource) -> float:
        T = source.at(stamps + source.offset_ns, contents.tree, tracks)
        known = np.zeros(1) if T is None else np.isfinite(T[:, 0, 0])
        # Where the sample has none, any in the sample of another source go before all.
        return float(known[_sample(len(known))].mean() or known.mean() / 100)

    base, poses = _find(contents, choice, calibrated, options, share_known)
    other = np.zeros(len(stamps), bool)
    for topic, used in calibrated.used_for_depth.items():
        if depth.kind is not Kind.RGBD:  # whose images are read with their calibrations
            changes = contents.calibrations[topic].changes
            other |= other_calibration(stamps, changes, used, frames.by_log_time)
    return Findings(
        cameras,
        choice,
        calibrated,
        base,
        poses,
        frames.completed(poses.at(stamps + poses.offset_ns, contents.tree, tracks), other),
        depth.decoders,
        [] if color is None else color.decoders,
        (*contents.tree.warnings, *frames.warnings),
        (of_color.text,) if of_color.text else (),
    )


def find_indexed(log: IndexedLog, options: LogOptions, *, is_body: bool = False) -> Findings:
    """What a log holds that was opened by its index.

    Args:
        log: What its indexes tell.
        options: What the user says.
        is_body: As for :func:`find_scanned`.

    Raises:
        CamerasError: There are several cameras.
        TopicError: No or several topics can be depth, or there is no such camera.
        CalibrationError: A part of the calibration is missing, unknown or contradictory.
        RescanError: The first messages are such that the index isn't enough.
        DamageError: The file contradicts its index.
    """
    contents, path = log.contents, log.contents.path
    cameras = find_cameras(contents, options)
    for error in cameras.incomplete.values():
        sampled = isinstance(error, TransformError) and not log.motions.whole
        if sampled or _is_of_first(log, error):
            raise RescanError(f"not found in a sample: {error.problem}", path=path)
    choice = cameras.chosen(options, contents.path)
    contents = contents.of_camera(choice.depth)
    try:
        calibrated = _calibrate(contents, choice, options, is_body)
    except CalibrationError as error:
        _check_sampled(log, error)
        raise
    if calibrated.color_error is not None:
        _check_sampled(log, calibrated.color_error)
    topics = (choice.depth, choice.color) if calibrated.has_color else (choice.depth,)
    _check_stamps(log, topics)
    depth, color = log.streams[topics[0]], log.streams[topics[-1]] if topics[1:] else None
    if color is not None and color is not depth:
        color.whole = False
    motions, tolerance = log.motions.of_tree(contents.tree), options.pair_tolerance_s
    frames = IndexedFrames(depth, color, motions, PoseSource(""), tolerance, path)
    of_color = color_offset(contents, options, choice.depth, topics[-1], _last_delay(frames))
    frames = frames._replace(color_offset_ns=of_color.ns)

    def share_known(source: PoseSource) -> float:
        sample, looked = _sample(len(depth)), frames._replace(source=source, color=None)
        share = float(np.mean([looked.window(i, i + 1).notes.poses for i in sample.tolist()]))
        if not share and len(sample) < len(depth):
            raise RescanError("no sampled frame has a pose in the world frame", path=path)
        return share

    try:
        base, poses = _find(contents, choice, calibrated, options, share_known)
    except CalibrationError as error:
        _check_sampled(log, error)
        raise
    frames_used = {calibrated.tf_frame, calibrated.color_frame, base.frame or "", poses.world}
    frames_used.add(contents.streams[choice.depth].frame_id(True))
    if not log.motions.whole and contents.tree.sampled_once() & {
        above for frame in frames_used for above in contents.tree.above(frame)
    }:
        raise RescanError("a transform is too rare for a sample", path=path)
    calibrations = _calibration_windows(log, calibrated)
    return Findings(
        cameras,
        choice,
        calibrated,
        base,
        poses,
        frames._replace(source=poses, calibrations=calibrations),
        depth.decoders,
        () if color is None else color.decoders,
        (
            *contents.tree.warnings,
            *(
                text
                for topic in dict.fromkeys(topics)
                for text in log_time_warnings(topic, log.streams[topic].backward)
            ),
        ),
        (of_color.text,) if of_color.text else (),
    )


def _last_delay(frames: ScannedFrames | IndexedFrames) -> int:
    """Return stamp less log time of the last frame [ns]; 0 without one."""
    last = frames.num_frames - 1
    return frames.stamp_ns(last) - frames.log_ns(last) if last >= 0 else 0


def _check_stamps(log: IndexedLog, topics: Sequence[str]) -> None:
    """Make sure that the images of some topics can be told apart and ordered by their stamps.

    Raises:
        RescanError: The first stamps are zero, or images may occur twice.
    """
    for topic in topics:
        stream, path = log.contents.streams[topic], log.contents.path
        if not stream.column("stamp").any():
            raise RescanError("the first header stamps are zero", path=path, topic=topic)
        if may_repeat(stream, log.streams[topic].messages.log_ns):
            raise RescanError("images may occur twice", path=path, topic=topic)


def _calibration_windows(log: IndexedLog, calibrated: Calibrated) -> CalibrationWindows:
    used = calibrated.used
    infos = [log.calibrations[topic] for topic in sorted(used) if topic in log.calibrations]
    return CalibrationWindows(infos, used, log.store, log.contents.path)


def _calibrate(
    contents: LogContents, choice: Choice, options: LogOptions, is_body: bool
) -> Calibrated:
    with _naming_tree(contents):
        return calibrate(contents, choice, options, is_body=is_body)


def _find(
    contents: LogContents,
    choice: Choice,
    calibrated: Calibrated,
    options: LogOptions,
    share_known: Callable[[PoseSource], float],
) -> tuple[Base, PoseSource]:
    """Floor and poses of the depth camera; of the colour camera's frame where TF has that alone."""
    frame, T_frame_camera = calibrated.tf_frame, calibrated.T_frame_camera
    motion, frames = calibrated.calibration.color_from_depth, contents.tree.frames
    if motion is not None and frame not in frames and calibrated.color_frame in frames:
        frame = calibrated.color_frame
        T_frame_camera = motion.T if T_frame_camera is None else matmul(T_frame_camera, motion.T)

    def on_clock(source: PoseSource) -> PoseSource:
        moving = source.moving(contents.tree) if source.known else []
        topics = [(name, "") for name in moving] if source.topic else []
        topics = topics or [(contents.tree.topic(name), name) for name in moving]
        found = pose_offset(contents, options, choice.depth, choice.color, topics)
        warnings = (*source.warnings, *filter(None, [found.text]))
        return source._replace(offset_ns=found.ns, warnings=warnings)

    with _naming_tree(contents):
        base = find_base(contents, options, frame)
        about = choice.depth, frame, base.frame
        poses = find_poses(contents, options, *about, share_known, on_clock)
    if T_frame_camera is not None and base.T_base_camera is not None:
        base = base._replace(T_base_camera=matmul(base.T_base_camera, T_frame_camera))
    if calibrated.camera_frame != frame and calibrated.camera_frame not in frames:
        poses = poses._replace(text=poses.text.replace("poses: TF", "poses: turned, TF"))
    return base, poses._replace(T_frame_camera=T_frame_camera)


@contextmanager
def _naming_tree(contents: LogContents) -> Iterator[None]:
    """Names file and topic in errors of the tree of transforms, which knows neither."""
    try:
        yield
    except TransformError as error:
        if error.path:
            raise
        topics = contents.topics.items()
        kinds = ((name, kind_of(about.channel.schema_name)) for name, about in topics)
        topic = ", ".join(sorted(name for name, kind in kinds if kind is Kind.TRANSFORM))
        problem, remedy = error.problem, error.remedy
        raise TransformError(problem, path=contents.path, topic=topic, remedy=remedy) from error


def _check_sampled(log: IndexedLog, error: CalibrationError) -> None:
    """Makes sure that messages which were not looked at can't change an error.

    Raises:
        RescanError: They can.
    """
    if not log.motions.whole or _is_of_first(log, error):
        problem = f"not found in a sample: {error.problem}"
        raise RescanError(problem, path=log.contents.path) from error


def _is_of_first(log: IndexedLog, error: JaxdetError) -> bool:
    """Whether an error is about a topic with more calibrations than were looked at."""
    known = log.calibrations.get(error.topic)
    return known is not None and known.num_messages > NUM_PROBES


def _sample(count: int) -> np.ndarray:
    """The frames whose poses say which world frame is taken, the same however a log is opened."""
    return np.unique(np.linspace(0, count - 1, _POSE_SAMPLE).astype(np.int64))
