"""CDR, ROS 1, protobuf and JSON to the messages of :mod:`jaxdet.io.messages`.

All are decoded by the schema that stands in the log, never by offsets known beforehand.
"""

import json
import sys
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from functools import lru_cache
from io import StringIO
from types import SimpleNamespace
from typing import Any

import numpy as np
import zstandard
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory as Ros2Factory

from jaxdet.io.declarations import ChannelInfo
from jaxdet.io.definition import (
    bare_definition,
    is_standard,
    stamp_leads,
    with_ros2_names,
)
from jaxdet.io.limits import (
    MAX_JSON_BYTES,
    MAX_MESSAGE_BYTES,
    MAX_SCHEMA_BYTES,
    MAX_SMALL_BYTES,
)
from jaxdet.io.message_fields import nanoseconds, parse
from jaxdet.io.messages import (
    IMAGE_KINDS,
    Kind,
    Message,
    TransformMessage,
    bad_frame,
    kind_of,
    plain_schema_name,
)
from jaxdet.io.raw_messages import read_motions
from jaxdet.io.ros1 import ros1_decoder

_STAMP_BYTES = 12
"""In which a stamp that leads is."""
_ZSTD = b"\x28\xb5\x2f\xfd"
"""How a message begins that rosbag2 compressed alone (``compression_mode: message``)."""
_IN_PLACE = (Kind.TRANSFORM, Kind.ODOMETRY)


class MessageDecoder:
    """Decodes the messages of one channel.

    Raises:
        ValueError: The encoding or the schema is not supported; the text says which.
    """

    def __init__(self, channel: ChannelInfo) -> None:
        kind = kind_of(channel.schema_name)
        if kind is None:
            raise ValueError(f"schema {channel.schema_name!r} is of no use here")
        if channel.schema_size > MAX_SCHEMA_BYTES:
            size = f"{channel.schema_size} bytes, but at most {MAX_SCHEMA_BYTES} are read"
            raise ValueError(f"its schema has {size}")
        self.channel = channel
        self.kind: Kind = kind
        self._name = plain_schema_name(channel.schema_name)
        self.is_foxglove: bool = self._name.startswith("foxglove.")
        static = channel.topic.rstrip("/").endswith("tf_static")
        self.is_static: bool = static and kind is Kind.TRANSFORM
        """Whether its messages are transforms that hold at all times."""
        self._raw = _raw_decoder(channel.message_encoding, *channel[2:5])
        self._in_place = kind in _IN_PLACE and is_standard(channel)
        self.stamp_leads: bool = stamp_leads(channel)
        small = kind not in IMAGE_KINDS
        json_bytes = MAX_JSON_BYTES if channel.message_encoding == "json" else sys.maxsize
        self._most_bytes = min(MAX_SMALL_BYTES if small else sys.maxsize, json_bytes)

    def __reduce__(self) -> tuple:
        """In another process the decoder is made again from the schema."""
        return MessageDecoder, (self.channel,)

    def decode(self, payload: bytes | memoryview) -> Message:
        """Return the message in a payload.

        Raises:
            FrameError: It can't be decoded.
        """
        payload = self._expanded(payload)
        if len(payload) > self._most_bytes:
            problem = f"{self.kind.value} message of {len(payload)} bytes, but at most "
            problem += f"{self._most_bytes} are read"
            raise bad_frame(problem)
        readable = self._readable(payload)
        try:
            found = read_motions(self.kind, readable) if self._in_place else None
            return found or parse(self.kind, self._raw(readable), self._name)
        except MemoryError:
            raise
        except Exception as error:  # the decoders raise what they like
            raise bad_frame(
                f"{self.kind.value} message can't be decoded ({_short(error)})"
            ) from error

    def motions(self, payload: bytes | memoryview) -> tuple[TransformMessage, ...]:
        """Return the transforms or poses in a payload.

        Raises:
            FrameError: It can't be decoded.
        """
        found = self.decode(payload)
        assert isinstance(found, tuple)
        return tuple(item for item in found if isinstance(item, TransformMessage))

    def reads_stamp(self, head: bytes | memoryview) -> bool:
        """Return whether the header stamp is within a message's first bytes.

        CDR has it after its own 4 bytes, of which one says the order; ROS 1 after the header's
        number, little-endian.
        """
        if not self.stamp_leads or len(head) < _STAMP_BYTES:
            return False
        return self.channel.message_encoding == "ros1" or head[1] in (0, 1)

    def after_stamp(self, payload: bytes | memoryview) -> bytes:
        """Return a message without a leading stamp; all of it if the stamp does not lead."""
        payload = self._expanded(payload)
        return bytes(payload[_STAMP_BYTES:] if self.stamp_leads else payload)

    def _expanded(self, payload: bytes | memoryview, most: int | None = None) -> bytes | memoryview:
        """Return a message, or its first bytes, decompressed where rosbag2 compressed it alone.

        Raises:
            FrameError: It is damaged or too large.
        """
        if payload[:4] != _ZSTD or self.channel.message_encoding != "cdr":
            return payload
        try:
            with zstandard.ZstdDecompressor().stream_reader(payload) as reader:
                found = reader.read((MAX_MESSAGE_BYTES if most is None else most) + 1)
        except zstandard.ZstdError as error:
            raise bad_frame(f"the message can't be decompressed ({error})") from error
        if most is None and len(found) > MAX_MESSAGE_BYTES:
            raise bad_frame(f"the message has more than {MAX_MESSAGE_BYTES} bytes")
        return found

    def _readable(self, payload: bytes | memoryview) -> Any:
        """Return the payload for the decoder: a copy, but of ROS's images a view."""
        if self.kind in IMAGE_KINDS and self.channel.message_encoding == "ros1":
            return payload
        if self.kind in IMAGE_KINDS and self.channel.message_encoding == "cdr":
            return np.frombuffer(payload, np.uint8).view(_Payload)
        return bytes(payload)

    def stamp_ns(self, payload: memoryview) -> int:
        """Return the header stamp [ns]; read in place if the schema's first field is the header.

        Raises:
            FrameError: It can't be decoded.
        """
        begin = self._expanded(payload, _STAMP_BYTES) if self.stamp_leads else payload
        if self.reads_stamp(begin):
            little = self.channel.message_encoding == "ros1" or begin[1]
            order = "little" if little else "big"
            sec = int.from_bytes(begin[4:8], order, signed=True)
            return nanoseconds(sec, int.from_bytes(begin[8:12], order))
        return int(getattr(self.decode(payload), "stamp_ns", 0))


