"""The frames of a log by its index: only the messages about the frames asked for are looked at.

A frame's number is its rank by header stamp. A stream's messages are nearly in this order
already: it is checked that no two that are ``REACH`` or more messages apart (by log time) are in
the wrong order, so that ranks follow from messages near by. It is enough to compare messages
``REACH`` to ``2 REACH - 1`` apart: of two in the wrong order that are farther apart, one in
between is in the wrong order with one of them. Each message is compared with those before it
by the window that answers for it, and each message of a log belongs to one window of any division
of its frames. So whoever reads all frames either gets the ranks of a whole scan or an error.
"""

from collections.abc import Sequence
from itertools import groupby
from typing import NamedTuple

import numpy as np

from jaxdet.errors import FrameError, RescanError
from jaxdet.io.chunks import MESSAGE_HEAD, RECORD_HEAD
from jaxdet.io.decode_messages import MessageDecoder
from jaxdet.io.index import image_stamps
from jaxdet.io.messages import Kind
from jaxdet.io.motion_windows import MotionWindows
from jaxdet.io.notes import Notes, StreamNotes
from jaxdet.io.pairing import pair
from jaxdet.io.poses import PoseSource
from jaxdet.io.records import IndexedMessages, read_message
from jaxdet.io.store import ChunkStore, Place
from jaxdet.io.timeline import FrameTable, Window

REACH = 4
"""Messages this far apart by log time are in the order of their stamps."""
_BESIDE = 2
"""Frames looked at to either side, at first."""
_MAX_BESIDE = 4096
_STAMP_BYTES = 64
"""Of a payload, enough for a stamp that leads."""


class StreamWindows:
    """The messages of one image topic; stamps are read when they are asked for.

    Args:
        topic: The topic.
        messages: Its messages in the order of log time, then of arrival.
        decoders: A message has the one of its ``decoder``.
        store: The log's chunks.
        path: The log's, for errors.
        backward: How many come after one with a later log time in the file.
    """

    def __init__(
        self,
        topic: str,
        messages: IndexedMessages,
        decoders: Sequence[MessageDecoder],
        store: ChunkStore,
        path: str,
        backward: int = 0,
    ) -> None:
        self.topic, self.messages, self.decoders = topic, messages, decoders
        self.backward = backward
        self._store, self._path = store, path
        count = len(messages.log_ns)
        self.stamp, self.depth_stamp, self.size = (np.full(count, -1, np.int64) for _ in range(3))
        self._undecodable = np.zeros(count, bool)

    def __len__(self) -> int:
        return len(self.stamp)

    def ranked(self, first: int, last: int) -> np.ndarray:
        """The messages of the frames ``first`` to ``last``.

        Raises:
            RescanError: Messages are too far from the order of their stamps.
            DamageError: One of them is not where the index says.
        """
        start, stop = max(0, first - 2 * REACH), min(len(self), last + REACH)
        self._load(start, stop)
        stamps = self.stamp[start:stop]
        if len(stamps) > REACH:
            latest = np.maximum.accumulate(stamps[:-REACH])
            if (stamps[REACH:] < latest).any():
                problem = "header stamps are far from the order of log times"
                raise RescanError(problem, path=self._path, topic=self.topic)
        order = start + np.argsort(stamps, kind="stable")
        return order[first - start : last - start]

    def notes(self, first: int, last: int, ranked: np.ndarray) -> StreamNotes:
        """What is odd of messages and frames ``first`` to ``last``.

        Args:
            first: Of the messages, whose stamps are known.
            last: The message after the last.
            ranked: The messages of the frames ``first - 1`` (if there is one) to ``last``.
        """
        stamps = self.stamp[max(first - 1, 0) : last]
        return StreamNotes(
            backward=int((np.diff(stamps) < 0).sum()),
            double=int((np.diff(self.stamp[ranked]) == 0).sum()),
            zero=int((self.stamp[first:last] == 0).sum()),
            undecodable=int(self._undecodable[first:last].sum()),
        )

    def table(self, numbers: np.ndarray, depth: bool) -> FrameTable:
        """Messages of some numbers; of -1 one with a stamp of -1."""
        messages, head = self.messages, RECORD_HEAD.size + MESSAGE_HEAD.size
        stamps = (self.depth_stamp if depth else self.stamp)[numbers]
        columns = messages.position, messages.offset + head, self.size
        place = np.stack([column[numbers] for column in columns], axis=1)
        stamps = np.where(numbers < 0, -1, stamps)
        return FrameTable(stamps, messages.file[numbers], messages.decoder[numbers], place)

    def chunks(self, first: int, last: int) -> set[Place]:
        """The chunks of messages ``first`` to ``last``."""
        return self.messages.chunks(slice(first, last))

    def _load(self, start: int, stop: int) -> None:
        """Reads the stamps of messages that aren't known yet."""
        missing = start + np.flatnonzero(self.size[start:stop] < 0)
        if not len(missing):
            return
        places = self.messages.places(missing)
        parts = {
            place: [number for _, number in group]
            for place, group in groupby(
                sorted(zip(places, missing.tolist(), strict=True)), lambda item: item[0]
            )
        }
        for wave in self._store.waves(parts):
            packed = [place for place in wave if not self._store.head(place).is_plain]
            for _ in self._store.map(self._store.data, packed):
                pass
            for place in wave:
                for number in parts[place]:
                    self._read(number)

    def _read(self, number: int) -> None:
        decoder = self.decoders[self.messages.decoder[number]]
        leads = decoder.stamp_leads and decoder.kind is not Kind.RGBD
        size, payload = read_message(
            self._store, self.messages, number, _STAMP_BYTES if leads else None
        )
        if leads and not (len(payload) >= 12 and payload[1] in (0, 1)):
            size, payload = read_message(self._store, self.messages, number)
        try:
            stamps = image_stamps(decoder, payload)
        except FrameError:
            log_ns = int(self.messages.log_ns[number])
            stamps, self._undecodable[number] = (log_ns, log_ns), True
        self.stamp[number], self.depth_stamp[number] = stamps
        self.size[number] = size


