"""Topics, calibration, poses and frames of a log, determined before images are decoded."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxdet.elementary import matmul
from jaxdet.errors import JaxdetError, RescanError, TransformError, printable
from jaxdet.io.calibration import Calibrated, calibrate
from jaxdet.io.cameras import Cameras, find_cameras
from jaxdet.io.clocks import Clock, find_offset, read_clock
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
    frames, clocks, warnings = _frames(log, contents, choice, calibrated, options)
    given = options.color_offset_s, "--log.color-offset-s"
    of_color = find_offset(*given, clocks[:1], clocks[1:])
    frames = frames._replace(color_offset_ns=of_color.ns)
    warnings.append("" if of_color.ns else of_color.text)
    notes = of_color.text if of_color.ns else "", choice.note
    base, frames = _find_poses(log, contents, choice, calibrated, options, frames, clocks)
    poses = frames.source
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
        frames,
        (*contents.tree.warnings, *filter(None, warnings)),
        tuple(filter(None, notes)),
    )


def _frames(
    log: IndexedLog,
    contents: LogContents,
    choice: Choice,
    calibrated: Calibrated,
    options: LogOptions,
) -> tuple[IndexedFrames, list[Clock], list[str]]:
    """Return the frames of the chosen topics, without poses, their clocks, and warnings about them.

    The first clock is that of depth, the last that of colour if the log has colour. Timestamps from
    before a clock was adjusted are moved, see :func:`jaxdet.io.clocks.read_clock`. If all
    timestamps of a stream are zero, log times replace them, also for the pairing with colour.

    Raises:
        RescanError: The first messages show that all messages must be read.
    """
    warnings, zero, clocks = list[str](), set[str](), list[Clock]()
    topics = dict.fromkeys((choice.depth, *((choice.color,) if calibrated.has_color else ())))
    streams = {topic: log.streams[topic] for topic in topics}
    if log.is_complete:
        zero = {topic for topic, stream in streams.items() if not stream.stamp.any()}
    for topic, stream in streams.items():
        if topic in zero:
            text = "all header timestamps are zero; log times are used"
            warnings.append(f"{printable(topic)}: {text}")
        if stream.backward:
            text = f"{stream.backward} log times run backward; images are ordered by timestamp"
            warnings.append(f"{printable(topic)}: {text}")
        clock = _clock(log, topic, clocks[0].shifts_ns if clocks else ())
        clocks.append(clock)
        if not log.is_complete:
            _check_stamps(log, clock)
        elif topic in zero or (zero and clocks[1:]):
            streams[topic] = stream.complete(stream.messages.log_ns)
        else:
            warnings.append(clock.text)
            ranks = np.argsort(stream.in_file_order())
            streams[topic] = stream.complete(clock.stamps_ns[ranks])
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
    return frames, clocks, warnings


def _clock(log: IndexedLog, topic: str, shifts_ns: Sequence[int]) -> Clock:
    """Return the clock of an image topic, by all its images or, if not all were read, the first."""
    stream = log.streams[topic]
    if log.is_complete:
        rows = stream.in_file_order()
        stamps, times = stream.stamp[rows], stream.messages.log_ns[rows]
    else:
        first = [(image.stamp_ns, image.log_ns) for image in log.contents.streams[topic].first]
        stamps, times = np.array(first, np.int64).reshape(-1, 2).T
    return read_clock(topic, stamps, times, NUM_PROBES, shifts_ns)


def _check_stamps(log: IndexedLog, clock: Clock) -> None:
    """Check that the images of a topic can be distinguished and ordered by timestamps.

    Raises:
        RescanError: The first timestamps are zero, images may occur twice, or a clock was adjusted.
    """
    topic, path = clock.topic, log.contents.path
    if not clock.stamps_ns.any():
        raise RescanError("the first header timestamps are zero", path=path, topic=topic)
    if may_repeat(log.contents.streams[topic], log.streams[topic].messages.log_ns):
        raise RescanError("images may occur twice", path=path, topic=topic)
    if clock.shifts_ns:
        raise RescanError("the first header timestamps are of two clocks", path=path, topic=topic)
    log.streams[topic].check_clock()


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
    clocks: Sequence[Clock],
) -> tuple[Base, IndexedFrames]:
    """Return the base frame, and the frames with the poses of the depth camera.

    If TF lacks the depth camera's frame, the colour camera's frame and the extrinsics are used.
    """
    frame, T_frame_camera = calibrated.tf_frame, calibrated.T_frame_camera
    motion, known = calibrated.calibration.color_from_depth, contents.tree.frames
    if motion is not None and frame not in known and calibrated.color_frame in known:
        frame = calibrated.color_frame
        T_frame_camera = motion.T if T_frame_camera is None else matmul(T_frame_camera, motion.T)

    base = find_base(contents, options, frame)
    *sources, last = pose_sources(contents, options, choice.depth, frame, base.frame)
    found, most = None, 0.0
    for source in sources:
        one = _with_poses(frames, source, clocks, options, log.is_complete)
        share = _share_known(one, log.is_complete)
        if share > most:
            text = one.source.text
            if found:
                text += f", which has more poses than {printable(found.source.world)!r}"
            found, most = one._replace(source=one.source._replace(text=text)), share
        if most >= _ENOUGH:
            break
    found = found or _with_poses(frames, last, clocks, options, log.is_complete)
    poses = found.source
    if T_frame_camera is not None and base.T_base_camera is not None:
        base = base._replace(T_base_camera=matmul(base.T_base_camera, T_frame_camera))
    if calibrated.camera_frame not in (frame, *known):
        poses = poses._replace(text=poses.text.replace("poses: TF", "poses: turned, TF"))
    return base, found._replace(source=poses._replace(T_frame_camera=T_frame_camera))


def _with_poses(
    frames: IndexedFrames,
    source: PoseSource,
    clocks: Sequence[Clock],
    options: LogOptions,
    is_complete: bool,
) -> IndexedFrames:
    """Return the frames with poses from a source; ``clocks`` are those of depth and colour.

    Raises:
        RescanError: The first messages show that all messages must be read.
    """
    motions, own = frames.motions.on_clock(source, clocks[0].shifts_ns)
    texts = {clock.topic: clock.text for clock in own if clock.text}
    source = source._replace(warnings=(*source.warnings, *texts.values()))
    without = frames._replace(source=source, motions=motions)
    offset = find_offset(options.pose_offset_s, "--log.pose-offset-s", clocks, own)
    warnings = (*source.warnings, *filter(None, [offset.text]))
    found = without._replace(source=source._replace(offset_ns=offset.ns, warnings=warnings))
    # If the poses were only recorded by another clock, fewer frames have one with the offset.
    is_measured = offset.ns and offset.text
    if is_measured and _share_known(without, is_complete) > _share_known(found, is_complete):
        return without
    return found


def _share_known(frames: IndexedFrames, is_complete: bool) -> float:
    """Return the fraction of sampled frames whose pose is known, 0 to 1.

    If no sampled frame has a pose, the fraction of all frames is returned, divided by 100, so that
    any source with poses in its sample is preferred.

    Raises:
        RescanError: No sampled frame has a pose, and not all messages were read.
    """
    frames, count = frames._replace(color=None), frames.num_frames
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