class _Payload(np.ndarray):
    """CDR as ``mcap_ros2`` reads it; slices are views, for it takes arrays of bytes by slicing."""

    def decode(self, encoding: str) -> str:
        """Return the text in a slice, as of bytes."""
        return self.tobytes().decode(encoding)


def _short(error: Exception) -> str:
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text[:120]}" if text else type(error).__name__


@lru_cache(64)
def _raw_decoder(
    message_encoding: str, name: str, schema_encoding: str, data: bytes
) -> Callable[[bytes], Any]:
    """Return a decoder of a schema, cached, as a log may have many topics of one schema."""
    if message_encoding == "json":
        return lambda data: json.loads(data, object_hook=lambda fields: SimpleNamespace(**fields))
    if message_encoding == "ros1" and schema_encoding == "ros1msg":
        try:
            return ros1_decoder(name, bare_definition(data.decode("utf-8", "replace")))
        except ImportError as error:
            problem = "ROS 1 messages need the package rosbags; install jaxdet[rosbag]"
            raise ValueError(problem) from error
        except Exception as error:  # parsers of foreign text raise what they like
            raise ValueError(f"its schema can't be read ({_short(error)})") from error
    decode = None
    try:
        if message_encoding == "cdr" and schema_encoding == "ros2msg":
            data = with_ros2_names(bare_definition(data.decode())).encode()
        schema = Schema(id=1, data=data, encoding=schema_encoding, name=name)
        if message_encoding == "protobuf":
            from mcap_protobuf.decoder import DecoderFactory as ProtobufFactory

            decode = ProtobufFactory().decoder_for(message_encoding, schema)
        elif message_encoding == "cdr":
            # mcap_ros2 prints what it can't parse; the error says it too.
            with redirect_stderr(StringIO()), redirect_stdout(StringIO()):
                decode = Ros2Factory().decoder_for(message_encoding, schema)
    except Exception as error:  # parsers of foreign text raise what they like
        raise ValueError(f"its schema can't be read ({_short(error)})") from error
    if decode is None:
        what = f"{message_encoding} with {schema_encoding} schema"
        raise ValueError(
            f"encoding {what} is not supported (only cdr with ros2msg, ros1, protobuf, json)"
        )
    return decode
