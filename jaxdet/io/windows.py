"""Access to the frames of a log by the index of its files.

The number of a frame is the rank of its depth image by header timestamp. If all timestamps have
been read, the ranks follow from them. Otherwise only messages near the requested frames are read,
since the messages of a stream are nearly in order of timestamps. It is checked that no two messages
that are ``REACH`` or more apart (by log time) are in the wrong order; then ranks follow from nearby
messages. It is sufficient to compare messages ``REACH`` to ``2 REACH - 1`` apart: of two messages
in the wrong order that are farther apart, one in between is in the wrong order with one of them.
The window with the message ``REACH`` after the first of the two reads both, and each message of a
log belongs to one window of any division of its frames. Reading all frames thus yields either the
correct ranks or an error.

The timestamps of colour images are read even if colour is not decoded. In an uncompressed chunk
this takes 64 bytes per message (0.02 ms). A large compressed chunk is decompressed only at its
start if the message is there (0.1 ms instead of 1 ms), otherwise completely, as is necessary for
depth anyway. Chunks that contain only colour are checked against their CRC only if colour is
decoded.
"""

from copy import copy
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from jaxdet.errors import FrameError, RescanError
from jaxdet.io.chunks import PAYLOAD_OFFSET
from jaxdet.io.clocks import MIN_STEP_NS, jumps
from jaxdet.io.contents import image_stamps
from jaxdet.io.file_index import Place
from jaxdet.io.messages import Kind
from jaxdet.io.motion_windows import MotionWindows
from jaxdet.io.poses import PoseSource
from jaxdet.io.records import TopicMessages, read_message, rows_in_file_order
from jaxdet.io.store import BEGIN_BYTES, ChunkStore
from jaxdet.io.timeline import FrameTable, Notes, StreamNotes, Window, apart, nearest
from jaxdet.io.validity import CalibrationWindows

REACH = 4
"""Minimum distance, in messages by log time, at which the order of timestamps is checked."""
_LOOKS = 64
"""Number of messages whose timestamps are read before a part of a log is selected."""
_BESIDE = 2
"""Initial number of extra colour images on each side of a window."""
_MAX_BESIDE = 4096
_STAMP_BYTES = 64
"""Number of bytes of a payload that contain a leading timestamp."""


