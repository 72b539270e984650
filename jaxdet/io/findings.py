"""Topics, calibration, poses and frames of a log, determined before images are decoded."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from jaxdet.elementary import matmul
from jaxdet.errors import JaxdetError, RescanError, TransformError, printable
from jaxdet.io.calibration import Calibrated, calibrate
from jaxdet.io.cameras import Cameras, find_cameras
from jaxdet.io.clocks import Offset, color_offset, pose_offset
from jaxdet.io.contents import LogContents
from jaxdet.io.indexed import IndexedLog, may_repeat
from jaxdet.io.options import LogOptions
from jaxdet.io.poses import Base, PoseSource, find_base, pose_sources
from jaxdet.io.streams import NUM_PROBES
from jaxdet.io.topics import Choice
from jaxdet.io.validity import CalibrationWindows
from jaxdet.io.windows import IndexedFrames

_POSE_SAMPLE = 8
"""Number of frames sampled to estimate how many have a pose."""
_ENOUGH = 0.5
"""Fraction of frames with a pose from which on a source is used without trying the next one."""


class Findings(NamedTuple):
    """Topics, calibration, base frame, poses and frames of a log."""

    cameras: Cameras
    choice: Choice
    calibrated: Calibrated
    base: Base
    frames: IndexedFrames
    warnings: tuple[str, ...]
    """Warnings about the transforms and the frames."""
    notes: tuple[str, ...] = ()
    """Notes about the frames."""


def find(log: IndexedLog, options: LogOptions, *, is_body: bool = False) -> Findings:
    """Determine the topics, calibration, poses and frames of a log.

    Set ``is_body`` if the depth images show that their frame is a body frame.

    Raises:
        CamerasError: There are several cameras.
        TopicError: No topic or several can be depth, or the camera does not exist.
        CalibrationError: A part of the calibration is missing, unknown or contradictory.
        RescanError: The first messages show that all messages must be read.
        DamageError: The file contradicts its index.
    """
    contents = log.contents
    cameras = find_cameras(contents, options)
    for error in cameras.incomplete.values():
        if isinstance(error, TransformError) or _is_of_first(log, error):
            check_sampled(log, error)
    choice = cameras.chosen(options, contents.path)
    contents = contents.of_camera(choice.depth)
    calibrated = calibrate(contents, choice, options, is_body=is_body)
    if calibrated.color_error is not None:
        check_sampled(log, calibrated.color_error)
    frames, warnings = _frames(log, contents, choice, calibrated, options)
    of_color = Offset()
    if frames.color:
        last = frames.num_frames - 1
        delay_ns = frames.stamp_ns(last) - frames.log_ns(last)
        of_color = color_offset(contents, options, choice, delay_ns)
        frames = frames._replace(color_offset_ns=of_color.ns)
    base, poses = _find_poses(log, contents, choice, calibrated, options, frames)
    frames_used = {calibrated.tf_frame, calibrated.color_frame, base.frame or "", poses.world}
    frames_used.add(contents.streams[choice.depth].frame_id(True))
    if not log.motions.whole and contents.tree.sampled_once() & {
        above for frame in frames_used for above in contents.tree.above(frame)
    }:
        raise RescanError("a transform is too rare to be found in a sample", path=contents.path)
    return Findings(
        cameras,
        choice,
        calibrated,
        base,
        frames._replace(source=poses),
        (*contents.tree.warnings, *warnings),
        tuple(filter(None, (of_color.text, choice.note))),
    )


def _frames(
    log: IndexedLog,
    contents: LogContents,
    choice: Choice,
    calibrated: Calibrated,
    options: LogOptions,
) -> tuple[IndexedFrames, list[str]]:
    """Return the frames of the chosen topics, without poses, and warnings about them.

    If all timestamps of a stream are zero, log times replace them, also for the pairing with
    colour.

    Raises:
        RescanError: The first messages show that all messages must be read.
    """
    warnings, zero = list[str](), set[str]()
    topics = dict.fromkeys((choice.depth, *((choice.color,) if calibrated.has_color else ())))
    streams = {topic: log.streams[topic] for topic in topics}
    if log.is_complete:
        zero = {topic for topic, stream in streams.items() if not stream.stamp.any()}
    else:
        _check_stamps(log, topics)
    for topic, stream in streams.items():
        if topic in zero:
            text = "all header timestamps are zero; log times are used"
            warnings.append(f"{printable(topic)}: {text}")
        if stream.backward:
            text = f"{stream.backward} log times run backward; images are ordered by timestamp"
            warnings.append(f"{printable(topic)}: {text}")
        if log.is_complete:
            of_color = topic != choice.depth and bool(zero)
            streams[topic] = stream.complete(by_log_time=topic in zero or of_color)
    depth, color = streams[choice.depth], streams[choice.color] if calibrated.has_color else None
    if color is not None and color is not depth:
        color.whole = False
    frames = IndexedFrames(
        depth,
        color,
        log.motions.of_tree(contents.tree),
        PoseSource(""),
        options.pair_tolerance_s,
        contents.path,
        _calibrations(log, choice, calibrated, by_log_time=choice.depth in zero),
        by_log_time=bool(zero),
    )
    return frames, warnings


def _check_stamps(log: IndexedLog, topics: Iterable[str]) -> None:
    """Check that the images of some topics can be distinguished and ordered by timestamps.

    Raises:
        RescanError: The first timestamps are zero, or images may occur twice.
    """
    for topic in topics:
        stream, path = log.contents.streams[topic], log.contents.path
        if not any(image.stamp_ns for image in stream.first):
            raise RescanError("the first header timestamps are zero", path=path, topic=topic)
        if may_repeat(stream, log.streams[topic].messages.log_ns):
            raise RescanError("images may occur twice", path=path, topic=topic)


def _calibrations(
    log: IndexedLog, choice: Choice, calibrated: Calibrated, *, by_log_time: bool
) -> CalibrationWindows:
    used, topic, changes = calibrated.used, calibrated.of_depth, None
    infos = [log.calibrations[name] for name in sorted(used) if name in log.calibrations]
    if log.is_complete:
        # RGBD messages contain their own calibration.
        is_separate = topic and not log.streams[choice.depth].is_rgbd
        changes = log.contents.calibrations[topic].changes if is_separate else ()
    path = log.contents.path
    return CalibrationWindows(infos, used, log.store, path, topic, changes, by_log_time=by_log_time)


def _find_poses(
    log: IndexedLog,
    contents: LogContents,
    choice: Choice,
    calibrated: Calibrated,
    options: LogOptions,
    frames: IndexedFrames,
) -> tuple[Base, PoseSource]:
    """Return the base frame and the poses of the depth camera.

    If TF lacks the depth camera's frame, the colour camera's frame and the extrinsics are used.
    """
    frame, T_frame_camera = calibrated.tf_frame, calibrated.T_frame_camera
    motion, known = calibrated.calibration.color_from_depth, contents.tree.frames
    if motion is not None and frame not in known and calibrated.color_frame in known:
        frame = calibrated.color_frame
        T_frame_camera = motion.T if T_frame_camera is None else matmul(T_frame_camera, motion.T)

    def share_known(source: PoseSource) -> float:
        return _share_known(frames._replace(source=source, color=None), log.is_complete)

    def on_clock(source: PoseSource) -> PoseSource:
        if not source.known:
            return source
        topics = [(source.topic, "")] if source.topic else []
        moving = source.moving(contents.tree)
        topics = topics or [(contents.tree.topic(name), name) for name in moving]
        offset = pose_offset(contents, options, choice, topics)
        warnings = (*source.warnings, *filter(None, [offset.text]))
        found = source._replace(offset_ns=offset.ns, warnings=warnings)
        # If a clock was adjusted during the recording, fewer frames have a pose with the offset.
        is_measured = offset.ns and offset.text
        return source if is_measured and share_known(source) > share_known(found) else found

    base = find_base(contents, options, frame)
    *sources, last = pose_sources(contents, options, choice.depth, frame, base.frame)
    poses, most = None, 0.0
    for source in map(on_clock, sources):
        share = share_known(source)
        if share > most:
            more = f", which has more poses than {printable(poses.world)!r}" if poses else ""
            poses, most = source._replace(text=source.text + more), share
        if most >= _ENOUGH:
            break
    poses = poses or on_clock(last)
    if T_frame_camera is not None and base.T_base_camera is not None:
        base = base._replace(T_base_camera=matmul(base.T_base_camera, T_frame_camera))
    if calibrated.camera_frame not in (frame, *known):
        poses = poses._replace(text=poses.text.replace("poses: TF", "poses: turned, TF"))
    return base, poses._replace(T_frame_camera=T_frame_camera)


def _share_known(frames: IndexedFrames, is_complete: bool) -> float:
    """Return the fraction of sampled frames whose pose is known, 0 to 1.

    If no sampled frame has a pose, the fraction of all frames is returned, divided by 100, so that
    any source with poses in its sample is preferred.

    Raises:
        RescanError: No sampled frame has a pose, and not all messages were read.
    """
    count = frames.num_frames
    sample = np.unique(np.linspace(0, count - 1, _POSE_SAMPLE).astype(np.int64)).tolist()
    share = float(np.mean([frames.window(i, i + 1).notes.poses for i in sample]))
    if share or len(sample) == count:
        return share
    if not is_complete:
        raise RescanError("no sampled frame has a pose in the world frame", path=frames.path)
    return frames.window(0, count).notes.poses / count / 100


def check_sampled(log: IndexedLog, error: JaxdetError) -> None:
    """Check that an error would remain if all messages were read.

    Raises:
        RescanError: The error may be due to unread messages.
    """
    if not log.is_complete and (not log.motions.whole or _is_of_first(log, error)):
        problem = f"not found in a sample of messages: {error.problem}"
        raise RescanError(problem, path=log.contents.path) from error


def _is_of_first(log: IndexedLog, error: JaxdetError) -> bool:
    """Return whether the topic of an error has further calibrations that were not read."""
    known = log.calibrations.get(error.topic)
    return known is not None and known.num_messages > NUM_PROBES
