"""Description of a log for ``jaxdet info``, as plain data."""

from typing import NamedTuple

import numpy as np

from jaxdet.errors import printable
from jaxdet.io.contents import LogContents
from jaxdet.io.file_index import FileIntegrity
from jaxdet.io.files import LogFiles
from jaxdet.io.findings import Findings
from jaxdet.io.timeline import Notes
from jaxdet.io.windows import IndexedFrames

_SLOW_S = 0.05
"""Time between a frame and its colour image above which the pairing is reported [s]."""
_FEW = 0.1
"""Fraction of frames without a pose above which their number is reported."""


class TopicDescription(NamedTuple):
    """Description of a topic."""

    topic: str
    schema: str
    message_encoding: str
    """Message encoding: cdr, protobuf, json, ..."""
    image_encoding: str
    """Encoding of the images; empty for other topics."""
    num_messages: int
    """Number of messages."""
    rate_hz: float
    """Mean rate by log time [Hz]; 0 for fewer than two messages."""
    chosen_as: str
    """Roles of the topic, separated by spaces: color, depth; empty if it is not used."""
    problem: str
    """Reason why the messages are unusable, or "no messages"; empty if they are usable."""


class PairingDescription(NamedTuple):
    """Time differences between frames and their colour images."""

    tolerance_s: float
    num_frames: int
    num_with_color: int
    """Number of frames with a colour image within the tolerance."""
    median_dt_s: float
    """Median of ``|colour - depth|`` of these frames [s]; 0 if there are none."""
    max_dt_s: float

    @property
    def text(self) -> str:
        """Summary in one line."""
        count, missing = self.num_frames, self.num_frames - self.num_with_color
        if not self.num_with_color:
            return f"no colour within {self.tolerance_s:g} s of the {count} frames"
        found = f"colour missing for {missing} of {count} frames"
        found = found if missing else f"colour for all {count} frames"
        median, most = self.median_dt_s * 1000, self.max_dt_s * 1000
        return f"{found}, up to {most:.1f} ms apart (median {median:.1f} ms)"


class LogDescription(NamedTuple):
    """Description of a log before its images are decoded."""

    name: str
    paths: tuple[str, ...]
    is_folder: bool
    """Whether the log is a folder of images."""
    camera: str
    """Name of the camera."""
    cameras: tuple[str, ...]
    """Descriptions of the cameras with their topics, or the reason why they are unusable; empty if
    there is only one."""
    cameras_left_out: tuple[str, ...]
    """Names of the unusable cameras; the warnings contain the reasons."""
    num_frames: int
    """Number of depth images in the log."""
    part: str
    """Description of the selected frames; empty if all frames are selected."""
    duration_s: float
    """Time from the first to the last depth image [s], by header timestamps."""
    topics: tuple[TopicDescription, ...]
    choices: tuple[str, ...]
    """Topics used, with the reasons."""
    calibration: tuple[str, ...]
    """Parts of the calibration, with their sources."""
    extrinsics_source: str
    base_source: str
    pose_source: str
    num_poses: int | None
    """Number of frames with a known pose; None if the log was opened by its index."""
    pairing: PairingDescription | None
    """Pairing of colour with depth; None if the log was opened by its index."""
    integrity: tuple[FileIntegrity, ...]
    """Integrity of each file, with a summary ``text`` in one line."""
    warnings: tuple[str, ...]
    notes: tuple[str, ...]
    """Remarks that need no action."""


def describe(
    files: LogFiles, contents: LogContents, found: Findings, numbers: range
) -> LogDescription:
    """Describe a log with the selected frame ``numbers``."""
    warnings = [*contents.warnings, *found.warnings]
    warnings += [*found.calibrated.warnings, *found.frames.source.warnings, *found.cameras.warnings]
    count, color = found.frames.num_frames, found.choice.color
    duration_ns = found.frames.stamp_ns(count - 1) - found.frames.stamp_ns(0)
    return LogDescription(
        name=files.name,
        paths=tuple(str(path) for path in files.paths),
        is_folder=files.paths[0].is_dir(),
        camera=found.choice.camera,
        cameras=found.cameras.lines,
        cameras_left_out=tuple(map(printable, found.cameras.left_out)),
        num_frames=count,
        part=_part_text(numbers, found.frames),
        duration_s=duration_ns / 1e9,
        topics=describe_topics(contents, color if found.frames.color else "", found.choice.depth),
        choices=found.choice.reasons,
        calibration=found.calibrated.origins,
        extrinsics_source=found.calibrated.extrinsics_source,
        base_source=found.base.source,
        pose_source=found.frames.source.text,
        num_poses=None,
        pairing=None,
        integrity=tuple(contents.integrity),
        warnings=tuple(warnings),
        notes=(*contents.notes, *found.calibrated.notes, *found.notes),
    )


