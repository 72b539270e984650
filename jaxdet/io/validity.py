"""Validity of the calibration over the frames of a log.

All frames of a camera are processed with the same calibration, the first valid one. Frames with
another calibration, according to their timestamp, get the status ``bad_calibration``. Messages of
an uncalibrated camera (K[0] = P[0] = 0) are ignored.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from jaxdet.errors import FrameError, RescanError
from jaxdet.io.file_index import Place
from jaxdet.io.messages import CameraInfoMessage
from jaxdet.io.records import TopicMessages, read_message
from jaxdet.io.store import ChunkStore

_MAX_VARIANTS = 16


class CalibrationChange(NamedTuple):
    """A calibration that differs from the previous one."""

    stamp_ns: int
    log_ns: int
    values: tuple[object, ...]
    """New values of the calibration, in the order of :func:`values_of`."""


def values_of(info: CameraInfoMessage) -> tuple[object, ...] | None:
    """Return the values that must not change: size, lens model, D, K, P; None if not calibrated."""
    return None if info.K[:1] == (0.0,) and not any(info.P[:1]) else info[2:]


def says_other(info: CameraInfoMessage, used: CameraInfoMessage | None) -> bool:
    """Return whether a calibration contradicts the calibration in use."""
    values = values_of(info)
    return used is not None and values is not None and values != values_of(used)


def other_calibration(
    stamps_ns: np.ndarray,
    changes: Sequence[CalibrationChange],
    used: CameraInfoMessage,
    by_log_time: bool,
) -> np.ndarray:
    """Return which frames have a calibration that differs from that in use, ``(F,)`` bool.

    A frame has the last calibration that is not later than the frame, or else the first one.

    Args:
        stamps_ns: Timestamps of the frames, ``(F,)`` int64 [ns].
        changes: Changes on the camera's topic, in file order; at least one.
        used: Calibration in use.
        by_log_time: Whether the timestamps of the frames are log times.
    """
    known = sorted(changes, key=lambda item: item.log_ns if by_log_time else item.stamp_ns)
    begin = np.array([item.log_ns if by_log_time else item.stamp_ns for item in known], np.int64)
    other = np.array([item.values != values_of(used) for item in known])
    return other[np.maximum(np.searchsorted(begin, stamps_ns, "right") - 1, 0)]


class CalibrationWindows:
    """Determines the frames whose calibration differs from the calibration in use.

    If only the first messages were read at opening, each window checks that the calibration does
    not change.

    Args:
        topics: Messages of the calibration topics in use, in order of log time.
        used: Calibration in use by topic.
        store: Chunks of the log.
        path: Path of the log, for errors.
        of_depth: Topic with the calibration of depth; empty if there is none.
        changes: Changes on that topic, if all messages were read; otherwise None.
        by_log_time: Whether the timestamps of the frames are log times.
    """

    def __init__(
        self,
        topics: Sequence[TopicMessages],
        used: Mapping[str, CameraInfoMessage],
        store: ChunkStore,
        path: str,
        of_depth: str,
        changes: Sequence[CalibrationChange] | None,
        *,
        by_log_time: bool,
    ) -> None:
        self._of_depth, self._changes, self._by_log_time = of_depth, changes, by_log_time
        self._topics, self._used = tuple(topics), dict(used)
        self._store, self._path = store, path
        self._good: set[tuple[str, bytes]] = set()
        """Topics and contents, without timestamps, of messages that were compared."""

    def other(self, stamps_ns: np.ndarray) -> np.ndarray | None:
        """Return which frames have another calibration; None: no changes, or not all were read."""
        if not self._changes:
            return None
        used = self._used[self._of_depth]
        return other_calibration(stamps_ns, self._changes, used, self._by_log_time)

    def check(self, begin: int | None, end: int | None) -> set[Place]:
        """Compare the calibrations in a range of log times with those in use.

        The last message before the range is compared as well: if only a part of a log is read, no
        other window contains it.

        Args:
            begin: Log time of the first message; None: the start of the log.
            end: Log time after the last message; None: the end of the log.

        Returns:
            Chunks that were read.

        Raises:
            RescanError: A calibration differs.
            DamageError: The file contradicts its index.
        """
        chunks: set[Place] = set()
        for topic in self._topics:
            own = topic.messages.between(begin, end)
            chunks |= topic.messages.chunks(own)
            if self._changes is not None:
                continue
            for number in range(max(0, own.start - 1), own.stop):
                self._compare(topic, number)
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
