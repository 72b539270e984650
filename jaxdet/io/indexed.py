"""Opens a log by the indexes of its files: what is small is read, of images the first few."""

from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import NamedTuple

import numpy as np

from jaxdet.errors import RescanError
from jaxdet.io.chunks import MESSAGE_HEAD, RECORD_HEAD, DamageError
from jaxdet.io.container import Location, LogFile
from jaxdet.io.declarations import ChannelInfo
from jaxdet.io.decode_messages import MessageDecoder
from jaxdet.io.formats import read_file_index
from jaxdet.io.index import IndexBuilder, LogIndex
from jaxdet.io.limits import check_images, check_motions, check_topics
from jaxdet.io.messages import IMAGE_KINDS, Kind
from jaxdet.io.motion_windows import MotionMessages, MotionTopic, MotionWindows, decode_motions
from jaxdet.io.records import IndexedMessages, read_message
from jaxdet.io.store import ChunkStore, Place
from jaxdet.io.streams import NUM_PROBES
from jaxdet.io.validity import InfoMessages
from jaxdet.io.windows import StreamWindows

_MOTIONS = (Kind.TRANSFORM, Kind.ODOMETRY, Kind.POSE)
_WHERE = ("file", "position", "offset")
_MAX_MOTIONS = 1000
"""So many transforms and poses are all read at opening; of more the first and a sample."""
_FIRST_MOTIONS = 64
_MOTION_SAMPLE = 192
_STATIC = 256
"""Messages of static transforms read at opening, where there are many."""


class IndexedLog(NamedTuple):
    """What the indexes of a log's files tell."""

    contents: LogIndex
    streams: dict[str, StreamWindows]
    """Image topics."""
    motions: MotionWindows
    calibrations: dict[str, InfoMessages]
    store: ChunkStore


class _Channel(NamedTuple):
    """A channel of one of the files."""

    file: int
    number: int
    info: ChannelInfo
    decoder: MessageDecoder


class _Topic(NamedTuple):
    """The messages of a topic that is of use, in the order of the files."""

    name: str
    kind: Kind
    channels: tuple[_Channel, ...]
    """A message's is that of its ``decoder``."""
    messages: IndexedMessages


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
    index = LogIndex()
    builder = IndexBuilder(index, use_tf)
    topics = _read_topics(files, builder)
    motions = [topic for topic in topics if topic.kind in _MOTIONS]
    whole = sum(len(topic.messages.log_ns) for topic in motions) <= _MAX_MOTIONS
    probes = [(topic, _probes(topic, whole)) for topic in topics]
    delays = _Delays()
    for topic, number, location, payload in _read_messages(store, probes):
        _add_message(builder, topic, number, location, payload)
        if topic.kind in _MOTIONS and not whole and not _is_static(topic):
            delays.see(topic, number, payload)
    for name, item in index.topics.items():
        if item.undecodable:
            problem = "one of the first messages can't be decoded"
            raise RescanError(problem, path=path, topic=name)
    for topic in topics:
        known = index.calibrations.get(topic.name)
        more = len(topic.messages.log_ns) > NUM_PROBES
        if known and more and (known.first is None or known.first.K[:1] == (0.0,)):
            raise RescanError("the first calibrations are empty", path=path, topic=topic.name)
    streams = {
        topic.name: StreamWindows(
            topic.name,
            topic.messages.rows(_in_time([topic.messages])),
            [channel.decoder for channel in topic.channels],
            store,
            path,
            int((np.diff(topic.messages.log_ns) < 0).sum()),
        )
        for topic in topics
        if topic.kind in IMAGE_KINDS
    }
    windows = _motion_windows(index, motions, store, delays.seen, path, whole)
    infos = {
        topic.name: InfoMessages(
            topic.name,
            topic.messages.rows(_in_time([topic.messages])),
            [channel.decoder for channel in topic.channels],
        )
        for topic in topics
        if topic.kind is Kind.INFO
    }
    return IndexedLog(index, streams, windows, infos, store)


def search_index(file: LogFile, builder: IndexBuilder) -> None:
    """Calibration and static transforms of a file, by its index.

    Raises:
        DamageError: The index is missing, torn or wrong.
    """
    store = ChunkStore([file], 1)
    topics = [
        topic
        for topic in _read_topics([file], builder)
        if topic.kind not in _MOTIONS or _is_static(topic)
    ]
    probes = [(topic, _probes(topic, False)) for topic in topics]
    for topic, number, location, payload in _read_messages(store, probes):
        _add_message(builder, topic, number, location, payload)


def _read_messages(
    store: ChunkStore, parts: Sequence[tuple[_Topic, np.ndarray]]
) -> Iterator[tuple[_Topic, int, Location, memoryview]]:
    """Some messages of topics in the order of the files; threads decompress their chunks.

    Raises:
        DamageError: One isn't where the index says.
    """
    wanted = [
        (*(int(getattr(topic.messages, name)[number]) for name in _WHERE), topic, number)
        for topic, numbers in parts
        for number in numbers.tolist()
    ]
    wanted.sort(key=lambda item: item[:3])
    chunks = {Place(*where): list(group) for where, group in groupby(wanted, lambda item: item[:2])}
    for wave in store.waves(chunks):
        store.load(wave)
        for _, position, offset, topic, number in (i for place in wave for i in chunks[place]):
            size, payload = read_message(store, topic.messages, number)
            head = RECORD_HEAD.size + MESSAGE_HEAD.size
            yield topic, number, Location(position, offset + head, size), payload


