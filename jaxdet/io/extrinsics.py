"""Where the depth camera stands to the colour camera: flags, extrinsics topic, or TF."""

from typing import NamedTuple

import numpy as np

from jaxdet.elementary import matmul
from jaxdet.errors import TransformError, printable
from jaxdet.io.body_frames import body_frame_text, in_optical_axes
from jaxdet.io.contents import LogContents
from jaxdet.io.motion import difference, inverse, motion_matrix
from jaxdet.io.namespaces import affinity
from jaxdet.io.options import LogOptions
from jaxdet.io.topics import camera_name
from jaxdet.types import Extrinsics

_AGREE_M, _AGREE_RAD = 0.001, 0.002


class FoundExtrinsics(NamedTuple):
    """``T_color_depth``, where it comes from, and what contradicts it."""

    extrinsics: Extrinsics
    origin: str
    warnings: tuple[str, ...]
    depth_is_body: bool = False
    """Whether depth's frame lacks the rotation to optical axes."""


def find_extrinsics(
    contents: LogContents,
    options: LogOptions,
    topics: tuple[str, str],
    color_frame: str,
    depth_frame: str,
    *,
    one_lens: bool,
    depth_is_body: bool = False,
) -> FoundExtrinsics:
    """``T_color_depth`` from the flag, else equal frames, the extrinsics topic, or TF.

    Two images of one lens in one and the same frame have none between them, whatever their sizes
    and whatever a topic says of the cameras; drivers that give every camera the same frame are
    known by the lenses. A difference between topic and TF is a
    warning; never is a missing motion taken for none.

    Args:
        contents: The log's.
        options: What the user says.
        topics: Those of the colour and of the depth images.
        color_frame: Of the colour images; empty if unknown.
        depth_frame: Of the depth images.
        one_lens: The camera matrices are the same but for the size of the images.
        depth_is_body: Depth's frame is a body frame, see :mod:`jaxdet.io.body_frames`.

    Raises:
        CalibrationError: Nothing in the log tells it, or the transforms form a cycle.
    """
    given = options.color_from_depth
    if given is not None:
        T = motion_matrix(np.array(given[:3]), np.array(given[3:]))
        return FoundExtrinsics(_extrinsics(T), "--log.color-from-depth", ())
    if color_frame and color_frame == depth_frame and one_lens and not options.camera_frame:
        origin = f"none: both images are in frame {printable(color_frame)!r}"
        return FoundExtrinsics(_extrinsics(np.eye(4)), origin, ())
    streams = _between_streams(contents, *topics)
    if streams is not None:
        return FoundExtrinsics(_extrinsics(streams), "librealsense's topics of both streams", ())
    topic = _topic(contents, topics)
    tf = contents.tree.fixed(color_frame, depth_frame) if color_frame and depth_frame else None
    is_body, turned = depth_is_body, ()
    if tf is not None and color_frame != depth_frame:
        tf, is_body, color_is_body = in_optical_axes(tf, depth_is_body)
        bodies = [depth_frame] * (is_body and not depth_is_body) + [color_frame] * color_is_body
        turned = tuple(body_frame_text(name) for name in bodies)
    if topic:
        T = contents.extrinsics[topic]
        warnings = _contradiction(T, tf, topic) if color_frame != depth_frame else ()
        origin = f"topic {printable(topic)}"
        return FoundExtrinsics(_extrinsics(T), origin, (*warnings, *turned), is_body)
    if tf is None:
        frames = f"{printable(depth_frame)!r} to {printable(color_frame)!r}"
        problem = f"no transform from depth to colour (frames {frames})"
        remedy = "give --log.color-from-depth tx ty tz qx qy qz qw"
        raise TransformError(problem, path=contents.path, topic=topics[1], remedy=remedy)
    if color_frame != depth_frame:
        origin = f"TF, {printable(depth_frame)!r} to {printable(color_frame)!r}"
        return FoundExtrinsics(_extrinsics(tf), origin, turned, is_body)
    if not (one_lens or options.camera_frame):
        problem = f"no transform from depth to colour: both images are in frame {color_frame!r}, "
        problem += "but their camera matrices differ"
        remedy = "give --log.color-from-depth tx ty tz qx qy qz qw (0 0 0 0 0 0 1: none), or "
        remedy += "--log.depth-aligned where depth lies on the colour camera's pixels"
        raise TransformError(problem, path=contents.path, topic=topics[1], remedy=remedy)
    return FoundExtrinsics(_extrinsics(tf), f"both images are in frame {color_frame!r}", ())


def _topic(contents: LogContents, topics: tuple[str, str]) -> str:
    """Return the ``depth_to_color`` topic that shares most of its name with the depth images'.

    Those of the log's other cameras are left out.
    """
    others = {camera_name(name) for name in contents.streams} - {
        camera_name(name) for name in topics
    }
    names = [
        name
        for name in contents.extrinsics
        if "depth_to_color" in name.lower() and camera_name(name) not in others
    ]
    return max(sorted(names), key=lambda name: affinity(name, topics[1]), default="")


def _between_streams(
    contents: LogContents, color_topic: str, depth_topic: str
) -> np.ndarray | None:
    """``T_color_depth`` of a recording of librealsense; None if it is none.

    It has ``STREAM/image/data`` beside ``STREAM/tf/N``, the motion from the reference stream of
    group N to the stream. Source: librealsense, ``media/ros/ros_file_format.h``.
    """
    color, depth = (
        topic.removesuffix("image/data") + "tf/" for topic in (color_topic, depth_topic)
    )
    for name in sorted(contents.extrinsics):
        other = depth + name.removeprefix(color)
        if name.startswith(color) and other in contents.extrinsics:
            return matmul(contents.extrinsics[name], inverse(contents.extrinsics[other]))
    return None


def _contradiction(T: np.ndarray, tf: np.ndarray | None, topic: str) -> tuple[str, ...]:
    if tf is None or not np.isfinite(T).all():  # which is an error of its own
        return ()
    metres, radians = difference(T, tf)
    if metres <= _AGREE_M and radians <= _AGREE_RAD:
        return ()
    text = f"differs from TF by {metres * 1000:.1f} mm and {np.degrees(radians):.2f} degrees"
    return (f"{printable(topic)} {text}; the topic is used",)


def _extrinsics(T: np.ndarray) -> Extrinsics:
    x, y, z = (float(value) for value in T[:3, 3])
    return Extrinsics(tuple(float(value) for value in T[:3, :3].reshape(-1)), (x, y, z))
