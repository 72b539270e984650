"""Pose of the camera on the robot and in the world."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from jaxdet.elementary import matmul
from jaxdet.errors import CalibrationError, TopicError, printable
from jaxdet.io.contents import LogContents, PoseTrack
from jaxdet.io.motion import MotionSamples
from jaxdet.io.namespaces import namespace_of, namespaces_of_camera
from jaxdet.io.options import LogOptions
from jaxdet.io.topics import listed
from jaxdet.io.transforms import TransformTree

_BASES = ("base_footprint", "base_link")
_WORLDS = ("map", "odom")


class Base(NamedTuple):
    """Base frame of the robot, whose z = 0 is the floor."""

    T_base_camera: np.ndarray | None
    """Transform ``(4, 4)`` float64 from depth optical frame to base frame; None if TF lacks it."""
    frame: str | None
    source: str
    """Description for users."""


class PoseSource(NamedTuple):
    """Source of the camera's poses: a world frame, a topic, or none."""

    text: str
    """Description for users."""
    warnings: tuple[str, ...] = ()
    camera: str = ""
    """TF frame of the camera, or of a part that is rigidly connected to the camera."""
    world: str = ""
    """TF frame of the world; empty if the poses are not from TF."""
    topic: str = ""
    """Topic with poses; empty if the poses are not from a topic."""
    parent: str = ""
    """TF frame in which the topic's poses are expressed."""
    T_child_camera: np.ndarray | None = None
    """Transform ``(4, 4)`` float64 from the camera to the child frame of the topic's poses."""
    T_frame_camera: np.ndarray | None = None
    """Transform ``(4, 4)`` float64 from the depth camera to ``camera``; None if they are the same.
    """
    offset_ns: int = 0
    """Offset of the poses' clock relative to depth [ns], positive if the poses' clock is ahead."""

    @property
    def known(self) -> bool:
        """Whether the log has poses."""
        return bool(self.world or self.topic)

    @property
    def world_frame(self) -> str:
        """World frame of the poses; empty if there are no poses."""
        return self.world or self.parent

    def moving(self, tree: TransformTree) -> list[str]:
        """Return the frames or the topic whose samples are needed."""
        return [self.topic] if self.topic else tree.moving(self.world, self.camera)

    def at(
        self, stamps_ns: np.ndarray, tree: TransformTree, tracks: Mapping[str, MotionSamples]
    ) -> np.ndarray | None:
        """Return ``T_world_camera`` at given times, ``(F, 4, 4)``; NaN if unknown.

        The result is None if the log has no poses.

        Args:
            stamps_ns: Query times ``(F,)`` int64, in the clock of the poses [ns].
            tree: Transforms, with samples near these times.
            tracks: Samples of the pose topics.

        Raises:
            CalibrationError: The transforms form a cycle.
        """
        if self.topic:
            assert self.T_child_camera is not None
            T = matmul(tracks[self.topic].at(stamps_ns), self.T_child_camera)
        else:
            T = tree.at(self.world, self.camera, stamps_ns) if self.world else None
        return T if T is None or self.T_frame_camera is None else matmul(T, self.T_frame_camera)


def find_base(contents: LogContents, options: LogOptions, camera_frame: str) -> Base:
    """Find the robot's base frame in TF: set by flag, else base_footprint, else base_link.

    Raises:
        CalibrationError: The frame set by the flag is not connected to the camera, or the
            transforms form a cycle.
    """
    names = [options.base_frame] if options.base_frame else _named(contents, _BASES, camera_frame)
    for name in names:
        T = contents.tree.fixed(name, camera_frame) if camera_frame else None
        if T is not None:
            frame = printable(name)
            return Base(T, name, f"camera over the floor: TF, z = 0 of frame {frame!r}")
    if options.base_frame:
        given = "--log.base-frame", "static transforms", options.base_frame
        raise _unconnected(contents, *given, camera_frame)
    return Base(None, None, "camera over the floor: not in TF")


