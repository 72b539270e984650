"""The frames of a log by its index: only the messages about the frames asked for are looked at.

A frame's number is its rank by header stamp. A stream's messages are nearly in this order
already: it is checked that no two that are ``REACH`` or more messages apart (by log time) are in
the wrong order, so that ranks follow from messages near by. It is enough to compare messages
``REACH`` to ``2 REACH - 1`` apart: of two in the wrong order that are farther apart, one in
between is in the wrong order with one of them. Both are known to the window that holds the message
``REACH`` after the first of them, and each message of a log belongs to one window of any division
of its frames. So whoever reads all frames either gets the ranks of a whole scan or an error.
"""

from itertools import groupby
from typing import NamedTuple

import numpy as np

from jaxdet.errors import FrameError, RescanError
from jaxdet.io.chunks import PAYLOAD_OFFSET
from jaxdet.io.contents import image_stamps
from jaxdet.io.messages import Kind
from jaxdet.io.motion_windows import MotionWindows
from jaxdet.io.notes import Notes, StreamNotes
from jaxdet.io.pairing import pair
from jaxdet.io.poses import PoseSource
from jaxdet.io.records import TopicMessages, read_message
from jaxdet.io.store import ChunkStore, Place
from jaxdet.io.timeline import FrameTable, Window, apart
from jaxdet.io.validity import CalibrationWindows

REACH = 4
"""Messages this far apart by log time are in the order of their stamps."""
_LOOKS = 64
"""Messages whose stamps are looked at before a part is taken."""
_BESIDE = 2
"""Frames looked at to either side, at first."""
_MAX_BESIDE = 4096
_STAMP_BYTES = 64
"""Of a payload, enough for a stamp that leads."""


class StreamWindows:
    """The messages of one image topic; stamps are read when they are asked for.

    Args:
        found: The messages, in the order of the files.
        store: The log's chunks.
        path: The log's, for errors.

    Attributes:
        messages: The messages in the order of log time, then of arrival.
        backward: How many come after one with a later log time in the files.
    """

    def __init__(self, found: TopicMessages, store: ChunkStore, path: str) -> None:
        self.topic, self.decoders = found.topic, found.decoders
        self.messages = found.in_time().messages
        self.backward = int((np.diff(found.messages.log_ns) < 0).sum())
        self.store, self._path = store, path
        count = found.num_messages
        self.stamp, self.depth_stamp, self.size = (np.full(count, -1, np.int64) for _ in range(3))
        self._undecodable = np.zeros(count, bool)

    def __len__(self) -> int:
        return len(self.stamp)

    def check_clock(self) -> None:
        """Sees whether stamps follow log times, by some messages spread over the log.

        A clock that steps changes how far stamps are from log times, for all that comes after.
        Where that differs by as much as messages in another order may be apart, all are looked at.

        Raises:
            RescanError: Messages are too far from the order of their stamps.
            DamageError: One of them is not where the index says.
        """
        times = self.messages.log_ns
        some = np.unique(np.linspace(0, len(self) - 1, min(_LOOKS, len(self))).astype(np.int64))
        self._load(some)
        apart = self.stamp[some] - times[some]
        if len(some) and np.ptp(apart) > REACH * int(times[-1] - times[0]) / len(self):
            self.ranked(0, len(self))

    def ranked(self, first: int, last: int) -> np.ndarray:
        """The messages of the frames ``first`` to ``last``.

        Raises:
            RescanError: Messages are too far from the order of their stamps.
            DamageError: One of them is not where the index says.
        """
        start, stop = max(0, first - REACH), min(len(self), last + REACH)
        self._load(np.arange(start, stop))
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

    def table(self, numbers: np.ndarray, depth: bool = False) -> FrameTable:
        """Messages of some numbers; of -1 one with a stamp of -1."""
        messages = self.messages
        stamps = (self.depth_stamp if depth else self.stamp)[numbers]
        columns = messages.position, messages.offset + PAYLOAD_OFFSET, self.size
        place = np.stack([column[numbers] for column in columns], axis=1)
        stamps = np.where(numbers < 0, -1, stamps)
        of = messages.file[numbers], messages.decoder[numbers]
        return FrameTable(stamps, *of, place, messages.log_ns[numbers])

    def _load(self, numbers: np.ndarray) -> None:
        """Reads the stamps of messages that aren't known yet."""
        missing = numbers[self.size[numbers] < 0]
        if not len(missing):
            return
        places = self.messages.places(missing)
        parts = {
            place: [number for _, number in group]
            for place, group in groupby(
                sorted(zip(places, missing.tolist(), strict=True)), lambda item: item[0]
            )
        }
        for place in self.store.loaded(parts):
            for number in parts[place]:
                self._read(number)

    def _read(self, number: int) -> None:
        decoder = self.decoders[self.messages.decoder[number]]
        leads = decoder.stamp_leads and decoder.kind is not Kind.RGBD
        size, payload = read_message(
            self.store, self.messages, number, _STAMP_BYTES if leads else None
        )
        if leads and not decoder.reads_stamp(payload):
            size, payload = read_message(self.store, self.messages, number)
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