class StreamWindows:
    """Messages of an image topic; timestamps are read on demand, or all at opening.

    Args:
        found: Messages in file order.
        store: Chunks of the log.
        path: Path of the log, for errors.

    Attributes:
        messages: Messages in order of log time, then of arrival.
        backward: Number of messages that follow a message with a later log time in the files.
        whole: Whether compressed chunks are decompressed completely for timestamps, or only their
            start if possible.
        stamp: Header timestamps, of RGBD those of depth, ``(N,)`` int64 [ns]; -1 if not read.
        color_stamp: Like ``stamp``, but of RGBD messages the timestamps of colour.
        size: Payload sizes, ``(N,)`` int64 [byte]; -1 if a message has not been read.
    """

    def __init__(self, found: TopicMessages, store: ChunkStore, path: str) -> None:
        self.topic, self.decoders = found.topic, found.decoders
        self._arrival = np.argsort(found.messages.log_ns, kind="stable")
        self.messages = found.messages.rows(self._arrival)
        self.backward = int((np.diff(found.messages.log_ns) < 0).sum())
        self.store, self._path, self.whole = store, path, True
        self._order: np.ndarray | None = None
        count = found.num_messages
        self.stamp, self.color_stamp, self.size = (np.full(count, -1, np.int64) for _ in range(3))
        self._undecodable = np.zeros(count, bool)

    def __len__(self) -> int:
        return len(self.stamp)

    @property
    def is_rgbd(self) -> bool:
        """Whether a message contains a depth and a colour image."""
        return self.decoders[0].kind is Kind.RGBD

    @property
    def is_complete(self) -> bool:
        """Whether all timestamps were read at opening."""
        return self._order is not None

    def in_file_order(self) -> np.ndarray:
        """Return the numbers of the messages in file order, ``(N,)`` int64."""
        return np.argsort(self._arrival)

    def read(self, number: int) -> str:
        """Read the timestamps of a message; return why it can't be decoded, else an empty string.

        Raises:
            DamageError: The message is not at its position in the index.
        """
        decoder = self.decoders[self.messages.decoder[number]]
        leads = decoder.stamp_leads and decoder.kind is not Kind.RGBD
        size, payload = read_message(
            self.store,
            self.messages,
            number,
            _STAMP_BYTES if leads else None,
            whole=self.whole,
        )
        if leads and not decoder.reads_stamp(payload):
            size, payload = read_message(self.store, self.messages, number)
        problem = ""
        try:
            stamps = image_stamps(decoder, payload)
        except FrameError as error:
            stamps, problem = (int(self.messages.log_ns[number]),) * 2, error.problem
        self.stamp[number], self.color_stamp[number] = stamps
        self.size[number] = size
        return problem

    def lose(self, number: int) -> None:
        """Treat an unreadable message as an image with its log time as timestamp."""
        self.stamp[number] = self.color_stamp[number] = self.messages.log_ns[number]
        self.size[number] = 0

    def keep(self, which: np.ndarray) -> None:
        """Keep the messages selected by ``(N,)`` bool."""
        self.messages, self._arrival = self.messages.rows(which), self._arrival[which]
        self.backward = int((np.diff(self.messages.log_ns[self.in_file_order()]) < 0).sum())
        self.stamp, self.color_stamp, self.size, self._undecodable = (
            column[which] for column in (self.stamp, self.color_stamp, self.size, self._undecodable)
        )

    def complete(self, stamps_ns: np.ndarray) -> "StreamWindows":
        """Return a copy with the order of the messages, after all timestamps have been read.

        Args:
            stamps_ns: Timestamps that replace those of the messages, ``(N,)`` int64 [ns].
        """
        found = copy(self)
        found.stamp = stamps_ns
        found.color_stamp = stamps_ns + (self.color_stamp - self.stamp) * (self.stamp > 0)
        found._order = np.argsort(found.stamp, kind="stable")
        return found

    def between(self, first_ns: int, last_ns: int) -> np.ndarray:
        """Return the messages in a range of timestamps, in order, with one more on both sides."""
        assert self._order is not None
        ends = np.searchsorted(self.stamp, [first_ns, last_ns + 1], sorter=self._order)
        return self._order[max(0, int(ends[0]) - 1) : int(ends[1]) + 1]

    def check_clock(self, looks: int = 2) -> None:
        """Check on a sample of messages that neither the topic's clock nor the recorder's jumps.

        If a clock is adjusted, the delays, i.e. timestamp minus log time, of all later messages
        change; the adjustment between two messages of the sample is found by bisection.

        Args:
            looks: Number of messages in the sample.

        Raises:
            RescanError: A clock was adjusted.
            DamageError: A message is not at its position in the index.
        """
        if self.is_complete:
            return
        times = self.messages.log_ns

        def change(ends: tuple[int, int]) -> int:
            self._load(np.array(ends))
            first, last = (int(self.stamp[n] - times[n]) for n in ends)
            return abs(last - first)

        some = np.linspace(0, len(self) - 1, min(looks, len(self))).astype(np.int64)
        is_adjusted = bool(jumps(times[self.in_file_order()]).any())
        for ends in pairwise(some.tolist()):
            while change(ends) > MIN_STEP_NS and ends[1] - ends[0] > 1:
                middle = sum(ends) // 2
                ends = max((ends[0], middle), (middle, ends[1]), key=change)
            is_adjusted |= change(ends) > MIN_STEP_NS
        if is_adjusted:
            problem = "a clock was adjusted during the recording"
            raise RescanError(problem, path=self._path, topic=self.topic)

    def ranked(self, first: int, last: int) -> np.ndarray:
        """Return the messages of the frames from ``first`` to ``last``, exclusive.

        Raises:
            RescanError: The messages are too far from the order of their timestamps, or an image
                may occur twice.
            DamageError: A message is not at its position in the index.
        """
        if self._order is not None:
            return self._order[first:last]
        start, stop = max(0, first - REACH), min(len(self), last + REACH)
        self._load(np.arange(start, stop))
        stamps = self.stamp[start:stop]
        if len(stamps) > REACH:
            latest = np.maximum.accumulate(stamps[:-REACH])
            if (stamps[REACH:] < latest).any():
                problem = "header timestamps are far from the order of log times"
                raise RescanError(problem, path=self._path, topic=self.topic)
        order = start + np.argsort(stamps, kind="stable")
        same = (np.diff(self.stamp[order]) == 0) & (np.diff(self.size[order]) == 0)
        if (same & (self.stamp[order[1:]] > 0)).any():
            raise RescanError("images may occur twice", path=self._path, topic=self.topic)
        return order[first - start : last - start]

    def notes(self, first: int, last: int, ranked: np.ndarray) -> StreamNotes:
        """Count irregularities of the messages and frames from ``first`` to ``last``, exclusive.

        Args:
            first: First message; the timestamps must have been read.
            last: Message after the last one.
            ranked: Messages of the frames ``first - 1`` (if it exists) to ``last``.
        """
        stamps = self.stamp[max(first - 1, 0) : last]
        return StreamNotes(
            backward=int((np.diff(stamps) < 0).sum()),
            double=int((np.diff(self.stamp[ranked]) == 0).sum()),
            undecodable=int(self._undecodable[first:last].sum()),
        )

    def table(self, numbers: np.ndarray, color: bool = False) -> FrameTable:
        """Return a table of messages by number; the number -1 means no image."""
        stamps = (self.color_stamp if color else self.stamp)[numbers]
        stamps = np.where(numbers < 0, -1, stamps)
        return FrameTable(stamps, self.size[numbers], self.messages.rows(numbers))

    def _load(self, numbers: np.ndarray) -> None:
        """Read the timestamps of those messages that have not been read yet."""
        missing = numbers[self.size[numbers] < 0]
        if not len(missing):
            return
        if not self.whole:  # messages are read one by one
            near = self.messages.offset[missing] < BEGIN_BYTES - PAYLOAD_OFFSET - _STAMP_BYTES
            for number in missing[near].tolist():
                self._look(number)
            missing = missing[~near]
        for row in rows_in_file_order(self.store, self.messages.rows(missing)):
            self._look(int(missing[row]))

    def _look(self, number: int) -> None:
        self._undecodable[number] = bool(self.read(number))


