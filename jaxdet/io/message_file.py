"""Files with separately accessible messages.

Each message is a chunk that consists of a single MCAP record: a header, then the payload. Its
position is the number of the message.
"""

from abc import abstractmethod
from typing import NamedTuple

from mcap.opcode import Opcode

from jaxdet.io.chunks import MESSAGE_HEAD, PAYLOAD_OFFSET, RECORD_HEAD, ChunkHead, DamageError
from jaxdet.io.container import LogFile

_COMPRESSION = "message"
"""Compression name of these chunks, which can't be read by their position in the file."""
_MAX_CHANNEL = 0xFFFF


class MessageRow(NamedTuple):
    """Header data of a message, without its payload."""

    channel: int
    log_ns: int
    """Log time [ns]."""
    size: int
    """Size of the payload [byte]."""

    def check(self) -> "MessageRow":
        """Check the row and return it.

        Raises:
            DamageError: Channel or log time is out of range.
        """
        if not isinstance(self.channel, int) or not 0 <= self.channel <= _MAX_CHANNEL:
            raise DamageError("number of a topic is out of range")
        if not isinstance(self.log_ns, int) or self.log_ns < 0:
            raise DamageError("time of a message is out of range")
        return self


class MessageFile(LogFile):
    """A file of numbered messages."""

    @abstractmethod
    def row(self, number: int) -> MessageRow:
        """Return channel, log time and size of a message.

        Raises:
            DamageError: The message does not exist, or can't be read.
        """

    @abstractmethod
    def payload(self, number: int, most: int) -> bytes:
        """Return the first ``most`` bytes of a message's payload, or all if it is shorter.

        Raises:
            DamageError: The payload can't be read.
        """

    def chunk_head(self, position: int) -> ChunkHead:
        """Return the header of the chunk that represents a message.

        Raises:
            DamageError: There is no such message.
        """
        _, log_ns, size = self.row(position)
        size += PAYLOAD_OFFSET
        return ChunkHead(log_ns, log_ns, size, 0, _COMPRESSION, 0, size)

    def chunk(self, position: int) -> bytes:
        """Return a message with its header.

        Raises:
            DamageError: The message can't be read.
        """
        size = self.chunk_head(position).uncompressed_size
        self.check_memory(size)
        found = self.chunk_begin(position, size)
        if len(found) != size:
            raise DamageError("message ends early")
        return found

    def chunk_begin(self, position: int, size: int) -> bytes:
        """Return up to ``size`` bytes of a message with its header.

        Raises:
            DamageError: The message can't be read.
        """
        channel, log_ns, payload_size = self.row(position)
        head = RECORD_HEAD.pack(Opcode.MESSAGE, MESSAGE_HEAD.size + payload_size)
        head += MESSAGE_HEAD.pack(channel, 0, log_ns, log_ns)
        return head[:size] + self.payload(position, max(0, size - len(head)))
