"""The schema and channel records of an MCAP file, each within its record and within bounds.

Source: MCAP's specification, records ``Schema`` (0x03) and ``Channel`` (0x04).
"""

import struct
from typing import NamedTuple

from jaxdet.io.chunks import DamageError
from jaxdet.io.limits import MAX_SCHEMA_BYTES, MAX_SCHEMAS_BYTES
from jaxdet.io.messages import kind_of

_SIZE = struct.Struct("<I")
_SCHEMA = struct.Struct("<H")
_CHANNEL = struct.Struct("<HH")


class Schema(NamedTuple):
    """A schema as the file declares it."""

    name: str
    encoding: str
    data: bytes
    """Empty if it is of no use here, or too large."""
    size: int
    """Of the data in the file."""


class Channel(NamedTuple):
    """A channel as the file declares it."""

    topic: str
    message_encoding: str
    schema_id: int


class ChannelInfo(NamedTuple):
    """A channel with its schema."""

    topic: str
    message_encoding: str
    schema_name: str
    schema_encoding: str
    schema_data: bytes
    """Empty if it is of no use here, or too large."""
    schema_size: int = 0
    """Of the schema in the file."""

    @property
    def schema_text(self) -> str:
        """The schema as text."""
        return self.schema_data.decode("utf-8", "replace")


class Declarations:
    """The schemas and channels of a file, or of its summary; of one number the first counts."""

    def __init__(self) -> None:
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self._bytes = 0

    def add_schema(self, content: bytes | memoryview) -> None:
        """Take in the content of a schema record.

        Raises:
            DamageError: It overruns its record, or the schemas take too much memory.
        """
        (number,), place = _unpack(_SCHEMA, content, 0)
        name, place = _text(content, place)
        encoding, place = _text(content, place)
        (size,), place = _unpack(_SIZE, content, place)
        if place + size > len(content):
            raise DamageError("schema or channel record is damaged")
        if number in self.schemas:
            return
        kept = kind_of(name) is not None and size <= MAX_SCHEMA_BYTES
        self._bytes += size if kept else len(name)
        if self._bytes > MAX_SCHEMAS_BYTES:
            raise DamageError("schemas take too much memory")
        data = bytes(content[place : place + size]) if kept else b""
        self.schemas[number] = Schema(name, encoding, data, size)

    def add_channel(self, content: bytes | memoryview) -> None:
        """Take in the content of a channel record; its metadata are not read.

        Raises:
            DamageError: It overruns its record.
        """
        (number, schema), place = _unpack(_CHANNEL, content, 0)
        topic, place = _text(content, place)
        encoding, place = _text(content, place)
        (size,), place = _unpack(_SIZE, content, place)
        if place + size > len(content):
            raise DamageError("schema or channel record is damaged")
        if number not in self.channels:
            self._bytes += len(topic) + len(encoding)
            if self._bytes > MAX_SCHEMAS_BYTES:
                raise DamageError("names of channels take too much memory")
            self.channels[number] = Channel(topic, encoding, schema)

    def info(self, number: int, more: "Declarations | None" = None) -> ChannelInfo | None:
        """Return a channel with its schema, if it has one; None if it is not declared.

        Args:
            number: Of the channel.
            more: What is looked up where these lack it.
        """
        channels = (self.channels, more.channels if more else {})
        channel = next((part[number] for part in channels if number in part), None)
        if channel is None:
            return None
        key = channel.schema_id
        schema = self.schemas.get(key) or (more.schemas.get(key) if more else None)
        return ChannelInfo(channel.topic, channel.message_encoding, *(schema or ("", "", b"", 0)))


def _unpack(form: struct.Struct, content: bytes | memoryview, place: int) -> tuple[tuple, int]:
    try:
        return form.unpack_from(content, place), place + form.size
    except struct.error as error:
        raise DamageError("schema or channel record is damaged") from error


def _text(content: bytes | memoryview, place: int) -> tuple[str, int]:
    (size,), place = _unpack(_SIZE, content, place)
    if place + size > min(len(content), place + MAX_SCHEMA_BYTES):
        raise DamageError("schema or channel record is damaged")
    try:
        return str(content[place : place + size], "utf-8"), place + size
    except UnicodeDecodeError as error:
        raise DamageError("schema or channel record is damaged") from error
