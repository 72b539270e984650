"""Messages by their place in the index, each held against what the index says of it."""

from typing import NamedTuple

import numpy as np
from mcap.opcode import Opcode

from jaxdet.io.chunks import MAX_TIME_NS, MESSAGE_HEAD, PAYLOAD_OFFSET, RECORD_HEAD, DamageError
from jaxdet.io.decode_messages import MessageDecoder
from jaxdet.io.messages import Kind
from jaxdet.io.store import ChunkStore, Place

_FIRST_BYTES = 1024
"""Bytes that are read first of a message of unknown size."""


class IndexedMessages(NamedTuple):
    """Messages of some channels, ``(N,)`` each, all int64."""

    log_ns: np.ndarray
    """Log time [ns]."""
    file: np.ndarray
    """Number of the log's file."""
    position: np.ndarray
    """Position of the chunk in the file, see :meth:`jaxdet.io.container.LogFile.chunk_head`."""
    length: np.ndarray
    """Length of the chunk's content in the file."""
    offset: np.ndarray
    """Offset of the message's record in the decompressed chunk."""
    channel: np.ndarray
    """Number of the channel in the file."""
    decoder: np.ndarray
    """Number of the decoder."""

    def rows(self, which: np.ndarray | slice) -> "IndexedMessages":
        """Return some of them."""
        return IndexedMessages(*(column[which] for column in self))

    def between(self, begin: int | None, end: int | None) -> slice:
        """Return those from one log time to another, exclusive; None: from the first, to the last.

        They are in the order of log time.
        """
        first, last = np.searchsorted(self.log_ns, [begin or 0, end or 0]).tolist()
        return slice(0 if begin is None else first, len(self.log_ns) if end is None else last)

    def places(self, which: np.ndarray | slice = slice(None)) -> list[Place]:
        """Return the chunk of each of some messages; by default of all."""
        pairs = zip(self.file[which].tolist(), self.position[which].tolist(), strict=True)
        return [Place(*pair) for pair in pairs]

    def chunks(self, which: np.ndarray | slice) -> set[Place]:
        """Return the chunks of some messages."""
        return set(self.places(which))


class TopicMessages(NamedTuple):
    """The messages of a topic, of one kind."""

    decoders: tuple[MessageDecoder, ...]
    """All of one kind, or all of images; a message has the one of its ``decoder``."""
    messages: IndexedMessages

    @property
    def topic(self) -> str:
        """The topic's name."""
        return self.decoders[0].channel.topic

    @property
    def kind(self) -> Kind:
        """What its messages hold."""
        return self.decoders[0].kind

    @property
    def is_static(self) -> bool:
        """Whether they are transforms that hold at all times."""
        return self.decoders[0].is_static

    @property
    def num_messages(self) -> int:
        """How many there are."""
        return len(self.messages.log_ns)

    def decoder(self, number: int) -> MessageDecoder:
        """Return the decoder of a message."""
        return self.decoders[int(self.messages.decoder[number])]

    def in_time(self) -> "TopicMessages":
        """Return the same messages by log time, then in the order of the files."""
        order = np.argsort(self.messages.log_ns, kind="stable")
        return self._replace(messages=self.messages.rows(order))


def read_message(
    store: ChunkStore,
    messages: IndexedMessages,
    number: int,
    most: int | None = None,
    *,
    whole: bool = True,
) -> tuple[int, memoryview]:
    """Return size and payload of a message, or its first ``most`` bytes.

    Raises:
        DamageError: It isn't there.
    """
    place = Place(int(messages.file[number]), int(messages.position[number]))
    offset = int(messages.offset[number])
    first = PAYLOAD_OFFSET + (_FIRST_BYTES if most is None else most)
    known = store.peek(place, offset, first, whole=whole)
    if len(known) < PAYLOAD_OFFSET:
        raise DamageError("message record is too short")
    opcode, length = RECORD_HEAD.unpack_from(known)
    channel, _, log_ns, _ = MESSAGE_HEAD.unpack_from(known, RECORD_HEAD.size)
    expected = int(messages.channel[number]), int(messages.log_ns[number])
    if opcode != Opcode.MESSAGE or (channel, min(log_ns, MAX_TIME_NS)) != expected:
        raise DamageError("no such message there")
    size = length - MESSAGE_HEAD.size
    head = store.head(place)
    if head.length != messages.length[number]:
        raise DamageError("chunk has another length than its index says")
    if size < 0 or offset + PAYLOAD_OFFSET + size > head.uncompressed_size:
        raise DamageError("message is longer than its chunk")
    wanted = size if most is None else min(size, most)
    if wanted > len(known) - PAYLOAD_OFFSET:
        store.files[place.file].check_size(wanted, "message")
        known = store.peek(place, offset, PAYLOAD_OFFSET + wanted)
    payload = known[PAYLOAD_OFFSET : PAYLOAD_OFFSET + wanted]
    if len(payload) < wanted:
        raise DamageError("message is longer than its chunk")
    return size, payload
