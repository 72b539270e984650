"""What ``jaxdet info`` tells about a log; plain data, no arrays of images."""

from typing import NamedTuple

import numpy as np

from jaxdet.io.files import LogFiles
from jaxdet.io.findings import Findings
from jaxdet.io.index import LogIndex
from jaxdet.io.integrity import FileIntegrity
from jaxdet.io.streams import ImageStream
from jaxdet.io.topics import encoding_of, printable

_SLOW_PAIR_S = 0.05


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
    """How colour and depth were paired."""

    tolerance_s: float
    num_paired: int
    num_unpaired_color: int
    num_unpaired_depth: int
    unpaired_depth_stamps_ns: np.ndarray
    """``(U,)`` int64."""
    median_dt_s: float
    """Of ``|colour - depth|`` of the pairs; 0 without pairs."""
    max_dt_s: float


class LogDescription(NamedTuple):
    """All that is known of a log before its images are decoded."""

    name: str
    paths: tuple[str, ...]
    num_frames: int
    duration_s: float
    """From the first to the last colour stamp."""
    topics: tuple[TopicDescription, ...]
    choices: tuple[str, ...]
    """Which topics are used and why."""
    calibration: tuple[str, ...]
    """Each part and where it comes from."""
    extrinsics_source: str
    base_source: str
    pose_source: str
    num_poses: int
    """Frames with a known pose."""
    pairing: PairingDescription
    integrity: tuple[FileIntegrity, ...]
    """One for each file; its ``text`` is a line."""
    warnings: tuple[str, ...]


def describe(
    files: LogFiles, index: LogIndex, found: Findings, tolerance_s: float
) -> LogDescription:
    """The description of a log.

    Args:
        files: Its files.
        index: What is in them.
        found: What is used.
        tolerance_s: The pairing's tolerance [s].
    """
    stamps, T = found.stamps_ns, found.poses.T_world_camera
    pairing = describe_pairing(stamps, found.depth_stamps_ns, found.unpaired_depth_ns, tolerance_s)
    warnings = [*index.warnings, *index.tree.warnings, *found.timeline.warnings]
    warnings += [*found.calibrated.warnings, *found.poses.warnings]
    if pairing.max_dt_s > _SLOW_PAIR_S:
        text = f"a pair is {pairing.max_dt_s * 1000:.1f} ms apart; see --log.pair-tolerance-s"
        warnings.append(text)
    return LogDescription(
        name=files.name,
        paths=tuple(str(path) for path in files.paths),
        num_frames=len(stamps),
        duration_s=float(np.ptp(stamps)) / 1e9 if len(stamps) else 0.0,
        topics=describe_topics(index, found.choice.color, found.choice.depth),
        choices=found.choice.reasons,
        calibration=found.calibrated.origins,
        extrinsics_source=found.calibrated.extrinsics_source,
        base_source=found.base.source,
        pose_source=found.poses.source,
        num_poses=0 if T is None else int(np.isfinite(T[:, 0, 0]).sum()),
        pairing=pairing,
        integrity=tuple(index.integrity),
        warnings=tuple(warnings),
    )


def describe_topics(index: LogIndex, color: str, depth: str) -> tuple[TopicDescription, ...]:
    """The topics by name."""
    found = []
    for name, info in sorted(index.topics.items()):
        span = (info.last_ns - info.first_ns) / 1e9
        stream = index.streams.get(name)
        chosen = [role for role, topic in (("color", color), ("depth", depth)) if topic == name]
        problem = info.problem
        if info.undecodable and not problem:
            problem = f"{info.undecodable} messages can't be decoded"
        found.append(
            TopicDescription(
                topic=printable(name),
                schema=printable(info.channel.schema_name),
                message_encoding=printable(info.channel.message_encoding),
                image_encoding=_image_encoding(stream),
                num_messages=info.count,
                rate_hz=(info.count - 1) / span if info.count > 1 and span > 0 else 0.0,
                chosen_as=" ".join(chosen),
                problem=printable(problem),
            )
        )
    return tuple(found)


def describe_pairing(
    color_ns: np.ndarray, depth_ns: np.ndarray, unpaired_ns: np.ndarray, tolerance_s: float
) -> PairingDescription:
    """Statistics of a pairing.

    Args:
        color_ns: ``(F,)`` int64, colour stamps [ns].
        depth_ns: ``(F,)`` int64, stamp of each colour frame's depth frame, -1 = none [ns].
        unpaired_ns: ``(U,)`` int64, stamps of the depth frames without a colour frame [ns].
        tolerance_s: Greatest difference allowed [s].
    """
    paired = depth_ns >= 0
    apart = np.abs(color_ns[paired] - depth_ns[paired]) / 1e9
    return PairingDescription(
        tolerance_s=tolerance_s,
        num_paired=int(paired.sum()),
        num_unpaired_color=int((~paired).sum()),
        num_unpaired_depth=len(unpaired_ns),
        unpaired_depth_stamps_ns=unpaired_ns,
        median_dt_s=float(np.median(apart)) if len(apart) else 0.0,
        max_dt_s=float(apart.max()) if len(apart) else 0.0,
    )


def _image_encoding(stream: ImageStream | None) -> str:
    return printable(encoding_of(stream, False)) if stream is not None else ""
