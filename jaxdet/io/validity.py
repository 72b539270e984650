"""Where in a log its calibration holds.

A log is computed with one calibration for each camera, the first that is one. A frame to which
another one belongs, by its stamp, can't be used: it gets the status ``bad_calibration``. Messages
of a camera that is not calibrated yet (K[0] = 0) say nothing.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from jaxdet.errors import FrameError, RescanError
from jaxdet.io.messages import CameraInfoMessage
from jaxdet.io.records import TopicMessages, read_message
from jaxdet.io.store import ChunkStore, Place

_MAX_VARIANTS = 16


class CalibrationChange(NamedTuple):
    """A calibration that differs from the one before it."""

    stamp_ns: int
    log_ns: int
    values: tuple[object, ...]
    """See :func:`values_of`."""


def values_of(info: CameraInfoMessage) -> tuple[object, ...] | None:
    """Return what must stay the same: size, lens model, D, K and P; None if not calibrated."""
    return None if info.K[:1] == (0.0,) else info[2:]


def says_other(info: CameraInfoMessage, used: CameraInfoMessage | None) -> bool:
    """Return whether a calibration contradicts the one that is used."""
    values = values_of(info)
    return used is not None and values is not None and values != values_of(used)


def other_calibration(
    stamps_ns: np.ndarray,
    changes: Sequence[CalibrationChange],
    used: CameraInfoMessage,
    by_log_time: bool,
) -> np.ndarray:
    """Return which frames have another calibration than the one that is used, ``(F,)`` bool.

    To a frame belongs the last calibration that is not later than it, else the first.

    Args:
        stamps_ns: ``(F,)`` int64, of the frames.
        changes: Of the camera's topic, in the order of the files.
        used: The calibration used.
        by_log_time: Whether the frames' stamps are log times.
    """
    known = sorted(changes, key=lambda item: item.log_ns if by_log_time else item.stamp_ns)
    if not known:
        return np.zeros(len(stamps_ns), bool)
    begin = np.array([item.log_ns if by_log_time else item.stamp_ns for item in known], np.int64)
    other = np.array([item.values != values_of(used) for item in known])
    return other[np.maximum(np.searchsorted(begin, stamps_ns, "right") - 1, 0)]


class CalibrationWindows:
    """Says to which frames another calibration belongs than the one that is used.

    Where only the first messages were read at opening, it makes sure, window by window, that the
    calibration never changes.

    Args:
        topics: The messages of the topics used, in the order of log time.
        used: The calibration of each that is used.
        store: The log's chunks.
        path: The log's, for errors.
        changes: All calibrations of the topic that describes depth, with the one used, where all
            messages were read; else None.
        by_log_time: Whether the frames' stamps are log times.
    """

    def __init__(
        self,
        topics: Sequence[TopicMessages],
        used: Mapping[str, CameraInfoMessage],
        store: ChunkStore,
        path: str,
        changes: Sequence[tuple[Sequence[CalibrationChange], CameraInfoMessage]] | None = None,
        *,
        by_log_time: bool = False,
    ) -> None:
        self._changes, self._by_log_time = changes, by_log_time
        self._topics, self._used = tuple(topics), dict(used)
        self._store, self._path = store, path
        self._good: set[tuple[str, bytes]] = set()
        """What follows the stamp in messages that were compared."""
        self._last: dict[str, int] = {}
        """The message of each topic before the end of the latest span: it was compared."""

    def other(self, stamps_ns: np.ndarray) -> np.ndarray | None:
        """Return which frames have another calibration by their stamps; None if none has."""
        found = None
        for changes, used in self._changes or ():
            other = other_calibration(stamps_ns, changes, used, self._by_log_time)
            found = other if found is None else found | other
        return found

    def check(self, begin: int | None, end: int | None) -> set[Place]:
        """Compare the messages of a span of log times, and the one before it, which holds there.

        Of a part of a log no other window may have looked at that one.

        Args:
            begin: Log time of the first, None = the log's.
            end: After the last, None = the log's.

        Returns:
            The chunks that were looked at.

        Raises:
            RescanError: A calibration is another one.
            DamageError: The file contradicts its index.
        """
        chunks: set[Place] = set()
        for topic in self._topics:
            own = topic.messages.between(begin, end)
            chunks |= topic.messages.chunks(own)
            if self._changes is not None:
                continue
            start, stop = own.start, own.stop
            known = self._last.get(topic.topic) == start - 1
            for number in range(start if known else max(0, start - 1), stop):
                self._compare(topic, number)
            self._last[topic.topic] = stop - 1
        return chunks

    def _compare(self, topic: TopicMessages, number: int) -> None:
        decoder = topic.decoder(number)
        _, payload = read_message(self._store, topic.messages, number)
        rest = topic.topic, decoder.after_stamp(payload)
        if rest in self._good:
            return
        try:
            message = decoder.decode(payload)
        except FrameError as error:
            problem = "a calibration can't be decoded"
            raise RescanError(problem, path=self._path, topic=topic.topic) from error
        assert isinstance(message, CameraInfoMessage)
        if says_other(message, self._used[topic.topic]):
            raise RescanError("the calibration changes", path=self._path, topic=topic.topic)
        if len(self._good) < _MAX_VARIANTS:
            self._good.add(rest)
