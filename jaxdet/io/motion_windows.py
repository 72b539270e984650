"""Transforms and poses near given frames, read by the index.

Either all messages were read at opening, or only those near the frames are read. In the second case
the structure of the transform tree (parents, and which transforms are constant) is from the first
messages and an even sample, and each window checks that its messages have the same structure.
"""

from collections import OrderedDict
from collections.abc import Sequence
from copy import copy
from typing import Any

import numpy as np

from jaxdet.errors import FrameError, RescanError
from jaxdet.io.clocks import Clock, read_clock
from jaxdet.io.contents import LogContents
from jaxdet.io.decode_messages import MessageDecoder
from jaxdet.io.file_index import IndexedMessages, Place
from jaxdet.io.messages import Kind, TransformMessage
from jaxdet.io.motion import MotionSamples
from jaxdet.io.poses import PoseSource
from jaxdet.io.records import TopicMessages, read_message
from jaxdet.io.store import ChunkStore
from jaxdet.io.transforms import TransformTree

_SLACK_NS = 250_000_000
"""Allowed deviation of delays from those found at opening [ns]."""
_BESIDE = 8
"""Initial number of extra messages on each side of a window."""
_MAX_MESSAGES = 20_000
"""Maximum number of messages per window; if more are needed, all messages are read at opening."""
_MAX_DECODED = 1 << 15