class _Reach(NamedTuple):
    """How far frames are known to one side of others."""

    enough: bool
    nearest: int
    """The nearest stamp on this side, as far as it matters."""


class IndexedFrames:
    """The frames of a log by its index.

    Args:
        color: The colour stream.
        depth: The depth stream; the same object for RGBD messages.
        motions: Transforms and poses.
        source: Where the poses come from.
        tolerance_s: The pairing's [s].
        path: The log's, for errors.
    """

    def __init__(
        self,
        color: StreamWindows,
        depth: StreamWindows,
        motions: MotionWindows,
        source: PoseSource,
        tolerance_s: float,
        path: str,
    ) -> None:
        self.color, self.depth, self.source = color, depth, source
        self._motions, self._tolerance_s, self._path = motions, tolerance_s, path

    @property
    def num_frames(self) -> int:
        """Colour frames."""
        return len(self.color)

    def with_poses(self, source: PoseSource) -> "IndexedFrames":
        """The same frames with poses."""
        given = self.color, self.depth, self._motions, source, self._tolerance_s, self._path
        return IndexedFrames(*given)

    def window(self, start: int, stop: int) -> Window:
        """The frames ``start`` to ``stop``.

        Raises:
            RescanError: The index doesn't tell.
            DamageError: The file contradicts its index.
        """
        if self.color is self.depth:
            return self._pairs_by_message(start, stop)
        log_ns, count = self.color.messages.log_ns, len(self.depth)
        bounds = np.searchsorted(self.depth.messages.log_ns, log_ns[[start, stop - 1]])
        if stop < len(self.color):
            bounds[1] = np.searchsorted(self.depth.messages.log_ns, log_ns[stop])
        first = int(bounds[0]) if start else 0
        last = int(bounds[1]) if stop < len(self.color) else count
        wide = [[max(0, start - _BESIDE), min(len(self.color), stop + _BESIDE)]]
        wide += [[max(0, first - _BESIDE), min(count, last + _BESIDE)]]
        streams, targets = (self.color, self.depth), ((start, stop), (first, last))
        while True:
            ranked = [s.ranked(*bound) for s, bound in zip(streams, wide, strict=True)]
            stamps = [s.stamp[order] for s, order in zip(streams, ranked, strict=True)]
            parts = [
                values[target[0] - bound[0] : target[1] - bound[0]]
                for values, target, bound in zip(stamps, targets, wide, strict=True)
            ]
            missing = self._missing(stamps, parts, wide)
            if not missing:
                break
            for stream, side in missing:
                self._widen(wide[stream], side, targets[stream], len(streams[stream]))
        pairing = pair(stamps[0], stamps[1], self._tolerance_s)
        partner = pairing.depth_of_color[start - wide[0][0] : stop - wide[0][0]]
        numbers = ranked[0][start - wide[0][0] : stop - wide[0][0]]
        partners = np.where(partner < 0, -1, ranked[1][partner] if count else -1)
        color = self.color.table(numbers, False)
        depth = self.depth.table(partners, False) if count else color.rows(partners)
        alone = pairing.unpaired_depth + wide[1][0]
        alone = alone[(alone >= first) & (alone < last)] - wide[1][0]
        before = [max(bound[0] - 1, 0) for bound in targets]
        notes = Notes(
            self.color.notes(start, stop, ranked[0][before[0] - wide[0][0] :][: stop - before[0]]),
            self.depth.notes(first, last, ranked[1][before[1] - wide[1][0] :][: last - before[1]]),
            np.abs(color.stamps_ns - depth.stamps_ns)[partner >= 0],
            int((partner < 0).sum()),
            stamps[1][alone],
        )
        chunks = self.color.chunks(start, stop) | self.depth.chunks(first, last)
        return self._with_poses(Window(color, depth, None, notes), chunks, start, stop)

    def _pairs_by_message(self, start: int, stop: int) -> Window:
        before = max(start - 1, 0)
        ranked = self.color.ranked(before, stop)
        numbers = ranked[start - before :]
        color, depth = self.color.table(numbers, False), self.color.table(numbers, True)
        apart = np.abs(color.stamps_ns - depth.stamps_ns)
        notes = Notes(self.color.notes(start, stop, ranked), apart_ns=apart)
        window = Window(color, depth, None, notes)
        return self._with_poses(window, self.color.chunks(start, stop), start, stop)

    def _with_poses(self, window: Window, chunks: set[Place], start: int, stop: int) -> Window:
        log_ns = self.color.messages.log_ns
        begin = int(log_ns[start]) if start else None
        end = int(log_ns[stop]) if stop < len(self.color) else None
        T, more = self._motions.window(self.source, window.color.stamps_ns, begin, end)
        poses = 0 if T is None else int(np.isfinite(T[:, 0, 0]).sum())
        return window._replace(
            T_world_camera=T,
            notes=window.notes._replace(poses=poses),
            chunks=tuple(sorted(chunks | more)),
        )

    def _missing(
        self,
        stamps: list[np.ndarray],
        targets: list[np.ndarray],
        wide: list[list[int]],
    ) -> set[tuple[int, int]]:
        """Which streams must be looked at further to which side, for pairs that are certain.

        A frame's partner is the nearest of the other stream, and has that frame as its nearest:
        so the next frames of the other stream must be known, and what is next to those; or
        anything beyond the tolerance.
        """
        both = np.concatenate(targets)
        missing = set()
        for side, sign in enumerate((1, -1)):
            edge = int((sign * both).min())
            known = [np.sort(sign * values) for values in stamps]
            ends = [
                bound[side] == (0, len(stream))[side]
                for bound, stream in zip(wide, (self.color, self.depth), strict=True)
            ]
            near = [self._reach(*item, edge) for item in zip(known, ends, strict=True)]
            for stream in (0, 1):
                beyond = min(edge, near[1 - stream].nearest)
                again = self._reach(known[stream], ends[stream], beyond)
                if not (near[stream].enough and again.enough):
                    missing.add((stream, side))
        return missing

    def _reach(self, stamps: np.ndarray, is_end: bool, edge: int) -> _Reach:
        """Whether the frames before ``edge`` are known as far as it matters."""
        limit = edge - round(self._tolerance_s * 1e9)
        below = stamps[: np.searchsorted(stamps, edge)]
        if not len(below):
            return _Reach(is_end, edge)
        enough = is_end or below[0] < below[-1] or below[0] < limit
        return _Reach(bool(enough), max(int(below[-1]), limit))

    def _widen(self, bound: list[int], side: int, target: tuple[int, int], count: int) -> None:
        beside = 2 * abs(bound[side] - target[side]) or _BESIDE
        if beside > _MAX_BESIDE:
            problem = "colour and depth stamps are too far apart"
            raise RescanError(problem, path=self._path)
        if side:
            bound[1] = min(count, target[1] + beside)
        else:
            bound[0] = max(0, target[0] - beside)
