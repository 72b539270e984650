"""Reading of messages by the index; each message is checked against the index."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from mcap.opcode import Opcode

from jaxdet.io.chunks import MAX_TIME_NS, MESSAGE_HEAD, PAYLOAD_OFFSET, RECORD_HEAD, DamageError
from jaxdet.io.decode_messages import MessageDecoder
from jaxdet.io.file_index import IndexedMessages, Place
from jaxdet.io.messages import Kind
from jaxdet.io.store import ChunkStore

_FIRST_BYTES = 1024
"""Number of bytes read first of a message of unknown size."""


class TopicMessages(NamedTuple):
    """Messages of one kind on a topic."""

    decoders: tuple[MessageDecoder, ...]
    """Decoders, all of one kind or all of images; ``messages.decoder`` has indices into this tuple.
    """
    messages: IndexedMessages

    @property
    def topic(self) -> str:
        """Name of the topic."""
        return self.decoders[0].channel.topic

    @property
    def kind(self) -> Kind:
        """Kind of the messages."""
        return self.decoders[0].kind

    @property
    def is_static(self) -> bool:
        """Whether the messages are static transforms."""
        return self.decoders[0].is_static

    @property
    def num_messages(self) -> int:
        """Number of messages."""
        return len(self.messages.log_ns)

    def decoder(self, number: int) -> MessageDecoder:
        """Return the decoder of a message."""
        return self.decoders[int(self.messages.decoder[number])]

    def in_time(self) -> "TopicMessages":
        """Return the messages in order of log time, then of the files."""
        order = np.argsort(self.messages.log_ns, kind="stable")
        return self._replace(messages=self.messages.rows(order))


def rows_in_file_order(store: ChunkStore, messages: IndexedMessages) -> Iterator[int]:
    """Yield the index of each message in file order, with its chunk loaded."""
    order = np.lexsort((messages.offset, messages.position, messages.file))
    file, position = messages.file[order], messages.position[order]
    is_first = (np.diff(file, prepend=-1) != 0) | (np.diff(position, prepend=-1) != 0)
    starts = np.flatnonzero(is_first)
    ends = np.append(starts, len(order))[1:].tolist()
    places = messages.places(order[starts])
    for _, start, end in zip(store.loaded(places), starts.tolist(), ends, strict=True):
        yield from order[start:end].tolist()


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
        DamageError: The message is not at the position in the index.
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
        raise DamageError("no message at the position in the index")
    size = length - MESSAGE_HEAD.size
    if size < 0 or offset + PAYLOAD_OFFSET + size > store.head(place).uncompressed_size:
        raise DamageError("message is longer than its chunk")
    wanted = size if most is None else min(size, most)
    if wanted > len(known) - PAYLOAD_OFFSET:
        store.files[place.file].check_size(wanted, "message")
        known = store.peek(place, offset, PAYLOAD_OFFSET + wanted)
    payload = known[PAYLOAD_OFFSET : PAYLOAD_OFFSET + wanted]
    if len(payload) < wanted:
        raise DamageError("message is longer than its chunk")
    return size, payload
