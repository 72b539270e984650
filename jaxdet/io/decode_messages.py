"""Decoding of CDR, ROS 1, protobuf and JSON into the messages of :mod:`jaxdet.io.messages`.

Messages are decoded by the schema in the log; offsets are fixed only if the schema ensures them.
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
    with_definition,
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

_STAMP_BYTES = 12
"""Number of bytes up to the end of a leading timestamp."""
_ZSTD = b"\x28\xb5\x2f\xfd"
"""First bytes of a message compressed by rosbag2 (``compression_mode: message``)."""
_IN_PLACE = (Kind.TRANSFORM, Kind.ODOMETRY)


class MessageDecoder:
    """Decoder of the messages of one channel.

    Raises:
        ValueError: The encoding or the schema is not supported; the error names it.
    """

    def __init__(self, channel: ChannelInfo) -> None:
        kind = kind_of(channel.schema_name)
        if kind is None:
            raise ValueError(f"schema {channel.schema_name!r} is not used")
        if channel.schema_size > MAX_SCHEMA_BYTES:
            size = f"{channel.schema_size} bytes, more than the maximum of {MAX_SCHEMA_BYTES}"
            raise ValueError(f"schema {channel.schema_name!r} has {size}")
        self.channel = channel = with_definition(channel)
        self.kind: Kind = kind
        self._name = plain_schema_name(channel.schema_name)
        self.is_foxglove: bool = self._name.startswith("foxglove.")
        static = channel.topic.rstrip("/").endswith("tf_static")
        self.is_static: bool = static and kind is Kind.TRANSFORM
        """Whether the messages are static transforms."""
        self._raw = _raw_decoder(channel.message_encoding, *channel[2:5])
        self._in_place = kind in _IN_PLACE and is_standard(channel)
        self.stamp_leads: bool = stamp_leads(channel)
        small = kind not in IMAGE_KINDS
        json_bytes = MAX_JSON_BYTES if channel.message_encoding == "json" else sys.maxsize
        self._most_bytes = min(MAX_SMALL_BYTES if small else sys.maxsize, json_bytes)

    def __reduce__(self) -> tuple:
        """Pickle the channel; another process builds the decoder again from its schema."""
        return MessageDecoder, (self.channel,)

    def decode(self, payload: bytes | memoryview) -> Message:
        """Decode a payload.

        Raises:
            FrameError: The payload can't be decoded.
        """
        payload = self._expanded(payload)
        if len(payload) > self._most_bytes:
            size = f"{len(payload)} bytes, more than the maximum of {self._most_bytes}"
            raise bad_frame(f"the {self.kind.value} message has {size}")
        readable = self._readable(payload)
        try:
            found = read_motions(self.kind, readable) if self._in_place else None
            return found or parse(self.kind, self._raw(readable), self._name)
        except MemoryError:
            raise
        except Exception as error:  # the decoders may raise any exception
            raise bad_frame(
                f"{self.kind.value} message can't be decoded ({_short(error)})"
            ) from error

    def motions(self, payload: bytes | memoryview) -> tuple[TransformMessage, ...]:
        """Decode the transforms or poses in a payload.

        Raises:
            FrameError: The payload can't be decoded.
        """
        found = self.decode(payload)
        assert isinstance(found, tuple)
        return tuple(item for item in found if isinstance(item, TransformMessage))

    def reads_stamp(self, head: bytes | memoryview) -> bool:
        """Return whether the header timestamp is within the first bytes of a message.

        In CDR, the timestamp follows the 4-byte encapsulation header, which contains the byte
        order. In ROS 1, it follows the header's sequence number and is little-endian.
        """
        if not self.stamp_leads or len(head) < _STAMP_BYTES:
            return False
        return self.channel.message_encoding == "ros1" or head[1] in (0, 1)

    def after_stamp(self, payload: bytes | memoryview) -> bytes:
        """Return a message without its timestamp, or unchanged if the timestamp is not first."""
        payload = self._expanded(payload)
        return bytes(payload[_STAMP_BYTES:] if self.stamp_leads else payload)

    def _expanded(self, payload: bytes | memoryview, most: int | None = None) -> bytes | memoryview:
        """Decompress a message, or its first ``most`` bytes, if rosbag2 compressed it.

        Raises:
            FrameError: The message is damaged or too large.
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
        """Return the payload as the decoder needs it: a view for ROS images, otherwise a copy."""
        if self.kind in IMAGE_KINDS and self.channel.message_encoding == "ros1":
            return payload
        if self.kind in IMAGE_KINDS and self.channel.message_encoding == "cdr":
            return np.frombuffer(payload, np.uint8).view(_Payload)
        return bytes(payload)

    def stamp_ns(self, payload: memoryview) -> int:
        """Return the header timestamp [ns], read in place if the header is the first field.

        Raises:
            FrameError: The payload can't be decoded.
        """
        begin = self._expanded(payload, _STAMP_BYTES) if self.stamp_leads else payload
        if self.reads_stamp(begin):
            little = self.channel.message_encoding == "ros1" or begin[1]
            order = "little" if little else "big"
            sec = int.from_bytes(begin[4:8], order, signed=True)
            return nanoseconds(sec, int.from_bytes(begin[8:12], order))
        return int(getattr(self.decode(payload), "stamp_ns", 0))


