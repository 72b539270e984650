"""Where the camera stands on the robot and in the world."""

from collections.abc import Callable, Mapping
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
_ENOUGH = 0.5
"""Of a log's poses, for a world frame to go before those after it."""


class Base(NamedTuple):
    """The robot's frame whose z = 0 is the floor."""

    T_base_camera: np.ndarray | None
    """``(4, 4)`` float64, depth optical frame to base; None when TF doesn't hold it."""
    frame: str | None
    source: str
    """A sentence."""


class PoseSource(NamedTuple):
    """Where the camera's poses over a log come from: a world frame, or a topic, or nowhere."""

    text: str
    """A sentence."""
    warnings: tuple[str, ...] = ()
    camera: str = ""
    """TF frame of the camera, or one fixed to it."""
    world: str = ""
    """TF frame; empty: not from TF."""
    topic: str = ""
    """Topic with poses; empty: not from one."""
    parent: str = ""
    """TF frame that the topic's poses are in."""
    T_child_camera: np.ndarray | None = None
    """``(4, 4)`` float64, from that frame to the one that the topic's poses are of."""
    T_frame_camera: np.ndarray | None = None
    """``(4, 4)`` float64, from the depth camera to ``camera``; None: they are the same."""
    offset_ns: int = 0
    """How far the clock of the poses is ahead of depth's [ns]."""

    @property
    def known(self) -> bool:
        """Whether the log has poses."""
        return bool(self.world or self.topic)

    @property
    def world_frame(self) -> str:
        """The frame that poses are in; empty if there are none."""
        return self.world or self.parent

    def moving(self, tree: TransformTree) -> list[str]:
        """Return the frames or the topic whose samples are needed."""
        return [self.topic] if self.topic else tree.moving(self.world, self.camera)

    def at(
        self, stamps_ns: np.ndarray, tree: TransformTree, tracks: Mapping[str, MotionSamples]
    ) -> np.ndarray | None:
        """``T_world_camera`` ``(F, 4, 4)`` at each stamp, NaN where unknown; None without poses.

        Args:
            stamps_ns: ``(F,)`` int64, in the clock of the poses [ns].
            tree: Transforms with the samples about these stamps.
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
    """``T_base_camera`` from static transforms: base_footprint, else base_link, or the flag's.

    Raises:
        CalibrationError: The frame that the flag names isn't joined to the camera, or the
            transforms form a cycle.
    """
    names = [options.base_frame] if options.base_frame else _named(contents, _BASES)
    for name in names:
        T = contents.tree.fixed(name, camera_frame) if camera_frame else None
        if T is not None:
            frame = printable(name)
            return Base(T, name, f"camera over the floor: TF, z = 0 of frame {frame!r}")
    if options.base_frame:
        problem = f"no static transform joins {options.base_frame!r} and {camera_frame!r}"
        raise CalibrationError(problem, path=contents.path, remedy="change --log.base-frame")
    return Base(None, None, "camera over the floor: not in the log's transforms")


def find_poses(
    contents: LogContents,
    options: LogOptions,
    depth_topic: str,
    camera_frame: str,
    base_frame: str | None,
    share_known: Callable[[PoseSource], float],
    on_clock: Callable[[PoseSource], PoseSource] = lambda source: source,
) -> PoseSource:
    """Return the source of the camera's poses.

    The topic of ``--log.odom`` goes first, then moving transforms up to the world frame, then
    the robot's only Odometry or PoseInFrame topic. A frame given by ``--log.world-frame`` is taken
    whatever it is, so the robot's base frame gives robot coordinates. Of the frames map and odom
    the first is taken in which half of the poses are known, else the one in which most are. A pose
    topic holds the robot's base, which static transforms join to the camera; where they don't,
    there are no poses and a warning.

    Args:
        contents: What is in the log.
        options: What the user says.
        depth_topic: Topic of the camera's depth images.
        camera_frame: TF frame of the camera.
        base_frame: TF frame of the robot.
        share_known: Of how many frames a source knows the pose, 0 to 1.
        on_clock: Adds how far the clock of a source is from depth's.

    Raises:
        TopicError: ``--log.odom`` names no topic with poses.
        CalibrationError: The frame that ``--log.world-frame`` names isn't joined to the camera, or
            the transforms form a cycle.
    """
    if options.odom:
        source = _given_track(contents, options, options.odom, camera_frame, base_frame)
        return _on_clock(source, share_known, on_clock)
    if options.world_frame and not (
        camera_frame and contents.tree.joins(options.world_frame, camera_frame)
    ):
        problem = f"no transforms join {options.world_frame!r} and {camera_frame!r}"
        raise CalibrationError(problem, path=contents.path, remedy="change --log.world-frame")
    if options.world_frame:
        text = f"poses: TF, frame {printable(options.world_frame)!r}"
        source = PoseSource(text, camera=camera_frame, world=options.world_frame)
        return _on_clock(source, share_known, on_clock)
    best, most = None, 0.0
    for world in _named(contents, _WORLDS):
        if not camera_frame or world == base_frame or not contents.tree.joins(world, camera_frame):
            continue
        text = f"poses: TF, frame {printable(world)!r}"
        if best:
            text += f", where more are known than in {printable(best.world)!r}"
        source = PoseSource(text, camera=camera_frame, world=world)
        source = _on_clock(source, share_known, on_clock)
        share = share_known(source)
        if share > most:
            best, most = source, share
        if most >= _ENOUGH:
            break
    if best:
        return best
    topics = _robot_poses(contents, depth_topic)
    if len(topics) == 1:
        source = _from_track(contents, topics[0], camera_frame, base_frame)
        return _on_clock(source, share_known, on_clock)
    if topics:
        text = f"several topics hold poses ({listed(topics)}); choose one with --log.odom"
        return PoseSource("poses: none chosen", (text,))
    return PoseSource("poses: none in the log")


def _on_clock(
    source: PoseSource,
    share_known: Callable[[PoseSource], float],
    on_clock: Callable[[PoseSource], PoseSource],
) -> PoseSource:
    """Return the source with the offset of its clock.

    An offset with which fewer poses are known is none: a clock was set while the log was recorded.
    """
    found = on_clock(source) if source.known else source
    measured = found.offset_ns and found.warnings != source.warnings
    return source if measured and share_known(source) > share_known(found) else found


def _given_track(
    contents: LogContents,
    options: LogOptions,
    topic: str,
    camera_frame: str,
    base_frame: str | None,
) -> PoseSource:
    """Return the poses of the topic that ``--log.odom`` names."""
    if topic not in contents.poses:
        remedy = f"--log.odom can be: {listed(sorted(contents.poses)) or 'none'}"
        raise TopicError("no poses on the topic", path=contents.path, topic=topic, remedy=remedy)
    parent = contents.poses[topic].parent
    if options.world_frame and options.world_frame != parent:
        problem = f"its poses are in frame {parent!r}, not in {options.world_frame!r}"
        remedy = "give --log.odom or --log.world-frame, not both"
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
        text = f"{printable(topic)} is not used: no static transform joins its frame {frames}"
        return PoseSource("poses: none that can be used", (text,))
    text = f"poses: topic {printable(topic)} of frame {printable(child)!r}"
    given = {"topic": topic, "parent": track.parent, "T_child_camera": T_child_camera}
    return PoseSource(text, camera=camera_frame, **given)


def _robot_poses(contents: LogContents, depth_topic: str) -> list[str]:
    """Return the topics with poses of the robot that carries a camera."""
    topics = [name for name in sorted(contents.poses) if _is_robot_pose(contents, name)]
    spaces = {name: namespace_of(name) for name in topics}
    found = namespaces_of_camera(spaces.values(), depth_topic, contents.streams)
    wanted = found.own[:1] if found.has_robot else (*found.own, *found.others)
    return [name for name in topics if spaces[name] in wanted]


def _is_robot_pose(contents: LogContents, topic: str) -> bool:
    schema = contents.topics[topic].channel.schema_name
    return schema.endswith(("Odometry", "PoseInFrame"))


def _named(contents: LogContents, names: tuple[str, ...]) -> list[str]:
    """Return the tree's frames of these names in this order, with any namespace before them."""
    frames = sorted(contents.tree.frames)
    return [frame for name in names for frame in frames if frame.split("/")[-1] == name]
