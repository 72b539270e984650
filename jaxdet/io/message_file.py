"""Files with separately accessible messages, each of which is an uncompressed chunk.

Message ``number`` has the position ``number << 32``, from which on its bytes are read as if it were
in an MCAP file: a header, then the payload. Any part can be read separately, and pixels are read
directly into their arrays.
"""

from abc import abstractmethod
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from mcap.opcode import Opcode

from jaxdet.io.chunks import MESSAGE_HEAD, PAYLOAD_OFFSET, RECORD_HEAD, ChunkHead, DamageError
from jaxdet.io.container import LogFile

POSITION_BITS = 32
_WITHIN = (1 << POSITION_BITS) - 1
_MAX_NUMBER = (1 << 31) - 1
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


def position_of(number: int) -> int:
    """Return the position of a message.

    Raises:
        DamageError: The message number is out of range.
    """
    if not 0 <= number <= _MAX_NUMBER:
        raise DamageError("number of a message is out of range")
    return number << POSITION_BITS


def indexed_messages(
    number: np.ndarray, channel: np.ndarray, log_ns: np.ndarray, size: np.ndarray
) -> np.ndarray:
    """Assemble the input of :func:`jaxdet.io.file_index.file_index` from ``(N,)`` columns."""
    place = number << POSITION_BITS
    return np.stack([channel, log_ns, place, size + PAYLOAD_OFFSET, np.zeros_like(place)])


class MessageFile(LogFile):
    """A file of numbered messages."""

    @abstractmethod
    def row(self, number: int) -> MessageRow:
        """Return channel, log time and size of a message.

        Raises:
            DamageError: The message does not exist, or can't be read.
        """

    @abstractmethod
    def read_payload(self, number: int, start: int, parts: Sequence[memoryview]) -> None:
        """Fill writable byte views one after the other with a message's payload from ``start`` on.

        Raises:
            DamageError: The payload ends earlier, or can't be read.
        """

    def chunk_head(self, position: int) -> ChunkHead:
        """Return the header of the chunk that represents a message.

        Raises:
            DamageError: There is no such message.
        """
        _, log_ns, size = self.row(position >> POSITION_BITS)
        size += PAYLOAD_OFFSET
        return ChunkHead(log_ns, log_ns, size, 0, "", 0, size, size)

    def chunk(self, position: int) -> bytes:
        """Return a message with its header.

        Raises:
            DamageError: The message can't be read.
        """
        head = self.chunk_head(position)
        self.check_memory(head.uncompressed_size)
        return self.read(position, head.uncompressed_size)

    def read(self, position: int, size: int) -> bytes:
        """Return exactly ``size`` bytes of a message.

        Raises:
            DamageError: The message ends earlier, or can't be read.
        """
        found = bytearray(size)
        self.read_into(position, [memoryview(found)])
        return bytes(found)

    def read_into(self, position: int, parts: Sequence[memoryview]) -> None:
        """Fill writable byte views one after the other with the bytes from ``position`` on.

        Raises:
            DamageError: The message ends earlier, or can't be read.
        """
        number, start = position >> POSITION_BITS, position & _WITHIN
        left = list(parts)
        if start < PAYLOAD_OFFSET:
            head = self._head(number)
            while left and start < PAYLOAD_OFFSET:
                known = head[start : start + len(left[0])]
                left[0][: len(known)] = known
                left[0], start = left[0][len(known) :], start + len(known)
                left = [part for part in left if len(part)]
        if left:
            self.read_payload(number, start - PAYLOAD_OFFSET, left)

    def _head(self, number: int) -> bytes:
        channel, log_ns, size = self.row(number)
        head = RECORD_HEAD.pack(Opcode.MESSAGE, MESSAGE_HEAD.size + size)
        return head + MESSAGE_HEAD.pack(channel, 0, log_ns, log_ns)
