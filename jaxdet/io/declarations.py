"""Schemas and channels declared in an MCAP file."""

from collections.abc import Callable
from io import BytesIO
from typing import NamedTuple, TypeVar

from mcap.data_stream import ReadDataStream
from mcap.records import Channel, Schema

from jaxdet.io.chunks import DamageError
from jaxdet.io.limits import MAX_SCHEMA_BYTES, MAX_SCHEMAS_BYTES
from jaxdet.io.messages import kind_of

T = TypeVar("T")


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
        self.schemas: dict[int, tuple[str, str, bytes, int]] = {}
        """Last four fields of :class:`ChannelInfo`, by schema id."""
        self.channels: dict[int, Channel] = {}
        self._bytes = 0

    def add_schema(self, content: bytes | memoryview) -> None:
        """Add the content of a schema record.

        Raises:
            DamageError: The record is damaged, or the schemas need too much memory.
        """
        item = _parsed(Schema.read, content)
        if item.id in self.schemas:
            return
        size = len(item.data)
        is_kept = kind_of(item.name) is not None and size <= MAX_SCHEMA_BYTES
        self._count(size if is_kept else len(item.name))
        data = item.data if is_kept else b""
        self.schemas[item.id] = item.name, item.encoding, data, size

    def add_channel(self, content: bytes | memoryview) -> None:
        """Add the content of a channel record; its metadata are ignored.

        Raises:
            DamageError: The record is damaged, or the names of channels need too much memory.
        """
        item = _parsed(Channel.read, content)
        if item.id not in self.channels:
            self._count(len(item.topic) + len(item.message_encoding))
            item.metadata = {}
            self.channels[item.id] = item

    def info(self, number: int, more: "Declarations | None" = None) -> ChannelInfo | None:
        """Return a channel with its schema, if any; None if the channel is not declared.

        Args:
            number: Channel id.
            more: Declarations to search for channels and schemas that are missing here.
        """
        parts = (self, more) if more else (self,)
        channel = next((part.channels[number] for part in parts if number in part.channels), None)
        if channel is None:
            return None
        key = channel.schema_id
        schema = next((part.schemas[key] for part in parts if key in part.schemas), None)
        return ChannelInfo(channel.topic, channel.message_encoding, *(schema or ("", "", b"", 0)))

    def _count(self, size: int) -> None:
        self._bytes += size
        if self._bytes > MAX_SCHEMAS_BYTES:
            raise DamageError("schemas and names of channels take too much memory")


def _parsed(read: Callable[[ReadDataStream], T], content: bytes | memoryview) -> T:
    """Parse the content of a record by a function of ``mcap``."""
    try:
        return read(ReadDataStream(BytesIO(content)))
    except Exception as error:  # mcap's reader may raise any exception
        raise DamageError("schema or channel record is damaged") from error
