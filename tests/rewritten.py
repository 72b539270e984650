"""Simulated logs whose messages are changed, to have a property of real recordings.

Everything else is kept, so results of the simulated log are right for the changed one.
"""

import copy
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from mcap_ros2.writer import Writer
from scipy.spatial.transform import Rotation

from jaxdet.io.definition import DEFINITIONS, schema_text

DTYPES = {"16UC1": np.uint16, "32FC1": np.float32}


@dataclass
class Message:
    """A message as nested dicts and lists, and its log time [ns]."""

    topic: str
    kind: str
    body: dict[str, Any]
    log_ns: int

    @property
    def pixels(self) -> np.ndarray:
        """Return the pixels of an Image, ``(H, W)`` or ``(H, W, 3)``."""
        body = self.body
        flat = np.frombuffer(body["data"], DTYPES.get(body["encoding"], np.uint8))
        return flat.reshape(body["height"], body["width"], -1).squeeze()

    def show(self, image: np.ndarray, encoding: str = "") -> None:
        """Replace the pixels of an Image message, its size and, if given, its encoding."""
        data = np.ascontiguousarray(image).tobytes()
        self.body |= {
            "height": image.shape[0],
            "width": image.shape[1],
            "encoding": encoding or self.body["encoding"],
            "step": len(data) // image.shape[0],
            "data": data,
        }

    def delay(self, late_ns: int) -> None:
        """Delay the timestamps of all headers in the message by ``late_ns``."""
        for header in _headers(self.body):
            at = header["stamp"]["sec"] * 10**9 + header["stamp"]["nanosec"] + late_ns
            header["stamp"] = {"sec": at // 10**9, "nanosec": at % 10**9}


Change = Callable[[Message], Iterable[Message] | None]
"""Function that edits a message in place and returns None, or returns messages that replace it."""


def read_messages(path: Path) -> list[Message]:
    """Return all messages of a log."""
    found = []
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            assert schema is not None
            kind = schema.name.replace("/msg/", "/")
            found.append(Message(channel.topic, kind, _fields(decoded), message.log_time))
    return found


def write_messages(path: Path, messages: Iterable[Message], *, ordered: bool = True) -> Path:
    """Write a log, in the order of log times or, if not ``ordered``, of the messages."""
    with path.open("wb") as file:
        writer, schemas = Writer(file), {}
        for m in sorted(messages, key=lambda item: item.log_ns) if ordered else messages:
            if m.kind not in schemas:
                assert m.kind in DEFINITIONS
                name = m.kind.replace("/", "/msg/")
                schemas[m.kind] = writer.register_msgdef(name, schema_text(m.kind))
            writer.write_message(m.topic, schemas[m.kind], m.body, m.log_ns, m.log_ns)
        writer.finish()
    return path


def changed(messages: Iterable[Message], *changes: Change) -> list[Message]:
    """Return copies of messages, with the changes applied one after the other."""
    found = copy.deepcopy(list(messages))
    for change in changes:
        some = [(item, change(item)) for item in found]
        found = [one for item, new in some for one in ([item] if new is None else new)]
    return found


def move_world(path: Path, T: np.ndarray) -> Path:
    """Move the odometry frame of a simulated log by a rigid transform ``(4, 4)``, in place."""

    def move(position: dict[str, float], orientation: dict[str, float]) -> None:
        turned = Rotation.from_matrix(T[:3, :3]) * Rotation.from_quat([*orientation.values()])
        position |= zip("xyz", (T[:3, :3] @ [*position.values()] + T[:3, 3]).tolist(), strict=True)
        orientation |= zip("xyzw", turned.as_quat().tolist(), strict=True)

    def change(message: Message) -> None:
        if message.topic == "/odom":
            move(*message.body["pose"]["pose"].values())
        elif message.topic == "/tf":
            for item in message.body["transforms"]:
                move(*item["transform"].values())

    return write_messages(path, changed(read_messages(path), change))


def moved_camera(lower_m: float = 0.0, pitch: float = 0.0, roll: float = 0.0) -> Change:
    """Return a change that lowers the camera in TF [m] and turns it there by angles [rad]."""

    def change(message: Message) -> None:
        if message.topic == "/tf_static":
            for item in message.body["transforms"]:
                if item["child_frame_id"] == "camera_link":
                    item["transform"]["translation"]["z"] -= lower_m
                    quaternion = item["transform"]["rotation"]
                    turned = Rotation.from_quat([*quaternion.values()])
                    turned *= Rotation.from_euler("YX", [pitch, roll])
                    quaternion |= zip("xyzw", turned.as_quat().tolist(), strict=True)

    return change


def _fields(message: Any) -> Any:
    if hasattr(message, "__slots__") and not isinstance(message, str | bytes | memoryview):
        names = [name for name in message.__slots__ if not name.startswith("_")]
        return {name: _fields(getattr(message, name)) for name in names}
    if isinstance(message, list | tuple):
        return [_fields(item) for item in message]
    return bytes(message) if isinstance(message, memoryview) else message


def _headers(body: Any) -> Iterable[dict[str, Any]]:
    if isinstance(body, dict):
        if "stamp" in body:
            yield body
        for value in body.values():
            yield from _headers(value)
    elif isinstance(body, list):
        for value in body:
            yield from _headers(value)