def pose_sources(
    contents: LogContents,
    options: LogOptions,
    depth_topic: str,
    camera_frame: str,
    base_frame: str | None,
) -> list[PoseSource]:
    """Return the possible sources of the camera's poses by priority; there is at least one.

    The first source with poses for at least half of the frames should be used, else the source with
    the most poses. The last source is the fallback if no other source has poses.

    In order of priority: the topic of ``--log.odom``, moving transforms up to a world frame (the
    frame of ``--log.world-frame``, else map or odom), the robot's only Odometry or PoseInFrame
    topic. A pose topic contains poses of the robot's base; if no static transforms connect the base
    to the camera, there are no poses, but a warning.

    Raises:
        TopicError: ``--log.odom`` is not a topic with poses.
        CalibrationError: The frame of ``--log.world-frame`` is not connected to the camera, or the
            transforms form a cycle.
    """
    if options.odom:
        return [_given_track(contents, options, options.odom, camera_frame, base_frame)]
    world, topics = options.world_frame, _robot_poses(contents, depth_topic)
    if not world:
        names = [name for name in _named(contents, _WORLDS, camera_frame) if name != base_frame]
    elif contents.tree.distance(world, camera_frame) is not None:
        return [_from_tree(world, camera_frame)]
    else:
        names, topics = [], [name for name in topics if contents.poses[name].parent == world]
        if not topics:
            given = "--log.world-frame", "transforms", world
            raise _unconnected(contents, *given, camera_frame)
    last = PoseSource("poses: none in the log")
    if len(topics) == 1:
        last = _from_track(contents, topics[0], camera_frame, base_frame)
    elif topics:
        text = f"several topics have poses ({listed(topics)}); choose one with --log.odom"
        last = PoseSource("poses: none chosen", (text,))
    return [*(_from_tree(name, camera_frame) for name in names), last]


def _from_tree(world: str, camera_frame: str) -> PoseSource:
    """Return the poses in a world frame of TF."""
    return PoseSource(f"poses: TF, frame {printable(world)!r}", camera=camera_frame, world=world)


def _given_track(
    contents: LogContents,
    options: LogOptions,
    topic: str,
    camera_frame: str,
    base_frame: str | None,
) -> PoseSource:
    """Return the poses of the topic set by ``--log.odom``."""
    if topic not in contents.poses:
        remedy = f"set --log.odom to one of: {listed(sorted(contents.poses)) or 'none'}"
        raise TopicError("topic has no poses", path=contents.path, topic=topic, remedy=remedy)
    parent = contents.poses[topic].parent
    if options.world_frame and options.world_frame != parent:
        problem = f"its poses are in frame {parent!r}, not in {options.world_frame!r}"
        remedy = "pass either --log.odom or --log.world-frame"
        raise TopicError(problem, path=contents.path, topic=topic, remedy=remedy)
    return _from_track(contents, topic, camera_frame, base_frame)


def _from_track(
    contents: LogContents, topic: str, camera_frame: str, base_frame: str | None
) -> PoseSource:
    track: PoseTrack = contents.poses[topic]
    child = track.child or base_frame or ""
    T_child_camera = contents.tree.fixed(child, camera_frame) if child and camera_frame else None
    if T_child_camera is None:
        frames = f"{printable(child)!r} and camera {printable(camera_frame)!r}"
        text = f"{printable(topic)} is not used: no static transforms connect its frame {frames}"
        return PoseSource("poses: none usable", (text,))
    text = f"poses: topic {printable(topic)} of frame {printable(child)!r}"
    given = {"topic": topic, "parent": track.parent, "T_child_camera": T_child_camera}
    return PoseSource(text, camera=camera_frame, **given)


def _robot_poses(contents: LogContents, depth_topic: str) -> list[str]:
    """Return the pose topics of the robot that carries a camera."""
    schemas = {name: contents.topics[name].channel.schema_name for name in sorted(contents.poses)}
    topics = [name for name in schemas if schemas[name].endswith(("Odometry", "PoseInFrame"))]
    spaces = {name: namespace_of(name) for name in topics}
    found = namespaces_of_camera(spaces.values(), depth_topic, contents.streams)
    wanted = found.own[:1] if found.has_robot else (*found.own, *found.others)
    return [name for name in topics if spaces[name] in wanted]


def _named(contents: LogContents, names: tuple[str, ...], camera_frame: str) -> list[str]:
    """Return the frames of the camera's robot with these names, in this order.

    Frame names may start with a namespace. If transforms connect several robots, the frame nearest
    to the camera shows the namespace of its robot; frames of other namespaces are not used, except
    for those that contain it.

    Raises:
        CalibrationError: The transforms form a cycle.
    """
    steps = dict[str, int]()
    for frame in sorted(contents.tree.frames):
        if frame.split("/")[-1] in names:
            distance = contents.tree.distance(frame, camera_frame)
            steps |= {} if distance is None else {frame: distance}
    robot = f"/{namespace_of(min(steps, key=steps.__getitem__, default=''))}/"
    own = [
        frame for frame in steps if robot.startswith(f"/{namespace_of(frame)}".rstrip("/") + "/")
    ]
    return sorted(own, key=lambda frame: names.index(frame.split("/")[-1]))


def _unconnected(
    contents: LogContents, flag: str, what: str, frame: str, camera_frame: str
) -> CalibrationError:
    """Return the error for the frame of a flag that has no transforms to the camera."""
    problem = f"no {what} connect {frame!r} and {camera_frame!r}"
    frames = sorted(contents.tree.above(camera_frame)[1:]) if camera_frame else []
    remedy = f"change {flag}" + (f", for instance to one of: {listed(frames)}" if frames else "")
    return CalibrationError(problem, path=contents.path, remedy=remedy)
