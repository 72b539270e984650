"""What ``jaxdet info`` shows of a log; plain data, no arrays of images."""

from typing import NamedTuple

import numpy as np

from jaxdet.errors import printable
from jaxdet.io.contents import LogContents
from jaxdet.io.file_index import FileIntegrity
from jaxdet.io.files import LogFiles
from jaxdet.io.findings import Findings
from jaxdet.io.notes import Notes
from jaxdet.io.windows import IndexedFrames

_SLOW_S = 0.05
"""How far the nearest colour image is at most before it is noted."""
_FEW = 0.1
"""Of a log's frames, to have no pose."""
_TWO_CLOCKS_S = 0.5
"""Recorded so much farther apart than their stamps are, images may have stamps of two clocks."""


class TopicDescription(NamedTuple):
    """One topic."""

    topic: str
    schema: str
    message_encoding: str
    """cdr, protobuf, json, ..."""
    image_encoding: str
    """Of image topics, else empty."""
    num_messages: int
    """Messages."""
    rate_hz: float
    """Mean rate by log time; 0 for fewer than two messages."""
    chosen_as: str
    """color, depth, or empty."""
    problem: str
    """Why its messages can't be used; empty when nothing is wrong."""


class PairingDescription(NamedTuple):
    """How far colour images are from the frames that they are shown with."""

    tolerance_s: float
    num_frames: int
    num_with_color: int
    """Frames with a colour image within the tolerance."""
    median_dt_s: float
    """Of ``|colour - depth|`` of these; 0 without any."""
    max_dt_s: float

    @property
    def text(self) -> str:
        """A line for people."""
        count, missing = self.num_frames, self.num_frames - self.num_with_color
        if not self.num_with_color:
            return f"no colour within {self.tolerance_s:g} s of the {count} frames"
        found = f"colour missing for {missing} of {count} frames"
        found = found if missing else f"colour for all {count} frames"
        median, most = self.median_dt_s * 1000, self.max_dt_s * 1000
        return f"{found}, the nearest up to {most:.1f} ms away (median {median:.1f} ms)"


class LogDescription(NamedTuple):
    """What a log holds, before its images are decoded."""

    name: str
    paths: tuple[str, ...]
    is_folder: bool
    """Whether it is a folder of images."""
    camera: str
    """The camera's name."""
    cameras: tuple[str, ...]
    """Of a log with several: each with its topics, or why it is not used."""
    cameras_left_out: tuple[str, ...]
    """Those that can't be used, by their names; why is among the warnings."""
    num_frames: int
    """Depth images of the log."""
    part: str
    """Which of them are used; empty: all."""
    duration_s: float
    """From the first to the last depth stamp."""
    topics: tuple[TopicDescription, ...]
    choices: tuple[str, ...]
    """Which topics are used and why."""
    calibration: tuple[str, ...]
    """Each part and where it comes from."""
    extrinsics_source: str
    base_source: str
    pose_source: str
    num_poses: int | None
    """Frames with a known pose; None if the log was opened by its index."""
    pairing: PairingDescription | None
    """Of colour to depth; None if the log was opened by its index."""
    integrity: tuple[FileIntegrity, ...]
    """One for each file; its ``text`` is a line."""
    warnings: tuple[str, ...]
    notes: tuple[str, ...]
    """What is worth knowing and as it should be."""


def describe(
    files: LogFiles, contents: LogContents, found: Findings, numbers: range, first_ns: int
) -> LogDescription:
    """Return the description of a log.

    Args:
        files: Its files.
        contents: What is in them.
        found: What is used.
        numbers: The frames that are used.
        first_ns: From when its seconds count [ns].
    """
    warnings = [*contents.warnings, *found.warnings]
    warnings += [*found.calibrated.warnings, *found.poses.warnings, *found.cameras.warnings]
    count, color = found.frames.num_frames, found.choice.color
    return LogDescription(
        name=files.name,
        paths=tuple(str(path) for path in files.paths),
        is_folder=files.paths[0].is_dir(),
        camera=found.choice.camera,
        cameras=found.cameras.lines,
        cameras_left_out=tuple(map(printable, found.cameras.incomplete)),
        num_frames=count,
        part=_part_text(numbers, found.frames, first_ns),
        duration_s=(found.frames.stamp_ns(count - 1) - first_ns) / 1e9,
        topics=describe_topics(contents, color if found.color else "", found.choice.depth),
        choices=found.choice.reasons,
        calibration=found.calibrated.origins,
        extrinsics_source=found.calibrated.extrinsics_source,
        base_source=found.base.source,
        pose_source=found.poses.text,
        num_poses=None,
        pairing=None,
        integrity=tuple(contents.integrity),
        warnings=tuple(warnings),
        notes=(*contents.notes, *found.calibrated.notes, *found.notes),
    )