class _Part:
    """Some frames of a stream, of which the messages are wanted, and those known beside them.

    Args:
        stream: The stream.
        first: The first one wanted.
        last: The one after the last.
    """

    def __init__(self, stream: StreamWindows, first: int, last: int) -> None:
        self._stream, self._first, self._last = stream, first, last
        self._beside = [_BESIDE, _BESIDE]
        self._look()

    def _look(self) -> None:
        self._begin = max(0, self._first - self._beside[0])
        self._end = min(len(self._stream), self._last + self._beside[1])
        self.ranked = self._stream.ranked(self._begin, self._end)
        """The messages of all frames that are known."""
        self.stamps_ns = self._stream.stamp[self.ranked]

    @property
    def wanted(self) -> slice:
        """The frames wanted, among those known."""
        return slice(self._first - self._begin, self._last - self._begin)

    def is_end(self, side: int) -> bool:
        """Whether the stream ends to a side: 0 at the first frame known, 1 at the last."""
        return self._end == len(self._stream) if side else self._begin == 0

    def widen(self, side: int) -> bool:
        """Looks at twice as many to a side; False where that would be too many."""
        self._beside[side] *= 2
        if self._beside[side] > _MAX_BESIDE:
            return False
        self._look()
        return True

    def notes(self) -> StreamNotes:
        """What is odd of those wanted."""
        before = max(self._first - 1, 0) - self._begin
        ranked = self.ranked[before : self._last - self._begin]
        return self._stream.notes(self._first, self._last, ranked)

    def chunks(self) -> set[Place]:
        """The chunks of as many messages, in the order of log times."""
        return self._stream.messages.chunks(slice(self._first, self._last))