class IndexedFrames(NamedTuple):
    """Images, poses and calibrations of the frames of a log, read by its index."""

    depth: StreamWindows
    color: StreamWindows | None
    """Colour messages, the same object as depth for RGBD; None if the log has no colour."""
    motions: MotionWindows
    """Transforms and poses."""
    source: PoseSource
    """Source of the poses."""
    tolerance_s: float
    """Maximum time between a colour image and its frame [s]."""
    path: str
    """Path of the log, for errors."""
    calibrations: CalibrationWindows | None = None
    """Calibration of each frame; None: not checked."""
    color_offset_ns: int = 0
    """Offset of colour's clock relative to depth [ns]."""
    by_log_time: bool = False
    """Whether colour is paired by log time, since header timestamps are zero."""

    @property
    def num_frames(self) -> int:
        """Number of depth images."""
        return len(self.depth)

    def check_clocks(self) -> None:
        """Check the clocks of depth and colour, see :meth:`StreamWindows.check_clock`."""
        for stream in (self.depth, self.color):
            if stream is not None:
                stream.check_clock(_LOOKS)

    def is_plain(self, number: int) -> bool:
        """Return whether a frame's chunk is uncompressed, so that messages can be read separately.

        Raises:
            DamageError: There is no such chunk.
        """
        (place,) = self.depth.messages.places(slice(number, number + 1))
        return self.depth.store.head(place).is_plain

    def stamp_ns(self, number: int) -> int:
        """Return the timestamp of a frame [ns].

        Raises:
            RescanError: The index is not sufficient.
            DamageError: The file contradicts its index.
        """
        return int(self.depth.stamp[self.depth.ranked(number, number + 1)[0]])

    def window(self, start: int, stop: int) -> Window:
        """Return the frames from ``start`` to ``stop``, exclusive.

        Raises:
            RescanError: The index is not sufficient.
            DamageError: The file contradicts its index.
        """
        before = max(start - 1, 0)
        ranked = self.depth.ranked(before, stop)
        numbers = ranked[start - before :]
        own = self.depth.table(numbers)
        color, of_color = None, set()
        if self.color is self.depth:
            color = self.depth.table(numbers, color=True)
        elif self.color is not None:
            stamps_ns = own.log_ns if self.by_log_time else own.stamps_ns + self.color_offset_ns
            color, of_color = self._colors(self.color, stamps_ns, start, stop)
        log_ns = self.depth.messages.log_ns
        begin = int(log_ns[start]) if start else None
        end = int(log_ns[stop]) if stop < len(self.depth) else None
        stamps_ns = own.stamps_ns + self.source.offset_ns
        T, chunks = self.motions.window(self.source, stamps_ns, begin, end)
        other = None
        if self.calibrations:
            chunks = chunks | self.calibrations.check(begin, end)
            other = self.calibrations.other(own.stamps_ns)
        chunks = chunks | self.depth.messages.chunks(slice(start, stop))
        poses = 0 if T is None else int(np.isfinite(T[:, 0, 0]).sum())
        notes = Notes(
            self.depth.notes(start, stop, ranked), *apart(own, color, self.color_offset_ns), poses
        )
        of_all, of_color = tuple(sorted(chunks)), tuple(sorted(of_color - chunks))
        return Window(own, color, T, notes, other, of_all, of_color)

    def _colors(
        self, color: StreamWindows, stamps_ns: np.ndarray, start: int, stop: int
    ) -> tuple[FrameTable, set[Place]]:
        """Return the nearest colour images of some frames, and the chunks to check for them.

        If not all timestamps are known, all messages between the frames by log time are read, so
        that each message of a log is read in some window, and then further messages until no other
        image can be nearer.
        """
        own_ns, log_ns, count = self.depth.messages.log_ns, color.messages.log_ns, len(color)
        first = int(np.searchsorted(log_ns, own_ns[start])) if start else 0
        last = int(np.searchsorted(log_ns, own_ns[stop])) if stop < len(own_ns) else count
        slack, of_color = round(self.tolerance_s * 1e9), color.messages.chunks(slice(first, last))
        if color.is_complete:
            ranked = color.between(int(stamps_ns.min()) - slack, int(stamps_ns.max()) + slack)
            near = nearest(stamps_ns, color.stamp[ranked], self.tolerance_s)
            return color.table(np.append(ranked, -1)[near]), of_color
        low = int(stamps_ns[0]) - slack
        beside = [_BESIDE, _BESIDE]
        while True:
            begin, end = max(0, first - beside[0]), min(count, last + beside[1])
            ranked = color.ranked(begin, end)
            found = color.stamp[ranked]
            earlier = found[found <= stamps_ns[0]]
            # More images may have the same timestamp as the outermost one.
            enough = (
                begin == 0 or found[0] < low or bool(len(earlier) and earlier[-1] > found[0]),
                end == count or found[-1] >= stamps_ns[-1],
            )
            if all(enough):
                break
            beside = [n if known else 2 * n for n, known in zip(beside, enough, strict=True)]
            if max(beside) > _MAX_BESIDE:
                problem = "timestamps of colour and depth are too far apart"
                raise RescanError(problem, path=self.path)
        numbers = np.append(ranked, -1)[nearest(stamps_ns, found, self.tolerance_s)]
        return color.table(numbers), of_color
