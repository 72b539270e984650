"""All that is found in a log before an image is decoded."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from jaxdet.errors import CalibrationError, JaxdetError, RescanError, TransformError
from jaxdet.io.calibration import Calibrated, calibrate
from jaxdet.io.cameras import Cameras, find_cameras
from jaxdet.io.contents import LogContents
from jaxdet.io.decode_messages import MessageDecoder
from jaxdet.io.indexed import IndexedLog
from jaxdet.io.messages import Kind, kind_of
from jaxdet.io.options import LogOptions
from jaxdet.io.poses import Base, PoseSource, find_base, find_poses
from jaxdet.io.streams import NUM_PROBES
from jaxdet.io.timeline import ScannedFrames, log_time_warnings, order_and_pair
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
    color: Sequence[MessageDecoder]
    """Of the colour topic; a message has the one of its ``decoder``."""
    depth: Sequence[MessageDecoder]
    """Of the depth topic, which may be the same."""
    warnings: tuple[str, ...]
    """About the frames."""


def find_scanned(contents: LogContents, options: LogOptions) -> Findings:
    """What a log holds that was read as a whole.

    Raises:
        CamerasError: There are several cameras.
        TopicError: No or several topics can be colour or depth, or there is no such camera.
        CalibrationError: A part of the calibration is missing, unknown or contradictory.
    """
    cameras = find_cameras(contents, options)
    choice = cameras.chosen(options, contents.path)
    color, depth = contents.streams[choice.color], contents.streams[choice.depth]
    frames = order_and_pair(color, depth, options.pair_tolerance_s)
    stamps, tracks = frames.about_ns(), contents.tracks

    def share_known(source: PoseSource) -> float:
        T = source.at(stamps, contents.tree, tracks)
        known = np.zeros(1) if T is None else np.isfinite(T[:, 0, 0])
        # Where the sample has none, any in the sample of another source go before all.
        return float(known[_sample(len(known))].mean() or known.mean() / 100)

    calibrated, base, poses = _find(contents, choice, options, share_known)
    other = np.zeros(len(stamps), bool)
    for topic, used in calibrated.used.items():
        if color.kind is not Kind.RGBD:  # whose images are read with their calibrations
            changes = contents.calibrations[topic].changes
            other |= other_calibration(stamps, changes, used, frames.by_log_time)
    return Findings(
        cameras,
        choice,
        calibrated,
        base,
        poses,
        frames.completed(poses.at(stamps, contents.tree, tracks), other),
        color.decoders,
        depth.decoders,
        frames.warnings,
    )


def find_indexed(log: IndexedLog, options: LogOptions) -> Findings:
    """What a log holds that was opened by its index.

    Raises:
        CamerasError: There are several cameras.
        TopicError: No or several topics can be colour or depth, or there is no such camera.
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
    color, depth = log.streams[choice.color], log.streams[choice.depth]
    for topic in (choice.color, choice.depth):
        if not contents.streams[topic].column("stamp").any():
            raise RescanError("the first header stamps are zero", path=path, topic=topic)
    tolerance = options.pair_tolerance_s
    frames = IndexedFrames(color, depth, log.motions, PoseSource(""), tolerance, path)

    def share_known(source: PoseSource) -> float:
        sample, with_poses = _sample(len(color)), frames._replace(source=source)
        share = float(np.mean([with_poses.window(i, i + 1).notes.poses for i in sample.tolist()]))
        if not share and len(sample) < len(color):
            raise RescanError("no sampled frame has a pose in the world frame", path=path)
        return share

    try:
        calibrated, base, poses = _find(contents, choice, options, share_known)
    except CalibrationError as error:
        if log.motions.whole and not _is_of_first(log, error):
            raise
        raise RescanError(f"not found in a sample: {error.problem}", path=path) from error
    frames_used = {calibrated.color_frame, contents.streams[choice.depth].frame_id(True)}
    frames_used |= {base.frame or "", poses.world}
    if not log.motions.whole and contents.tree.sampled_once() & {
        above for frame in frames_used for above in contents.tree.above(frame)
    }:
        raise RescanError("a transform is too rare for a sample", path=path)
    used = calibrated.used
    infos = [log.calibrations[topic] for topic in sorted(used) if topic in log.calibrations]
    calibrations = CalibrationWindows(infos, used, log.store, path)
    return Findings(
        cameras,
        choice,
        calibrated,
        base,
        poses,
        frames._replace(source=poses, calibrations=calibrations),
        color.decoders,
        depth.decoders,
        tuple(
            text
            for stream in dict.fromkeys((color, depth))
            for text in log_time_warnings(stream.topic, stream.backward)
        ),
    )


def _find(
    contents: LogContents,
    choice: Choice,
    options: LogOptions,
    share_known: Callable[[PoseSource], float],
) -> tuple[Calibrated, Base, PoseSource]:
    try:
        calibrated = calibrate(contents, choice, options)
        frame = calibrated.color_frame
        base = find_base(contents, options, frame)
        return calibrated, base, find_poses(contents, options, frame, base.frame, share_known)
    except TransformError as error:
        if error.path:
            raise
        # Of the tree, which knows no file.
        topics = contents.topics.items()
        kinds = ((name, kind_of(about.channel.schema_name)) for name, about in topics)
        topic = ", ".join(sorted(name for name, kind in kinds if kind is Kind.TRANSFORM))
        problem, remedy = error.problem, error.remedy
        raise TransformError(problem, path=contents.path, topic=topic, remedy=remedy) from error


def _is_of_first(log: IndexedLog, error: JaxdetError) -> bool:
    """Whether an error is about a topic with more calibrations than were looked at."""
    known = log.calibrations.get(error.topic)
    return known is not None and known.num_messages > NUM_PROBES


def _sample(count: int) -> np.ndarray:
    """The frames whose poses say which world frame is taken, the same however a log is opened."""
    return np.unique(np.linspace(0, count - 1, _POSE_SAMPLE).astype(np.int64))
