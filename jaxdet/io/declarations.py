"""Schema and channel records of an MCAP file, parsed with bounds checks.

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
    """A schema declared in the file."""

    name: str
    encoding: str
    data: bytes
    """Schema text; empty if it is not needed or too large."""
    size: int
    """Size of the schema text in the file [byte]."""


class Channel(NamedTuple):
    """A channel declared in the file."""

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
    """Schema text; empty if it is not needed or too large."""
    schema_size: int = 0
    """Size of the schema text in the file [byte]."""

    @property
    def schema_text(self) -> str:
        """Schema as a string."""
        return self.schema_data.decode("utf-8", "replace")


class Declarations:
    """Schemas and channels of a file or its summary; the first record of each id counts."""

    def __init__(self) -> None:
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self._bytes = 0

    def add_schema(self, content: bytes | memoryview) -> None:
        """Add the content of a schema record.

        Raises:
            DamageError: A length exceeds the record, or the schemas need too much memory.
        """
        (number,), place = _unpack(_SCHEMA, content, 0)
        name, place = _text(content, place)
        encoding, place = _text(content, place)
        (size,), place = _unpack(_SIZE, content, place)
        if place + size > len(content):
            raise DamageError("schema or channel record is damaged")
        if number in self.schemas:
            return
        is_kept = kind_of(name) is not None and size <= MAX_SCHEMA_BYTES
        self._count(len(name) + len(encoding) + (size if is_kept else 0))
        data = bytes(content[place : place + size]) if is_kept else b""
        self.schemas[number] = Schema(name, encoding, data, size)

    def add_channel(self, content: bytes | memoryview) -> None:
        """Add the content of a channel record; its metadata are ignored.

        Raises:
            DamageError: A length exceeds the record.
        """
        (number, schema), place = _unpack(_CHANNEL, content, 0)
        topic, place = _text(content, place)
        encoding, place = _text(content, place)
        (size,), place = _unpack(_SIZE, content, place)
        if place + size > len(content):
            raise DamageError("schema or channel record is damaged")
        if number not in self.channels:
            self._count(len(topic) + len(encoding))
            self.channels[number] = Channel(topic, encoding, schema)

    def info(self, number: int, more: "Declarations | None" = None) -> ChannelInfo | None:
        """Return a channel with its schema, if any; None if the channel is not declared.

        Args:
            number: Channel id.
            more: Declarations to search for channels and schemas that are missing here.
        """
        channels = (self.channels, more.channels if more else {})
        channel = next((part[number] for part in channels if number in part), None)
        if channel is None:
            return None
        key = channel.schema_id
        schema = self.schemas.get(key) or (more.schemas.get(key) if more else None)
        return ChannelInfo(channel.topic, channel.message_encoding, *(schema or ("", "", b"", 0)))

    def _count(self, size: int) -> None:
        self._bytes += size
        if self._bytes > MAX_SCHEMAS_BYTES:
            raise DamageError("schemas and names of channels take too much memory")


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
