"""Opens a log by the indexes of its files: what is small is read, of images the first few."""

from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import NamedTuple

import numpy as np

from jaxdet.errors import RescanError
from jaxdet.io.chunks import PAYLOAD_OFFSET, DamageError
from jaxdet.io.container import Location, LogFile
from jaxdet.io.contents import FIRST_MOTIONS, ContentsBuilder, LogContents
from jaxdet.io.decode_messages import MessageDecoder
from jaxdet.io.formats import read_file_index
from jaxdet.io.limits import check_images, check_motions, check_topics
from jaxdet.io.messages import IMAGE_KINDS, Kind, kind_of
from jaxdet.io.motion_windows import MotionMessages, MotionWindows
from jaxdet.io.records import IndexedMessages, TopicMessages, read_message
from jaxdet.io.store import ChunkStore
from jaxdet.io.streams import NUM_PROBES
from jaxdet.io.windows import StreamWindows

_MOTIONS = (Kind.TRANSFORM, Kind.ODOMETRY, Kind.POSE)
_MAX_MOTIONS = 1000
"""So many transforms and poses are all read at opening; of more the first and a sample."""
_MOTION_SAMPLE = 192
_STATIC = 256
"""Messages of static transforms read at opening, where there are many."""


class IndexedLog(NamedTuple):
    """What the indexes of a log's files tell."""

    contents: LogContents
    streams: dict[str, StreamWindows]
    """Image topics."""
    motions: MotionWindows
    calibrations: dict[str, TopicMessages]
    """In the order of log time."""
    store: ChunkStore


def open_index(files: Sequence[LogFile], store: ChunkStore, use_tf: bool, path: str) -> IndexedLog:
    """What the indexes of a log's files tell, and its first messages.

    Args:
        files: The open files.
        store: Their chunks.
        use_tf: Whether transforms are read.
        path: The log's, for errors.

    Raises:
        DamageError: An index is missing, torn or wrong.
        RescanError: The first messages are such that the index isn't enough.
    """
    contents = LogContents(path)
    builder = ContentsBuilder(contents, use_tf)
    topics = _read_topics(files, builder)
    motions = [topic for topic in topics if topic.kind in _MOTIONS]
    whole = sum(topic.num_messages for topic in motions) <= _MAX_MOTIONS
    probes = [(topic, _probes(topic, whole)) for topic in topics]
    delays: dict[str, tuple[int, int]] = {}
    """Least and most, by frame or pose topic [ns]."""
    for topic, number, payload in _read_messages(store, probes):
        _add_message(builder, topic, number, payload)
        if contents.topics[topic.topic].undecodable:
            problem = "one of the first messages can't be decoded"
            raise RescanError(problem, path=path, topic=topic.topic)
        if not whole and any(tree.ignored for tree in contents.trees.values()):
            raise RescanError("a transform is none", path=path, topic=topic.topic)
        if topic.kind in _MOTIONS and not whole and not topic.is_static:
            _see_delays(delays, topic, number, payload)
    for topic in topics:
        known = contents.calibrations.get(topic.topic)
        more = topic.num_messages > NUM_PROBES
        if known and more and (known.first is None or known.first.K[:1] == (0.0,)):
            raise RescanError("the first calibrations are empty", path=path, topic=topic.topic)
    streams = {
        topic.topic: StreamWindows(topic, store, path)
        for topic in topics
        if topic.kind in IMAGE_KINDS
    }
    windows = _motion_windows(contents, motions, store, delays, whole)
    infos = {topic.topic: topic.in_time() for topic in topics if topic.kind is Kind.INFO}
    return IndexedLog(contents, streams, windows, infos, store)


def search_index(file: LogFile, builder: ContentsBuilder) -> None:
    """Calibration and static transforms of a file, by its index.

    Raises:
        DamageError: The index is missing, torn or wrong.
    """
    store = ChunkStore([file], 1, most_bytes=file.memory.chunk)
    topics = [
        topic
        for topic in _read_topics([file], builder)
        if topic.kind not in _MOTIONS or topic.is_static
    ]
    probes = [(topic, _probes(topic, False)) for topic in topics]
    for topic, number, payload in _read_messages(store, probes):
        _add_message(builder, topic, number, payload)


def _read_messages(
    store: ChunkStore, parts: Sequence[tuple[TopicMessages, np.ndarray]]
) -> Iterator[tuple[TopicMessages, int, memoryview]]:
    """Topic, number and payload of some messages, in the order of the files.

    Raises:
        DamageError: One isn't where the index says.
    """
    wanted = [
        (place, offset, topic, number)
        for topic, numbers in parts
        for place, offset, number in zip(
            topic.messages.places(numbers),
            topic.messages.offset[numbers].tolist(),
            numbers.tolist(),
            strict=True,
        )
    ]
    wanted.sort(key=lambda item: item[:2])
    chunks = {place: list(group) for place, group in groupby(wanted, lambda item: item[0])}
    for place in store.loaded(chunks):
        for _, _, topic, number in chunks[place]:
            yield topic, number, read_message(store, topic.messages, number)[1]