def _add_message(
    builder: IndexBuilder, topic: _Topic, number: int, location: Location, payload: memoryview
) -> None:
    info = topic.channels[int(topic.messages.decoder[number])].info
    builder.file_number = int(topic.messages.file[number])
    builder.take(info, int(topic.messages.log_ns[number]), payload, location)


def _read_topics(files: Sequence[LogFile], builder: IndexBuilder) -> list[_Topic]:
    """The topics that are of use; those of no use are noted and counted only."""
    found: dict[str, tuple[list[_Channel], list[IndexedMessages]]] = {}
    for number, file in enumerate(files):
        builder.path, builder.bytes = str(file.path), builder.bytes + file.size
        entries = read_file_index(file)
        check_topics(len(entries.infos), builder.path)
        if builder.images:
            builder.index.integrity.append(entries.integrity)
        for key, count in sorted(entries.counts.items(), key=lambda item: item[1].first_ns):
            builder.count(entries.infos[key], *count)
        for key, info in entries.infos.items():
            mine = entries.channel == key
            decoder = builder.decoder(info) if mine.any() else None
            if decoder is None or not builder.wants(decoder):
                continue
            channels, messages = found.setdefault(info.topic, ([], []))
            same = np.full(int(mine.sum()), 0, np.int64)
            messages.append(
                IndexedMessages(
                    entries.log_ns[mine],
                    same + number,
                    entries.position[mine],
                    entries.length[mine],
                    entries.offset[mine],
                    same + key,
                    same + len(channels),
                )
            )
            channels.append(_Channel(number, key, info, decoder))
    topics = [_topic(name, *parts) for name, parts in found.items()]
    small = 0
    for topic in topics:
        count = len(topic.messages.log_ns)
        small += count * (topic.kind not in IMAGE_KINDS)
        if topic.kind in IMAGE_KINDS:
            check_images(count, builder.bytes, builder.path, topic.name)
        check_motions(small, builder.bytes, builder.path, topic.name)
    return topics


def _topic(name: str, channels: list[_Channel], parts: list[IndexedMessages]) -> _Topic:
    kind = channels[0].decoder.kind
    if any(channel.decoder.kind is not kind for channel in channels):
        raise DamageError("a topic has messages of several kinds")
    messages = IndexedMessages(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))
    if len(parts) > 1:
        messages = messages.rows(np.lexsort((messages.offset, messages.position, messages.file)))
    return _Topic(name, kind, tuple(channels), messages)


def _probes(topic: _Topic, whole: bool) -> np.ndarray:
    """The messages read at opening."""
    count = len(topic.messages.log_ns)
    if topic.kind not in _MOTIONS:
        return np.arange(min(count, NUM_PROBES))
    if whole:
        return np.arange(count)
    first, sample = (_STATIC, 0) if _is_static(topic) else (_FIRST_MOTIONS, _MOTION_SAMPLE)
    spread = np.linspace(0, count - 1, sample).astype(np.int64)
    return np.unique(np.concatenate([np.arange(min(count, first)), spread]))


def _is_static(topic: _Topic) -> bool:
    return MotionTopic(topic.name, topic.channels[0].decoder).is_static


class _Delays:
    """By how much stamps differ from log times."""

    def __init__(self) -> None:
        self.seen: dict[str, tuple[int, int]] = {}
        """Least and most by frame or pose topic [ns]."""

    def see(self, topic: _Topic, number: int, payload: memoryview) -> None:
        """Looks at a message of what moves."""
        decoder = topic.channels[int(topic.messages.decoder[number])].decoder
        for item in decode_motions(decoder, payload):
            name = item.child if topic.kind is Kind.TRANSFORM else topic.name
            delay = item.stamp_ns - int(topic.messages.log_ns[number])
            low, high = self.seen.get(name, (delay, delay))
            self.seen[name] = min(low, delay), max(high, delay)


def _motion_windows(
    index: LogIndex,
    topics: Sequence[_Topic],
    store: ChunkStore,
    delays: dict[str, tuple[int, int]],
    path: str,
    whole: bool,
) -> MotionWindows:
    """The windows on all motions; a message's decoder is the number of its topic and channel."""
    parts, known = [], []
    for topic in topics:
        parts.append(topic.messages._replace(decoder=topic.messages.decoder + len(known)))
        known += [MotionTopic(topic.name, channel.decoder) for channel in topic.channels]
    order = _in_time(parts)
    columns = zip(*parts, strict=True) if parts else [[np.zeros(0, np.int64)]] * 7
    messages = IndexedMessages(*(np.concatenate(column)[order] for column in columns))
    arrival = np.lexsort((messages.offset, messages.position, messages.file))
    place = np.empty_like(arrival)
    place[arrival] = np.arange(len(arrival))
    tracks = {name: track.samples for name, track in index.poses.items()}
    found = MotionMessages(messages, place, tuple(known), delays)
    return MotionWindows(found, store, index.tree, tracks, path, whole)


def _in_time(parts: Sequence[IndexedMessages]) -> np.ndarray:
    """The messages of all parts in the order of log time, then of arrival."""
    if not parts:
        return np.zeros(0, np.int64)
    file, position, offset, log_ns = (
        np.concatenate([getattr(part, name) for part in parts]) for name in (*_WHERE, "log_ns")
    )
    if len(parts) == 1 and not (np.diff(log_ns) < 0).any():
        return np.arange(len(log_ns))
    return np.lexsort((offset, position, file, log_ns))