class MotionWindows:
    """Transforms and poses of a log, read on demand.

    Args:
        topics: Topics with transforms or poses.
        store: Chunks of the log.
        contents: Messages read at opening.
        whole: Whether all messages were read at opening.
    """

    def __init__(
        self, topics: Sequence[TopicMessages], store: ChunkStore, contents: LogContents, whole: bool
    ) -> None:
        parts, self._decoders = [], list[MessageDecoder]()
        for topic in topics:
            some = topic.messages
            parts.append(some._replace(decoder=some.decoder + len(self._decoders)))
            self._decoders += topic.decoders
        messages = IndexedMessages.joined(parts).in_file_order()
        self._arrival = np.argsort(messages.log_ns, kind="stable")
        """Rank of each message in file order; the messages themselves are in order of log time."""
        self._messages = messages.rows(self._arrival)
        self._store, self._tree, self._tracks = store, TransformTree(), contents.tracks
        self._path, self.whole = contents.path, whole
        self._decoded: OrderedDict[int, list[tuple[str, TransformMessage]]] = OrderedDict()

    def of_tree(self, tree: TransformTree) -> "MotionWindows":
        """Return a copy for the transforms of one robot."""
        found = copy(self)
        found._tree, found._decoded = tree, OrderedDict()
        return found

    def on_clock(
        self, source: PoseSource, shifts_ns: Sequence[int]
    ) -> tuple["MotionWindows", list[Clock]]:
        """Return a copy without the adjustments of the clocks of the poses, and these clocks.

        Args:
            source: Source of the poses.
            shifts_ns: Shifts of depth, see :func:`jaxdet.io.clocks.read_clock`.

        Raises:
            RescanError: A clock was adjusted, and not all messages were read.
        """
        samples = self._first_samples(source)
        clocks = []
        for name, one in samples.items():
            topic, times = source.topic or self._tree.topic(name), (one.stamps_ns, one.log_ns)
            clocks.append(read_clock(topic, *times, one.num_first, shifts_ns, one.values))
        if not any(clock.shifts_ns for clock in clocks):
            return self, clocks
        if not self.whole:
            raise self._odd("a clock was adjusted during the recording")
        pairs = zip(samples.items(), clocks, strict=True)
        moved = {name: one.with_stamps(clock.stamps_ns) for (name, one), clock in pairs}
        found = copy(self)
        found._tree, found._tracks = self._tree.with_samples(moved), {**self._tracks, **moved}
        return found, clocks

    def _first_samples(self, source: PoseSource) -> dict[str, MotionSamples]:
        """Return the samples from the messages read at opening, by moving frame or topic."""
        return {
            name: self._tracks[name] if source.topic else self._tree.samples(name)
            for name in (source.moving(self._tree) if source.known else ())
        }

    def __getstate__(self) -> dict[str, Any]:
        """Return the state without the cache of decoded messages."""
        return self.__dict__ | {"_decoded": OrderedDict()}

    def window(
        self, source: PoseSource, stamps_ns: np.ndarray, begin: int | None, end: int | None
    ) -> tuple[np.ndarray | None, set[Place]]:
        """Return the camera poses at given times, and the chunks from which they were read.

        Args:
            source: Source of the poses.
            stamps_ns: Query times ``(n,)`` int64 [ns].
            begin: Log time of the first message of this window; None: the first message.
            end: Log time of the message after the last one of this window; None: the last message.

        Raises:
            RescanError: The messages differ from those found at opening.
            DamageError: The file contradicts its index.
        """
        log_ns, own = self._messages.log_ns, self._messages.between(begin, end)
        chunks = self._messages.chunks(own)
        if self.whole:
            return source.at(stamps_ns, self._tree, self._tracks), chunks
        first = self._first_samples(source)
        delays = [one.stamps_ns - one.log_ns for one in first.values()]
        low = min((int(some.min()) for some in delays), default=0) - _SLACK_NS
        high = max((int(some.max()) for some in delays), default=0) + _SLACK_NS
        about = int(stamps_ns.min()) - high, int(stamps_ns.max()) - low
        around = np.searchsorted(log_ns, about)
        bound = [
            max(0, min(own.start, int(around[0])) - _BESIDE),
            min(len(log_ns), max(own.stop, int(around[1])) + _BESIDE),
        ]
        beside = 2 * _BESIDE
        while True:
            if bound[1] - bound[0] > _MAX_MESSAGES + own.stop - own.start:
                raise self._odd("poses are too far apart")
            samples = self._samples(bound, list(first), low, high)
            sides = self._missing(samples, stamps_ns, bound, low, high)
            if not sides:
                break
            bound[0] = max(0, bound[0] - beside * (0 in sides))
            bound[1] = min(len(log_ns), bound[1] + beside * (1 in sides))
            beside *= 2
        tree = self._tree.with_samples(samples)
        return source.at(stamps_ns, tree, samples), chunks

    def _samples(
        self, bound: Sequence[int], moving: Sequence[str], low: int, high: int
    ) -> dict[str, MotionSamples]:
        """Return the samples of moving frames in a range of messages, in order of arrival."""
        samples = {name: MotionSamples() for name in moving}
        wanted = [
            decoder.kind is Kind.TRANSFORM or decoder.channel.topic in samples
            for decoder in self._decoders
        ]
        numbers = bound[0] + np.argsort(self._arrival[bound[0] : bound[1]])
        decoders, log_ns = (
            column[numbers].tolist() for column in (self._messages.decoder, self._messages.log_ns)
        )
        for number, decoder, at_ns in zip(numbers.tolist(), decoders, log_ns, strict=True):
            if not wanted[decoder]:
                continue
            found = self._decoded.get(number)
            for name, item in self._decode(number, decoder) if found is None else found:
                if name not in samples:
                    continue
                if not low <= item.stamp_ns - at_ns <= high:
                    raise self._odd(f"timestamps of {name!r} are far from their log times")
                samples[name].add(item.stamp_ns, item.translation, item.rotation)
        return samples

    def _decode(self, number: int, decoder_number: int) -> list[tuple[str, TransformMessage]]:
        """Return the moving transforms in a message, each with its frame or topic."""
        decoder = self._decoders[decoder_number]
        _, payload = read_message(self._store, self._messages, number)
        found = []
        try:
            items = decoder.motions(payload)
        except FrameError as error:  # the rescan counts this message
            raise self._odd(f"a message of {decoder.channel.topic} can't be decoded") from error
        for item in items:
            if item.problem:  # the rescan counts this transform
                raise self._odd(f"a transform of {item.child!r} is invalid")
            if decoder.kind is not Kind.TRANSFORM:
                found.append((decoder.channel.topic, item))
            elif not self._tree.uses(decoder.channel.topic, item.child):
                continue
            elif not self._tree.agrees(item, decoder.is_static):
                raise self._odd(f"transforms of frame {item.child!r} differ from the first ones")
            elif not decoder.is_static and item.parent == self._tree.parent(item.child):
                found.append((item.child, item))
        self._decoded[number] = found
        while len(self._decoded) > _MAX_DECODED:
            self._decoded.popitem(last=False)
        return found

    def _missing(
        self,
        samples: dict[str, MotionSamples],
        stamps_ns: np.ndarray,
        bound: Sequence[int],
        low: int,
        high: int,
    ) -> set[int]:
        """Return the sides (0 before, 1 after) on which a motion lacks a sample."""
        log_ns, sides = self._messages.log_ns, set()
        first, last = int(stamps_ns.min()), int(stamps_ns.max())
        for stamps in (one.stamps_ns for one in samples.values()):
            if bound[0] > 0:
                known = stamps > log_ns[bound[0] - 1] + high
                if not (known & (stamps <= first)).any():
                    sides.add(0)
            if bound[1] < len(log_ns):
                known = stamps < log_ns[bound[1]] + low
                if not (known & (stamps >= last)).any():
                    sides.add(1)
        return sides

    def _odd(self, problem: str) -> RescanError:
        return RescanError(problem, path=self._path)