class IndexedFrames(NamedTuple):
    """The frames of a log by its index."""

    color: StreamWindows
    depth: StreamWindows
    """The same object for RGBD messages."""
    motions: MotionWindows
    """Transforms and poses."""
    source: PoseSource
    """Where the poses come from."""
    tolerance_s: float
    """The pairing's [s]."""
    path: str
    """The log's, for errors."""
    calibrations: CalibrationWindows | None = None
    """What must not change; None: not looked at."""

    @property
    def num_frames(self) -> int:
        """Colour frames."""
        return len(self.color)

    def about_ns(self) -> np.ndarray:
        """``(F,)`` int64, log times of the colour messages, in order [ns].

        Raises:
            RescanError: The stamps of some images are far from the order of these.
            DamageError: The file contradicts its index.
        """
        for stream in (self.depth, self.color):
            stream.check_clock()
        return self.color.messages.log_ns

    def is_plain(self, number: int) -> bool:
        """Whether the chunk of a frame isn't packed, so that its messages can be read alone.

        Raises:
            DamageError: There is no such chunk.
        """
        (place,) = self.color.messages.places(slice(number, number + 1))
        return place.position < 0 or self.color.store.head(place).is_plain

    def stamp_ns(self, number: int) -> int:
        """The stamp of a frame [ns].

        Raises:
            RescanError: The index doesn't tell.
            DamageError: The file contradicts its index.
        """
        return int(self.color.stamp[self.color.ranked(number, number + 1)[0]])

    def window(self, start: int, stop: int) -> Window:
        """The frames ``start`` to ``stop``.

        Raises:
            RescanError: The index doesn't tell.
            DamageError: The file contradicts its index.
        """
        if self.color is self.depth:
            return self._pairs_by_message(start, stop)
        color = _Part(self.color, start, stop)
        depth = _Part(self.depth, *self._beside(start, stop))
        while missing := self._missing(color, depth):
            for part, side in missing:
                if not part.widen(side):
                    problem = "colour and depth stamps are too far apart"
                    raise RescanError(problem, path=self.path)
        pairing = pair(color.stamps_ns, depth.stamps_ns, self.tolerance_s)
        partner = pairing.depth_of_color[color.wanted]
        messages = np.append(depth.ranked, -1)[partner]
        own, others = self.color.table(color.ranked[color.wanted]), self.depth.table(messages)
        alone = np.zeros(len(depth.ranked), bool)
        alone[pairing.unpaired_depth] = True
        notes = Notes(
            color.notes(),
            depth.notes(),
            *apart(own, others),
            depth.stamps_ns[depth.wanted][alone[depth.wanted]],
        )
        chunks = color.chunks() | depth.chunks()
        return self._with_poses(Window(own, others, None, notes), chunks, start, stop)

    def _beside(self, start: int, stop: int) -> tuple[int, int]:
        """The depth messages that the window of some colour frames answers for, by log time."""
        log_ns, depth_ns = self.color.messages.log_ns, self.depth.messages.log_ns
        first = int(np.searchsorted(depth_ns, log_ns[start])) if start else 0
        if stop == len(self.color):
            return first, len(depth_ns)
        return first, int(np.searchsorted(depth_ns, log_ns[stop]))

    def _pairs_by_message(self, start: int, stop: int) -> Window:
        part = _Part(self.color, start, stop)
        numbers = part.ranked[part.wanted]
        color, depth = self.color.table(numbers), self.color.table(numbers, True)
        notes = Notes(part.notes(), StreamNotes(), *apart(color, depth))
        window = Window(color, depth, None, notes)
        return self._with_poses(window, part.chunks(), start, stop)

    def _with_poses(self, window: Window, chunks: set[Place], start: int, stop: int) -> Window:
        log_ns = self.color.messages.log_ns
        begin = int(log_ns[start]) if start else None
        end = int(log_ns[stop]) if stop < len(self.color) else None
        T, more = self.motions.window(self.source, window.color.stamps_ns, begin, end)
        if self.calibrations:
            more = more | self.calibrations.check(begin, end)
        poses = 0 if T is None else int(np.isfinite(T[:, 0, 0]).sum())
        return window._replace(
            T_world_camera=T,
            notes=window.notes._replace(poses=poses),
            chunks=tuple(sorted(chunks | more)),
        )

    def _missing(self, color: _Part, depth: _Part) -> list[tuple[_Part, int]]:
        """What must be looked at further to which side (0, 1), for pairs that are certain.

        A frame's partner is the nearest of the other stream, and has that frame as its nearest:
        so the next frames of the other stream must be known, and what is next to those; or
        anything beyond the tolerance.
        """
        parts, missing = (color, depth), []
        both = np.concatenate([part.stamps_ns[part.wanted] for part in parts])
        for side, sign in enumerate((1, -1)):
            edge = int((sign * both).min())
            near = [self._reach(part, side, edge) for part in parts]
            for part, own, other in zip(parts, near, near[::-1], strict=True):
                again = self._reach(part, side, min(edge, other.nearest))
                if not (own.enough and again.enough):
                    missing.append((part, side))
        return missing

    def _reach(self, part: _Part, side: int, edge: int) -> _Reach:
        """Whether frames beyond ``edge`` are known as far as it matters; side 1 is negated."""
        stamps = -part.stamps_ns[::-1] if side else part.stamps_ns
        limit = edge - round(self.tolerance_s * 1e9)
        below = stamps[: np.searchsorted(stamps, edge)]
        if not len(below):
            return _Reach(part.is_end(side), edge)
        # Of the outermost stamp there may be more frames.
        enough = part.is_end(side) or below[0] < below[-1] or below[0] < limit
        return _Reach(bool(enough), max(int(below[-1]), limit))
