"""Opening of a log by the indexes of its files.

Only the first images and calibrations are read, and all transforms and poses or a sample of them.
If this is not sufficient, a RescanError is raised; the caller then reads all timestamps and all
small messages.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

import deflate
import numpy as np

from jaxdet.errors import InputError, RescanError, printable
from jaxdet.io.chunks import MAX_TIME_NS, DamageError
from jaxdet.io.container import LogFile
from jaxdet.io.contents import FIRST_MOTIONS, ContentsBuilder, LogContents
from jaxdet.io.declarations import ChannelInfo
from jaxdet.io.decode_messages import MessageDecoder
from jaxdet.io.file_index import FileIndex, IndexedMessages
from jaxdet.io.limits import MAX_USED_TOPICS, check_count, check_topics
from jaxdet.io.messages import IMAGE_KINDS, Kind, kind_of
from jaxdet.io.motion_windows import MotionWindows
from jaxdet.io.records import TopicMessages, read_message, rows_in_file_order
from jaxdet.io.store import ChunkStore
from jaxdet.io.streams import NUM_PROBES, ImageStream
from jaxdet.io.validity import values_of
from jaxdet.io.windows import StreamWindows

_MOTIONS = (Kind.TRANSFORM, Kind.ODOMETRY, Kind.POSE)
_MAX_MOTIONS = 1000
"""Maximum number of transforms and poses to read all at opening; of more, a sample is read."""
_MOTION_SAMPLE = 192
_STATIC = 256
"""Number of static transforms read per topic at opening if there are too many to read all."""


class IndexedLog(NamedTuple):
    """Indexes of a log's files, with the messages read at opening."""

    contents: LogContents
    streams: dict[str, StreamWindows]
    """Images by topic."""
    motions: MotionWindows
    calibrations: dict[str, TopicMessages]
    """Calibration messages by topic, in order of log time."""
    store: ChunkStore
    is_complete: bool
    """Whether all small messages and the timestamps of all images were read."""


def open_index(
    indexes: Sequence[FileIndex],
    store: ChunkStore,
    use_tf: bool,
    path: str,
    *,
    complete: bool,
) -> IndexedLog:
    """Read the first messages of a log, or all small messages, by the indexes of its files.

    Args:
        indexes: Indexes of the files in ``store``.
        store: Chunks of the files.
        use_tf: Whether transforms are used.
        path: Path of the log, for errors.
        complete: Whether to read all small messages, and the timestamps of all images.

    Raises:
        DamageError: An index is wrong.
        RescanError: The first messages show that all messages must be read.
    """
    contents = LogContents(path)
    builder = ContentsBuilder(contents, use_tf)
    topics = _find_topics(store.files, indexes, builder)
    motions = [topic for topic in topics if topic.kind in _MOTIONS]
    whole = complete or sum(topic.num_messages for topic in motions) <= _MAX_MOTIONS
    streams = {
        topic.topic: StreamWindows(topic, store, path)
        for topic in topics
        if topic.kind in IMAGE_KINDS
    }
    if complete:
        _read_all(topics, streams, store, builder)
        contents.warnings += _drop_repeated(streams.values(), store)
    else:
        _read_first(topics, store, builder, whole=whole)
    windows = MotionWindows(motions, store, contents, whole)
    infos = {topic.topic: topic.in_time() for topic in topics if topic.kind is Kind.INFO}
    return IndexedLog(contents, streams, windows, infos, store, complete)


def search_index(file: LogFile, index: FileIndex, builder: ContentsBuilder) -> None:
    """Read the calibrations and static transforms of a file by its index.

    Raises:
        DamageError: The index is wrong.
    """
    store = ChunkStore([file], 1, most_bytes=file.memory.chunk)
    topics = [
        topic
        for topic in _find_topics([file], [index], builder)
        if topic.kind not in _MOTIONS or topic.is_static
    ]
    _read(store, builder, [(topic, _probes(topic, False)) for topic in topics])