def _add_message(
    builder: ContentsBuilder, topic: TopicMessages, number: int, payload: memoryview
) -> None:
    messages = topic.messages
    builder.file_number = int(messages.file[number])
    place = int(messages.position[number]), int(messages.offset[number]) + PAYLOAD_OFFSET
    where = Location(*place, len(payload))
    builder.take(topic.decoder(number).channel, int(messages.log_ns[number]), payload, where)


def _read_topics(files: Sequence[LogFile], builder: ContentsBuilder) -> list[TopicMessages]:
    """The topics that are of use; those of no use are noted and counted only."""
    found: dict[str, tuple[list[MessageDecoder], list[IndexedMessages]]] = {}
    for number, file in enumerate(files):
        builder.next_file(file)
        entries = read_file_index(file)
        check_topics(len(entries.infos), builder.path)
        if builder.images:
            builder.contents.integrity.append(entries.integrity)
        for key, count in sorted(entries.counts.items(), key=lambda item: item[1].first_ns):
            builder.count(entries.infos[key], *count)
        for key, info in entries.infos.items():
            if key not in entries.counts or kind_of(info.schema_name) is None:
                continue
            decoder = builder.decoder(info)
            if decoder is None or not builder.wants(decoder):
                continue
            mine = entries.channel == key
            decoders, messages = found.setdefault(info.topic, ([], []))
            same = np.full(int(mine.sum()), 0, np.int64)
            messages.append(
                IndexedMessages(
                    entries.log_ns[mine],
                    same + number,
                    entries.position[mine],
                    entries.length[mine],
                    entries.offset[mine],
                    same + key,
                    same + len(decoders),
                )
            )
            decoders.append(decoder)
    topics = [_topic(*parts) for parts in found.values()]
    small = 0
    for topic in topics:
        small += topic.num_messages * (topic.kind not in IMAGE_KINDS)
        if topic.kind in IMAGE_KINDS:
            check_images(topic.num_messages, builder.bytes, builder.path, topic.topic)
        check_motions(small, builder.bytes, builder.path, topic.topic)
    return topics


def _topic(decoders: list[MessageDecoder], parts: list[IndexedMessages]) -> TopicMessages:
    if len({decoder.kind for decoder in decoders}) > 1:
        raise DamageError("a topic has messages of several kinds")
    return TopicMessages(tuple(decoders), _joined(parts))


def _probes(topic: TopicMessages, whole: bool) -> np.ndarray:
    """The messages read at opening."""
    count = topic.num_messages
    if topic.kind not in _MOTIONS:
        return np.arange(min(count, NUM_PROBES))
    if whole:
        return np.arange(count)
    first, sample = (_STATIC, 0) if topic.is_static else (FIRST_MOTIONS, _MOTION_SAMPLE)
    spread = np.linspace(0, count - 1, sample).astype(np.int64)
    return np.unique(np.concatenate([np.arange(min(count, first)), spread]))


def _see_delays(
    delays: dict[str, tuple[int, int]], topic: TopicMessages, number: int, payload: memoryview
) -> None:
    """By how much stamps in a message of what moves differ from its log time."""
    for item in topic.decoder(number).motions(payload):
        name = item.child if topic.kind is Kind.TRANSFORM else topic.topic
        delay = item.stamp_ns - int(topic.messages.log_ns[number])
        low, high = delays.get(name, (delay, delay))
        delays[name] = min(low, delay), max(high, delay)


def _motion_windows(
    contents: LogContents,
    topics: Sequence[TopicMessages],
    store: ChunkStore,
    delays: dict[str, tuple[int, int]],
    whole: bool,
) -> MotionWindows:
    """The windows on the messages of all these topics."""
    parts, decoders = [], []
    for topic in topics:
        parts.append(topic.messages._replace(decoder=topic.messages.decoder + len(decoders)))
        decoders += topic.decoders
    messages = _joined(parts)
    order = np.argsort(messages.log_ns, kind="stable")
    found = MotionMessages(messages.rows(order), order, tuple(decoders), delays)
    return MotionWindows(found, store, contents.tracks, contents.path, whole)


def _joined(parts: Sequence[IndexedMessages]) -> IndexedMessages:
    """Messages of topics or channels, each in the order of the files, in this order."""
    if len(parts) == 1:
        return parts[0]
    none = IndexedMessages(*[np.zeros(0, np.int64)] * 7)
    columns = zip(none, *parts, strict=True)
    messages = IndexedMessages(*map(np.concatenate, columns))
    return messages.rows(np.lexsort((messages.offset, messages.position, messages.file)))
