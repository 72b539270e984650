"""Where the camera stands on the robot and in the world."""

from typing import NamedTuple

import numpy as np

from jaxdet.errors import CalibrationError, TopicError
from jaxdet.io.index import LogIndex, PoseTrack
from jaxdet.io.options import LogOptions
from jaxdet.io.topics import printable

_BASES = ("base_footprint", "base_link")
_WORLDS = ("map", "odom")


class Base(NamedTuple):
    """The robot's frame whose z = 0 is the floor."""

    T_base_camera: np.ndarray | None
    """``(4, 4)`` float64, colour optical frame to base; None when TF doesn't hold it."""
    frame: str | None
    source: str
    """A sentence."""


class Poses(NamedTuple):
    """The camera's poses over a log."""

    T_world_camera: np.ndarray | None
    """``(F, 4, 4)`` float64, NaN where unknown; None when the log has none."""
    source: str
    """A sentence."""
    warnings: tuple[str, ...]


def find_base(index: LogIndex, options: LogOptions, camera_frame: str, path: str) -> Base:
    """``T_base_camera`` from static transforms: base_footprint, else base_link, or the flag's.

    Raises:
        CalibrationError: The frame that the flag names isn't joined to the camera, or the
            transforms form a cycle.
    """
    names = [options.base_frame] if options.base_frame else _named(index, _BASES)
    for name in names:
        T = index.tree.fixed(name, camera_frame) if camera_frame else None
        if T is not None:
            frame = printable(name)
            return Base(T, name, f"camera over the floor: TF, z = 0 of frame {frame!r}")
    if options.base_frame:
        problem = f"no static transform joins {options.base_frame!r} and {camera_frame!r}"
        raise CalibrationError(problem, path=path, remedy="change --log.base-frame")
    return Base(None, None, "camera over the floor: not in the log's transforms")


def find_poses(
    index: LogIndex,
    options: LogOptions,
    camera_frame: str,
    base_frame: str | None,
    stamps_ns: np.ndarray,
    path: str,
) -> Poses:
    """``T_world_camera`` at each colour stamp, interpolated.

    The topic of ``--log.odom`` goes first, then moving transforms up to the world frame, then
    the log's only Odometry or PoseInFrame topic. A pose topic holds the robot's base, which
    static transforms join to the camera; where they don't, there are no poses and a warning.

    Raises:
        TopicError: ``--log.odom`` names no topic with poses.
        CalibrationError: The transforms form a cycle.
    """
    if options.odom:
        if options.odom not in index.poses:
            names = ", ".join(printable(name) for name in sorted(index.poses)) or "none"
            topic = printable(options.odom)
            remedy = f"--log.odom can be: {names}"
            raise TopicError("no poses on the topic", path=path, topic=topic, remedy=remedy)
        return _from_track(index, options.odom, camera_frame, base_frame, stamps_ns)
    for world in [options.world_frame] if options.world_frame else _named(index, _WORLDS):
        T = index.tree.at(world, camera_frame, stamps_ns) if camera_frame else None
        if T is not None and (world != base_frame and np.isfinite(T).any()):
            return Poses(T, f"poses: TF, frame {printable(world)!r}", ())
    topics = [name for name in sorted(index.poses) if _is_robot_pose(index, name)]
    if len(topics) == 1:
        return _from_track(index, topics[0], camera_frame, base_frame, stamps_ns)
    if topics:
        names = ", ".join(printable(name) for name in topics)
        text = f"several topics hold poses ({names}); choose one with --log.odom"
        return Poses(None, "poses: none chosen", (text,))
    return Poses(None, "poses: none in the log", ())


def _from_track(
    index: LogIndex,
    topic: str,
    camera_frame: str,
    base_frame: str | None,
    stamps_ns: np.ndarray,
) -> Poses:
    track: PoseTrack = index.poses[topic]
    child = track.child or base_frame or ""
    T_child_camera = index.tree.fixed(child, camera_frame) if child and camera_frame else None
    if T_child_camera is None:
        frames = f"{printable(child)!r} and camera {printable(camera_frame)!r}"
        text = f"{printable(topic)} is not used: no static transform joins its frame {frames}"
        return Poses(None, "poses: none that can be used", (text,))
    T = track.samples.at(stamps_ns) @ T_child_camera
    return Poses(T, f"poses: topic {printable(topic)} of frame {printable(child)!r}", ())


def _is_robot_pose(index: LogIndex, topic: str) -> bool:
    schema = index.topics[topic].channel.schema_name
    return schema.endswith(("Odometry", "PoseInFrame"))


def _named(index: LogIndex, names: tuple[str, ...]) -> list[str]:
    """The tree's frames of these names, with any namespace before them, in this order."""
    frames = sorted(index.tree.frames)
    return [frame for name in names for frame in frames if frame.split("/")[-1] == name]