def _read_first(
    topics: Sequence[TopicMessages], store: ChunkStore, builder: ContentsBuilder, *, whole: bool
) -> None:
    """Read the first messages of each topic, and a sample if there are many transforms and poses.

    Args:
        topics: Topics.
        store: Chunks of the log.
        builder: Collects the messages.
        whole: Whether to read all transforms and poses.

    Raises:
        DamageError: A message is not at its position in the index.
        RescanError: The first messages show that all messages must be read.
    """
    contents = builder.contents
    _read(store, builder, [(topic, _probes(topic, whole)) for topic in topics])
    if not whole and any(tree.ignored for tree in contents.trees.values()):
        raise RescanError("a transform is invalid", path=contents.path)
    for topic in topics:
        if contents.topics[topic.topic].undecodable:
            problem = "one of the first messages can't be decoded"
            raise RescanError(problem, path=contents.path, topic=topic.topic)
        known = contents.calibrations.get(topic.topic)
        more = topic.num_messages > NUM_PROBES
        if known and more and (known.first is None or values_of(known.first) is None):
            problem = "the first calibrations are empty"
            raise RescanError(problem, path=contents.path, topic=topic.topic)


def _read_all(
    topics: Sequence[TopicMessages],
    streams: Mapping[str, StreamWindows],
    store: ChunkStore,
    builder: ContentsBuilder,
) -> None:
    """Read all small messages, the timestamps of all images, and the first images.

    Messages that can't be read, such as missing image files, count as not decodable.

    Raises:
        DamageError: The file's own index is used, and a message is not at its position there.
    """
    trusted = any(file.by_index for file in builder.contents.integrity)
    parts = [(topic, np.arange(topic.num_messages)) for topic in topics]
    ranks = {name: stream.in_file_order() for name, stream in streams.items()}
    for topic, number in _in_file_order(store, parts):
        stream, problem = streams.get(topic.topic) if topic.kind in IMAGE_KINDS else None, ""
        rank = int(ranks[topic.topic][number]) if stream else 0
        try:
            problem = stream.read(rank) if stream else ""
            if stream is None or builder.is_probe(topic.decoder(number)):
                problem = ""  # _take finds and counts the same problem
                _take(store, builder, topic, number)
        except DamageError as error:
            if trusted:
                raise
            problem = str(error)
            if stream and stream.size[rank] < 0:
                stream.lose(rank)
        if problem:
            builder.contents.topics[topic.topic].add_undecodable(problem)


def _in_file_order(
    store: ChunkStore, parts: Sequence[tuple[TopicMessages, np.ndarray]]
) -> Iterator[tuple[TopicMessages, int]]:
    """Yield topics and message numbers in file order, with their chunks loaded."""
    which = np.repeat(np.arange(len(parts)), [len(numbers) for _, numbers in parts])
    numbers = np.concatenate([np.zeros(0, np.int64), *(numbers for _, numbers in parts)])
    messages = IndexedMessages.joined([topic.messages.rows(rows) for topic, rows in parts])
    for row in rows_in_file_order(store, messages):
        yield parts[int(which[row])][0], int(numbers[row])


def _read(
    store: ChunkStore, builder: ContentsBuilder, parts: Sequence[tuple[TopicMessages, np.ndarray]]
) -> None:
    """Read messages, given by topics and message numbers, in file order."""
    for topic, number in _in_file_order(store, parts):
        _take(store, builder, topic, number)


def _take(store: ChunkStore, builder: ContentsBuilder, topic: TopicMessages, number: int) -> None:
    _, payload = read_message(store, topic.messages, number)
    builder.take(topic.decoder(number), int(topic.messages.log_ns[number]), payload)