class _Payload(np.ndarray):
    """CDR buffer for ``mcap_ros2`` whose slices are views; those of ``bytes`` would be copies."""

    def decode(self, encoding: str) -> str:
        """Decode the text in a slice, like ``bytes.decode``."""
        return self.tobytes().decode(encoding)


def _short(error: Exception) -> str:
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text[:120]}" if text else type(error).__name__


@lru_cache(64)
def _raw_decoder(
    message_encoding: str, name: str, schema_encoding: str, data: bytes
) -> Callable[[bytes], Any]:
    """Return a decoder for a schema; cached, as a log may have many topics of one schema."""
    if message_encoding == "json":
        return lambda data: json.loads(data, object_hook=lambda fields: SimpleNamespace(**fields))
    if message_encoding == "ros1" and schema_encoding == "ros1msg":
        try:
            return _ros1_decoder(name, bare_definition(data.decode("utf-8", "replace")))
        except ImportError as error:
            problem = "ROS 1 messages need the package rosbags; install jaxdet[rosbag]"
            raise ValueError(problem) from error
        except Exception as error:  # parsers may raise any exception
            raise ValueError(f"schema {name!r} can't be read ({_short(error)})") from error
    decode = None
    try:
        if message_encoding == "cdr" and schema_encoding == "ros2msg":
            data = with_ros2_names(bare_definition(data.decode())).encode()
        schema = Schema(id=1, data=data, encoding=schema_encoding, name=name)
        if message_encoding == "protobuf":
            from mcap_protobuf.decoder import DecoderFactory as ProtobufFactory

            decode = ProtobufFactory().decoder_for(message_encoding, schema)
        elif message_encoding == "cdr":
            # mcap_ros2 prints definitions that it can't parse, and raises an exception with them.
            with redirect_stderr(StringIO()), redirect_stdout(StringIO()):
                decode = Ros2Factory().decoder_for(message_encoding, schema)
    except Exception as error:  # parsers may raise any exception
        raise ValueError(f"schema {name!r} can't be read ({_short(error)})") from error
    if decode is None:
        what = f"{message_encoding} with {schema_encoding} schema"
        raise ValueError(
            f"encoding {what} is not supported (only cdr with ros2msg, ros1, protobuf, json)"
        )
    return decode


def _ros1_decoder(name: str, definition: str) -> Callable[[bytes], Any]:
    """Return a function that decodes messages of a type.

    Args:
        name: Name of the type.
        definition: Fields of the type, then the definitions of its member types, as in ROS 1.

    Raises:
        ImportError: ``rosbags`` is not installed.
        Exception: The definition can't be parsed.
    """
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    full = name if "/msg/" in name else name.replace("/", "/msg/")
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(definition, full))
    return lambda data: store.deserialize_ros1(data, full)
