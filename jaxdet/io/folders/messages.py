"""Encoding of the contents of an image folder as ROS 2 messages (CDR)."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from jaxdet.io.compressed import ROTATED, with_confidence
from jaxdet.io.folders.recording import Pose, Recording
from jaxdet.io.writer_cdr import camera_info, encode_cdr, header, xyz

CONFIDENCE = "confidence"
"""Subfolder with a confidence PNG per depth image, with the same name."""
TOPICS = {
    "/camera/color/image": "sensor_msgs/CompressedImage",
    "/camera/depth_registered/image": "sensor_msgs/CompressedImage",
    "/camera/color/camera_info": "sensor_msgs/CameraInfo",
    "/camera/depth_registered/option/Depth Units/value": "std_msgs/Float32",
    "/tf": "tf2_msgs/TFMessage",
    "/camera/depth_registered/camera_info": "sensor_msgs/CameraInfo",
}
"""Types by topic; the channel of a topic is its number in this order."""
_TYPES = tuple(TOPICS.values())
_COLOR, _DEPTH, _INFO, _UNIT, _TF, _DEPTH_INFO = range(len(TOPICS))
_FRAME = "camera_color_optical_frame"


class FolderMessage(NamedTuple):
    """A message, consisting of bytes followed by the contents of files."""

    log_ns: int
    channel: int
    head: bytes
    files: tuple[tuple[Path, int], ...] = ()
    """Path and size of an image and, for depth, optionally of its confidences; the size of a
    missing file is 0."""

    @property
    def size(self) -> int:
        """Total size [byte]."""
        return len(self.head) + sum(size for _, size in self.files)

    @property
    def path(self) -> Path | None:
        """Path of the image; None for other messages."""
        return self.files[0][0] if self.files else None


def encode_recording(folder: Path, recording: Recording) -> list[FolderMessage]:
    """Return the messages of a folder in order of time.

    Raises:
        OSError: A file can't be read.
    """
    found = [_image(_COLOR, "png", image.stamp_ns, image.path) for image in recording.color]
    has_confidence = (folder / CONFIDENCE).is_dir()
    for stamp_ns, path in recording.depth:
        masks = [folder / CONFIDENCE / path.name] if has_confidence else []
        form = "16UC1; png" + (with_confidence(_size(path)) if masks else "")
        form += ROTATED if recording.is_rotated else ""
        found.append(_image(_DEPTH, form, stamp_ns, path, *masks))
    first_ns = min((message.log_ns for message in found), default=0)
    found += _cameras(recording, first_ns)
    found += [_transform(pose) for pose in recording.poses]
    return sorted(found, key=lambda message: message[:2])


def _image(channel: int, form: str, stamp_ns: int, *paths: Path) -> FolderMessage:
    """Return the message with the contents of files as data, and with ``form`` as ``format``."""
    files = tuple((path, _size(path)) for path in paths)
    about = {"header": header(stamp_ns, _FRAME), "format": form, "data": b""}
    head = encode_cdr(_TYPES[channel], about)
    head = head[:-4] + sum(size for _, size in files).to_bytes(4, "little")
    return FolderMessage(stamp_ns, channel, head, files)


def _size(path: Path) -> int:
    return path.stat().st_size if path.is_file() else 0


def _cameras(recording: Recording, log_ns: int) -> Iterator[FolderMessage]:
    """Yield the messages of calibration and depth unit."""
    color, depth, unit_m = recording.cameras
    for channel, camera in ((_INFO, color), (_DEPTH_INFO, depth)):
        if camera is not None:
            yield _message(log_ns, channel, camera_info(log_ns, _FRAME, camera))
    if unit_m is not None:
        yield _message(log_ns, _UNIT, {"data": unit_m})


def _transform(pose: Pose) -> FolderMessage:
    rotation = dict(zip("xyzw", pose.quaternion, strict=True))
    transform = {
        "header": header(pose.stamp_ns, "map"),
        "child_frame_id": _FRAME,
        "transform": {"translation": xyz(pose.translation), "rotation": rotation},
    }
    return _message(pose.stamp_ns, _TF, {"transforms": [transform]})


def _message(log_ns: int, channel: int, content: Mapping[str, Any]) -> FolderMessage:
    return FolderMessage(log_ns, channel, encode_cdr(_TYPES[channel], content))
