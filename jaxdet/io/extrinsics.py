"""Extrinsics from depth to colour camera: from flags, an extrinsics topic, or TF."""

from typing import NamedTuple

import numpy as np

from jaxdet.elementary import matmul
from jaxdet.errors import TransformError, printable
from jaxdet.io.body_frames import body_frame_text, in_optical_axes
from jaxdet.io.contents import LogContents
from jaxdet.io.intrinsics import CameraSource
from jaxdet.io.motion import difference, inverse, motion_matrix
from jaxdet.io.namespaces import affinity
from jaxdet.io.options import LogOptions
from jaxdet.io.topics import camera_name
from jaxdet.types import Extrinsics

_AGREE_M, _AGREE_RAD = 0.001, 0.002


class FoundExtrinsics(NamedTuple):
    """``T_color_depth``, with its source and warnings about contradictory sources."""

    extrinsics: Extrinsics
    origin: str
    warnings: tuple[str, ...]
    depth_is_body: bool = False
    """Whether the TF frame of depth is a body frame."""


def find_extrinsics(
    contents: LogContents,
    options: LogOptions,
    color: CameraSource,
    depth: CameraSource,
    *,
    one_lens: bool,
    depth_is_body: bool = False,
) -> FoundExtrinsics:
    """Return ``T_color_depth``: from the flag, else equal frames, the extrinsics topic, or TF.

    The result is the identity if both images are in the same TF frame and from the same lens
    (``one_lens``: their camera matrices differ only by scaling or cropping), regardless of any
    topic. The lenses are compared because some drivers use the same frame for all cameras. A
    difference between topic and TF is a warning. Without any source there is an error: the identity
    is not a default.

    Set ``depth_is_body`` if the frame of depth is a body frame, see
    :mod:`jaxdet.io.body_frames`.

    Raises:
        CalibrationError: The log contains no extrinsics, or the transforms form a cycle.
    """
    color_frame, depth_frame = color.frame, options.camera_frame or depth.frame
    topics = color.images, depth.images
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
        problem = f"no extrinsics from depth to colour camera (TF frames {frames})"
        remedy = "pass --log.color-from-depth tx ty tz qx qy qz qw"
        raise TransformError(problem, path=contents.path, topic=topics[1], remedy=remedy)
    if color_frame != depth_frame:
        origin = f"TF, {printable(depth_frame)!r} to {printable(color_frame)!r}"
        return FoundExtrinsics(_extrinsics(tf), origin, turned, is_body)
    if not (one_lens or options.camera_frame):
        problem = f"no extrinsics: both images are in TF frame {color_frame!r}, "
        problem += "but their camera matrices differ"
        remedy = "pass --log.color-from-depth tx ty tz qx qy qz qw (0 0 0 0 0 0 1: identity), or "
        remedy += "--log.depth-aligned if depth has the pixels of the colour images"
        raise TransformError(problem, path=contents.path, topic=topics[1], remedy=remedy)
    return FoundExtrinsics(_extrinsics(tf), f"both images are in frame {color_frame!r}", ())


def _topic(contents: LogContents, topics: tuple[str, str]) -> str:
    """Return the ``depth_to_color`` topic whose name is most similar to that of the depth images.

    Topics of other cameras are ignored.
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
    """Return ``T_color_depth`` from a recording of librealsense; None for other recordings.

    Such a recording has ``STREAM/image/data`` and ``STREAM/tf/N``, the motion from the reference
    stream of group N to the stream. Source: librealsense, ``media/ros/ros_file_format.h``.
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
    if tf is None or not np.isfinite(T).all():  # the check of the calibration reports these
        return ()
    metres, radians = difference(T, tf)
    if metres <= _AGREE_M and radians <= _AGREE_RAD:
        return ()
    text = f"differs from TF by {metres * 1000:.1f} mm and {np.degrees(radians):.2f} degrees"
    return (f"{printable(topic)} {text}; the topic is used",)


def _extrinsics(T: np.ndarray) -> Extrinsics:
    x, y, z = (float(value) for value in T[:3, 3])
    return Extrinsics(tuple(float(value) for value in T[:3, :3].reshape(-1)), (x, y, z))