def complete(
    about: LogDescription, notes: Notes, tolerance_s: float, *, has_poses: bool
) -> LogDescription:
    """Return a description with what all frames show.

    Args:
        about: What was known at opening.
        notes: Of all frames.
        tolerance_s: The pairing's [s].
        has_poses: Whether the log has poses, of whatever time.
    """
    pairing = _pairing(notes, tolerance_s)
    warnings, counts = [], notes.depth
    topic = next((item.topic for item in about.topics if "depth" in item.chosen_as.split()), "")
    texts = (
        (counts.backward, "stamps run backward; frames are ordered by stamp"),
        (counts.double, "stamps occur twice"),
        (counts.zero, "header stamps are zero"),
        (counts.undecodable, "messages can't be decoded"),
    )
    warnings += [f"{topic}: {count} {text}" for count, text in texts if count]
    if (seconds := _recorded_apart(notes)) > _TWO_CLOCKS_S:
        warnings.append(
            f"colour and depth images of one stamp were recorded {seconds:.1f} s apart (median): "
            "where they have stamps of two clocks, pictures show colour of another time"
        )
    more = []
    has_color = any("color" in item.chosen_as.split() for item in about.topics)
    if has_color and (pairing.num_with_color < pairing.num_frames or pairing.max_dt_s > _SLOW_S):
        more.append(f"{pairing.text}; see --log.pair-tolerance-s")
    frames = pairing.num_frames
    if has_poses and not notes.poses:
        warnings.append("no frame has a pose: the poses' stamps are of another time or clock")
    elif has_poses and (lacking := frames - notes.poses) > _FEW * frames:
        text = f"{lacking} of {frames} frames have no pose: see --log.world-frame and --log.odom"
        warnings.append(text)
    return about._replace(
        num_poses=notes.poses,
        pairing=pairing,
        warnings=(*about.warnings, *warnings),
        notes=(*about.notes, *more),
    )


def with_bad_color(about: LogDescription, notes: Notes) -> LogDescription:
    """Return a description with a note on colour images that can't be decoded."""
    if not notes.bad_color:
        return about
    text = f"{notes.bad_color} colour images can't be decoded: {notes.why_bad_color}"
    return about._replace(notes=(*about.notes, text))


def describe_topics(
    contents: LogContents, color: str = "", depth: str = ""
) -> tuple[TopicDescription, ...]:
    """Return the topics by name; ``color`` and ``depth`` are those that are used."""
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


def _part_text(numbers: range, frames: IndexedFrames, first_ns: int) -> str:
    """Numbers and times of the frames that are used; empty if these are all."""
    if len(numbers) == frames.num_frames:
        return ""
    which = f"{len(numbers)} of {frames.num_frames} frames, {numbers[0]} to {numbers[-1]}"
    if numbers.step > 1:
        which += f", multiples of {numbers.step}"
    ends = (frames.stamp_ns(number) for number in (numbers[0], numbers[-1]))
    times = [max(0, ns - first_ns) / 1e9 for ns in ends]
    return f"{which}, {times[0]:.2f} to {times[1]:.2f} s"


def _pairing(notes: Notes, tolerance_s: float) -> PairingDescription:
    apart = notes.apart_ns / 1e9
    return PairingDescription(
        tolerance_s=tolerance_s,
        num_frames=len(apart) + notes.without_color,
        num_with_color=len(apart),
        median_dt_s=float(np.median(apart)) if len(apart) else 0.0,
        max_dt_s=float(apart.max()) if len(apart) else 0.0,
    )


def _recorded_apart(notes: Notes) -> float:
    """Return how much farther colour is from depth by log time than by stamp, the median [s]."""
    more = (notes.recorded_apart_ns - notes.apart_ns) / 1e9
    return float(np.median(more)) if len(more) else 0.0