def complete(
    about: LogDescription, notes: Notes, tolerance_s: float, *, has_poses: bool
) -> LogDescription:
    """Add the results of reading all frames to the description from the opening of a log.

    ``tolerance_s`` is the tolerance of the pairing [s], and ``has_poses`` whether the log has poses
    at any time.
    """
    pairing = _pairing(notes, tolerance_s)
    warnings, counts = [], notes.depth
    topic = next((item.topic for item in about.topics if "depth" in item.chosen_as.split()), "")
    texts = (
        (counts.backward, "timestamps run backward; frames are ordered by timestamp"),
        (counts.double, "timestamps occur twice"),
        (counts.undecodable, "messages can't be decoded"),
    )
    warnings += [f"{topic}: {count} {text}" for count, text in texts if count]
    more = []
    has_color = any("color" in item.chosen_as.split() for item in about.topics)
    if has_color and (pairing.num_with_color < pairing.num_frames or pairing.max_dt_s > _SLOW_S):
        more.append(f"{pairing.text}; see --log.pair-tolerance-s")
    frames = pairing.num_frames
    if has_poses and not notes.poses:
        warnings.append(
            "no frame has a pose: the timestamps of the poses are from another time or clock"
        )
    elif has_poses and (lacking := frames - notes.poses) > _FEW * frames:
        text = f"{lacking} of {frames} frames have no pose; see --log.world-frame, --log.odom and "
        warnings.append(f"{text}--log.pose-offset-s")
    return about._replace(
        num_poses=notes.poses,
        pairing=pairing,
        warnings=(*about.warnings, *warnings),
        notes=(*about.notes, *more),
    )


def with_bad_color(about: LogDescription, notes: Notes) -> LogDescription:
    """Add a note on colour images that can't be decoded."""
    if not notes.bad_color:
        return about
    text = f"{notes.bad_color} colour images can't be decoded: {notes.why_bad_color}"
    return about._replace(notes=(*about.notes, text))


def describe_topics(
    contents: LogContents, color: str = "", depth: str = ""
) -> tuple[TopicDescription, ...]:
    """Describe the topics in order of their names; ``color`` and ``depth`` name the used topics."""
    found = []
    for name, info in sorted(contents.topics.items()):
        span = (info.last_ns - info.first_ns) / 1e9
        stream = contents.streams.get(name)
        chosen = [role for role, topic in (("color", color), ("depth", depth)) if topic == name]
        found.append(
            TopicDescription(
                topic=printable(name),
                schema=printable(info.channel.schema_name),
                message_encoding=printable(info.channel.message_encoding),
                image_encoding=printable(stream.encoding(False)) if stream is not None else "",
                num_messages=info.count,
                rate_hz=(info.count - 1) / span if info.count > 1 and span > 0 else 0.0,
                chosen_as=" ".join(chosen),
                problem=printable(info.trouble),
            )
        )
    return tuple(found)


def _part_text(numbers: range, frames: IndexedFrames) -> str:
    """Return numbers and times of the selected frames as text; empty if all are selected."""
    if len(numbers) == frames.num_frames:
        return ""
    which = f"{len(numbers)} of {frames.num_frames} frames, {numbers[0]} to {numbers[-1]}"
    if numbers.step > 1:
        which += f", multiples of {numbers.step}"
    start, *ends = (frames.stamp_ns(number) for number in (0, numbers[0], numbers[-1]))
    first_s, last_s = ((end - start) / 1e9 for end in ends)
    return f"{which}, {first_s:.2f} to {last_s:.2f} s"


def _pairing(notes: Notes, tolerance_s: float) -> PairingDescription:
    apart = notes.apart_ns / 1e9
    return PairingDescription(
        tolerance_s=tolerance_s,
        num_frames=len(apart) + notes.without_color,
        num_with_color=len(apart),
        median_dt_s=float(np.median(apart)) if len(apart) else 0.0,
        max_dt_s=float(apart.max()) if len(apart) else 0.0,
    )