def _find_topics(
    files: Sequence[LogFile], indexes: Sequence[FileIndex], builder: ContentsBuilder
) -> list[TopicMessages]:
    """Return the topics with useful messages; other topics are only recorded and counted.

    Topics without messages are recorded last, since another file may have their messages.
    """
    found: dict[tuple[str, str], tuple[list[MessageDecoder], list[IndexedMessages]]] = {}
    path, nbytes = builder.contents.path, sum(file.size for file in files)
    silent = list[ChannelInfo]()
    sums = Counter[str]()  # images by topic, and all small messages under ""
    for number, entries in enumerate(indexes):
        check_topics(len(entries.infos), path)
        if builder.images:
            builder.contents.integrity.append(entries.integrity)
        for key, count in sorted(entries.counts.items(), key=lambda item: item[1].first_ns):
            builder.count(entries.infos[key], *count)
        silent += [info for key, info in entries.infos.items() if key not in entries.counts]
        for key, info in entries.infos.items():
            if key not in entries.counts or kind_of(info.schema_name) is None:
                continue
            decoder = builder.decoder(info)
            if decoder is None or not builder.wants(decoder):
                continue
            # A topic may have messages of several types.
            kind = "image" if decoder.kind in IMAGE_KINDS else decoder.kind.value
            group = info.topic if kind == "image" else ""
            sums[group] += entries.counts[key].messages
            what = "images" if kind == "image" else "small messages"
            check_count(what, sums[group], nbytes, path, info.topic)
            decoders, messages = found.setdefault((info.topic, kind), ([], []))
            check_topics(len(found), path, MAX_USED_TOPICS)
            mine = entries.messages.rows(entries.messages.channel == key)
            zero = np.zeros_like(mine.file)
            messages.append(mine._replace(file=zero + number, decoder=zero + len(decoders)))
            decoders.append(decoder)
    for info in silent:
        builder.count(info, 0, MAX_TIME_NS, 0)
    return [
        TopicMessages(tuple(known), IndexedMessages.joined(parts).in_file_order())
        for known, parts in found.values()
    ]


def _probes(topic: TopicMessages, whole: bool) -> np.ndarray:
    """Return the numbers of the messages that are read at opening."""
    count = topic.num_messages
    if topic.kind not in _MOTIONS:
        return np.arange(min(count, NUM_PROBES))
    if whole:
        return np.arange(count)
    first, sample = (_STATIC, 0) if topic.is_static else (FIRST_MOTIONS, _MOTION_SAMPLE)
    spread = np.linspace(0, count - 1, sample).astype(np.int64)
    return np.unique(np.concatenate([np.arange(min(count, first)), spread]))


def may_repeat(stream: ImageStream, log_ns: np.ndarray) -> bool:
    """Return whether images may occur twice, judging by the first images and all log times.

    Args:
        stream: First images.
        log_ns: Log times of all images in order, ``(N,)`` int64 [ns].
    """
    first = Counter((image.stamp_ns, image.size) for image in stream.first)
    several = any(count > 1 for (stamp, _), count in first.items() if stamp)
    return several or bool((np.diff(log_ns) == 0).any())


def _drop_repeated(streams: Iterable[StreamWindows], store: ChunkStore) -> list[str]:
    """Drop images that are equal to an earlier one of their topic in timestamp and content.

    Only messages with equal timestamps and sizes are read and compared.

    Args:
        streams: Images by topic, with all timestamps read.
        store: Chunks of the log.

    Returns:
        Warnings for the user.
    """
    warnings = []
    for stream in sorted(streams, key=lambda stream: stream.topic):
        keep = _first_ones(stream, store)
        if not keep.all():
            stream.keep(keep)
            count = int((~keep).sum())
            text = f"{count} images occur twice (same timestamp and content); each counts once"
            warnings.append(f"{printable(stream.topic)}: {text}")
    return warnings


def _first_ones(stream: StreamWindows, store: ChunkStore) -> np.ndarray:
    """Return which images do not repeat an earlier one in file order, ``(N,)`` bool."""
    keys = np.stack([stream.stamp, stream.color_stamp, stream.size], axis=1)
    keep = np.ones(len(keys), bool)
    if not len(keys):
        return keep
    _, group, count = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
    group = group.reshape(-1)
    several = (count[group] > 1) & (keys[:, 0] > 0)
    seen: set[tuple[int, int]] = set()
    for number in stream.in_file_order()[several[stream.in_file_order()]].tolist():
        try:
            data = read_message(store, stream.messages, number)[1]
        except (DamageError, InputError):
            continue
        key = int(group[number]), deflate.crc32(data)
        keep[number] = key not in seen
        seen.add(key)
    return keep
