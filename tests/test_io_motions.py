"""Transforms and odometry read in place equal those read by the message definition."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader

from jaxdet.errors import FrameError
from jaxdet.io.declarations import ChannelInfo
from jaxdet.io.decode_messages import MessageDecoder
from jaxdet.io.definition import schema_text
from jaxdet.io.writer_cdr import encode_cdr


def decoders(name: str, text: str | None = None) -> tuple[MessageDecoder, MessageDecoder]:
    """Return a decoder that may read in place and one that uses only the definition."""
    data = (schema_text(name) if text is None else text).encode()
    package, kind = name.split("/")
    channel = ChannelInfo("/t", "cdr", f"{package}/msg/{kind}", "ros2msg", data, len(data))
    by_definition = MessageDecoder(channel)
    by_definition._in_place = False
    return MessageDecoder(channel), by_definition


def decoded(decoder: MessageDecoder, payload: bytes) -> Any:
    try:
        return decoder.decode(payload)
    except FrameError as error:
        return str(error)


def stamped(number: int, parent: str, child: str, turn: float) -> dict[str, Any]:
    rotation = {"x": 0.0, "y": np.sin(turn), "z": 0.0, "w": np.cos(turn) * 1.001}
    translation = {"x": 0.1 * (number % 1000), "y": -turn, "z": 1e-9}
    header = {"stamp": {"sec": number, "nanosec": 7}, "frame_id": parent}
    transform = {"translation": translation, "rotation": rotation}
    return {"header": header, "child_frame_id": child, "transform": transform}


def odometry(number: int, parent: str, child: str, turn: float) -> dict[str, Any]:
    item = stamped(number, parent, child, turn)
    position, orientation = item["transform"].values()
    pose = {"pose": {"position": position, "orientation": orientation}, "covariance": [0.5] * 36}
    zero = {"x": 0.0, "y": 0.0, "z": 0.0}
    twist = {"twist": {"linear": zero, "angular": zero}, "covariance": [0.0] * 36}
    return {"header": item["header"], "child_frame_id": child, "pose": pose, "twist": twist}


PARTS = st.tuples(
    st.integers(-2, 1 << 30), st.text(max_size=9), st.text(max_size=9), st.floats(-7, 7)
)
CHANGE = st.tuples(st.integers(0, 400), st.integers(0, 255))


@settings(max_examples=40, deadline=None)
@given(parts=st.lists(PARTS, max_size=3), change=CHANGE)
def test_transforms_equal_those_read_by_the_definition(parts, change):
    message = {"transforms": [stamped(*part) for part in parts]}
    payload = bytearray(encode_cdr("tf2_msgs/TFMessage", message))
    quick, general = decoders("tf2_msgs/TFMessage")
    assert quick._in_place
    found: Any = quick.decode(payload) if all(part[0] >= 0 for part in parts) else ()
    assert [item.parent for item in found] == [part[1].lstrip("/") for part in parts if found]
    assert decoded(quick, bytes(payload)) == decoded(general, bytes(payload))
    place, value = change
    if place < len(payload):
        payload[place] = value
        assert decoded(quick, bytes(payload)) == decoded(general, bytes(payload))
        assert decoded(quick, bytes(payload[:place])) == decoded(general, bytes(payload[:place]))


def test_odometry_equals_that_read_by_the_definition():
    quick, general = decoders("nav_msgs/Odometry")
    assert quick._in_place
    payload = encode_cdr("nav_msgs/Odometry", odometry(3, "/odom", "base", 0.4))
    found: Any = quick.decode(payload)
    (item,) = found
    assert (item.stamp_ns, item.parent, item.child) == (3_000_000_007, "odom", "base")
    assert np.linalg.norm(item.rotation) == pytest.approx(1, abs=1e-15)
    for size in range(0, len(payload) + 1, 5):
        assert decoded(quick, payload[:size]) == decoded(general, payload[:size])


def test_another_definition_is_not_read_in_place():
    text = schema_text("tf2_msgs/TFMessage").replace("float64 w", "float64 v")
    assert not decoders("tf2_msgs/TFMessage", text)[0]._in_place
    longer = schema_text("tf2_msgs/TFMessage") + "====\nMSG: a/Header\nstring frame_id\n"
    quick, _ = decoders("tf2_msgs/TFMessage", longer)
    assert not quick._in_place  # the definition has two different types Header


def test_timestamps_of_messages_that_begin_with_a_header_are_read_in_place():
    def leads(name: str, text: str, encoding: str = "cdr") -> bool:
        schema = "ros1msg" if encoding == "ros1" else "ros2msg"
        data = text.encode()
        return MessageDecoder(
            ChannelInfo("/t", encoding, name, schema, data, len(data))
        ).stamp_leads

    image = schema_text("sensor_msgs/Image")
    assert leads("sensor_msgs/msg/Image", image)
    assert leads("sensor_msgs/msg/Image", "uint8 MANY=7 # of these\n" + image)
    assert not leads("sensor_msgs/msg/Image", "uint8 many\n" + image)
    assert not leads("sensor_msgs/msg/Image", image.replace("int32 sec", "int64 sec"))
    assert not leads("sensor_msgs/msg/Image", image + "====\nMSG: a/Header\nstring frame_id\n")
    older = image.replace("builtin_interfaces/Time stamp", "uint32 seq\ntime stamp")
    assert not leads("sensor_msgs/msg/Image", image.replace("Header header", "Time stamp"))
    pytest.importorskip("rosbags")
    assert leads("sensor_msgs/Image", older, "ros1")
    assert not leads("sensor_msgs/Image", older.replace("uint32 seq\n", ""), "ros1")


def test_recorded_transforms_equal_those_read_by_the_definition(shared_data: Path):
    seen = 0
    for path in sorted(shared_data.rglob("*.mcap")):
        with path.open("rb") as file:
            known: dict[int, tuple[MessageDecoder, MessageDecoder]] = {}
            for schema, channel, message in make_reader(file).iter_messages():
                if schema is None or schema.name not in (
                    "tf2_msgs/msg/TFMessage",
                    "nav_msgs/msg/Odometry",
                ):
                    continue
                if channel.id not in known:
                    name = schema.name.replace("/msg/", "/")
                    known[channel.id] = decoders(name, schema.data.decode())
                    assert known[channel.id][0]._in_place, path
                quick, general = known[channel.id]
                assert quick.decode(message.data) == general.decode(message.data)
                seen += 1
    assert seen
