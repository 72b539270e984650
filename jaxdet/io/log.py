"""A log as frames: calibration, stamps, poses, and batches of decoded images."""

import math
from collections.abc import Callable, Iterator, Sequence
from types import TracebackType
from typing import NamedTuple, Self

import numpy as np

from jaxdet.errors import FrameStatus, InputError
from jaxdet.io.description import describe
from jaxdet.io.files import LogFiles, find_logs
from jaxdet.io.findings import Findings, find
from jaxdet.io.opening import OpenedFiles, open_files
from jaxdet.io.options import LogOptions
from jaxdet.io.reading import ImageReader
from jaxdet.types import Frames

_LINE_BYTES = 64


class Batch(NamedTuple):
    """Decoded frames, and what became of each."""

    frames: Frames
    """Padded to the batch size. Padding, unpaired and failed frames have zero images and
    ``valid`` False; padding has ``number`` and stamps -1."""
    status: tuple[FrameStatus, ...]
    """One for each colour frame asked for; at most the batch size."""
    errors: tuple[str, ...]
    """One line for each of them, empty where the status is OK."""


ImageMemory = Callable[[], tuple[np.ndarray, np.ndarray]]
"""Gives colour ``(B, H, W, 3)`` uint8 and depth ``(B, Hd, Wd)`` uint16 images to be written to."""


class Log:
    """A recorded log; use :func:`open_log`, and ``with`` to close it.

    Memory: an index of 64 bytes for an image, pose or transform; 64 MiB of decompressed chunks
    (or one chunk, if larger); and the images of the batch being read. It doesn't grow with the
    images. One thread may read at a time; threads of the log's own do the work, for each core one
    that loads and one that decodes. A log can be pickled: another process opens the files again,
    but doesn't read them through, and has one thread of each kind.

    Attributes:
        name: The log's name.
        calibration: Of the chosen topics.
        T_base_camera: ``(4, 4)`` float64, colour optical frame to the robot's base frame, whose
            z = 0 is the floor; None when the log's transforms don't hold it.
        base_frame: Name of that frame, or None.
        num_frames: Colour frames, all of them.
        stamps_ns: ``(F,)`` int64, colour header stamps [ns], in order.
        depth_stamp_ns: ``(F,)`` int64, stamp of the paired depth frame [ns], -1 = unpaired.
        statuses: Status of each frame before decoding: OK or UNPAIRED.
        T_world_camera: ``(F, 4, 4)`` float64, colour optical frame to world at each colour
            stamp, NaN where unknown; None when the log has no poses.
        description: What ``jaxdet info`` shows.
    """

    def __init__(
        self, files: LogFiles, opened: OpenedFiles, found: Findings, options: LogOptions
    ) -> None:
        self.name = files.name
        self.calibration = found.calibrated.calibration
        self.T_base_camera, self.base_frame = found.base.T_base_camera, found.base.frame
        self.stamps_ns, self.depth_stamp_ns = found.stamps_ns, found.depth_stamps_ns
        self.num_frames = len(self.stamps_ns)
        paired = found.timeline.pairing.depth_of_color >= 0
        self.statuses = [FrameStatus.OK if yes else FrameStatus.UNPAIRED for yes in paired]
        self.T_world_camera = found.poses.T_world_camera
        self.description = describe(files, opened.contents, found, options.pair_tolerance_s)
        self._depth_size = found.calibrated.depth_size
        self._files, self._tolerance_s = opened.files, options.pair_tolerance_s
        self._reader = ImageReader(
            opened.files,
            opened.contents.streams[found.choice.color],
            opened.contents.streams[found.choice.depth],
            found.timeline,
            self.calibration.depth_unit,
            options.max_pixels,
        )

    def __enter__(self) -> Self:
        """The log itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Closes the log."""
        self.close()

    def close(self) -> None:
        """Closes the files and stops the decoding threads."""
        self._reader.close()
        for file in self._files:
            file.close()

    @property
    def image_shapes(self) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Shapes of a colour image, ``(H, W, 3)``, and of a depth image, ``(Hd, Wd)``."""
        color, depth = self.calibration.color, self._depth_size
        return (color.height, color.width, 3), (depth.height, depth.width)

    def batches(
        self,
        batch_size: int,
        start: int = 0,
        stop: int | None = None,
        images: ImageMemory | None = None,
    ) -> Iterator[Batch]:
        """The frames ``start`` to ``stop`` (default: all) in batches, in order.

        Args:
            batch_size: Frames of each batch; the last is padded.
            start: First frame.
            stop: The frame after the last.
            images: Where to decode to; by default new arrays.

        Raises:
            ValueError: ``batch_size`` is below 1, or the range leaves the log.
        """
        stop = self.num_frames if stop is None else stop
        if batch_size < 1 or not 0 <= start <= stop <= self.num_frames:
            raise ValueError(f"batches of {batch_size}, frames {start} to {stop}")
        for first in range(start, stop, batch_size):
            memory = images() if images else None
            yield self._batch(range(first, min(first + batch_size, stop)), batch_size, memory)

    def read(self, indices: Sequence[int]) -> Batch:
        """The frames of these numbers, in the order given, without padding.

        Raises:
            IndexError: A number is not of the log.
        """
        if not all(0 <= index < self.num_frames for index in indices):
            raise IndexError(f"frames {list(indices)[:20]} of {self.num_frames}")
        return self._batch(indices, len(indices))

    def _batch(
        self,
        indices: Sequence[int],
        size: int,
        memory: tuple[np.ndarray, np.ndarray] | None = None,
    ) -> Batch:
        count = len(indices)
        wanted = [i if self.statuses[i] is FrameStatus.OK else -1 for i in indices]
        if memory is None:
            color, depth = self.image_shapes
            memory = _blank((size, *color), np.uint8), _blank((size, *depth), np.uint16)
        else:
            empty = [*np.flatnonzero(np.array(wanted, np.int64) < 0), *range(count, size)]
            for images in memory:
                images[empty] = 0
        color_images, depth_images = memory
        failures = self._reader.read(wanted, color_images, depth_images)
        status, errors = [], []
        for index, failure in zip(indices, failures, strict=True):
            before = self.statuses[index]
            status.append(failure.status if failure else before)
            unpaired = f"no depth frame within {self._tolerance_s:g} s"
            text = str(failure) if failure else unpaired if before is not FrameStatus.OK else ""
            errors.append(" ".join(text.split()))
        valid = np.zeros(size, bool)
        valid[:count] = [item is FrameStatus.OK for item in status]
        frames = Frames(
            color=color_images,
            depth=depth_images,
            calibration=self.calibration,
            number=_padded(np.array(indices, np.int64), size),
            stamp_ns=_padded(self.stamps_ns[list(indices)], size),
            depth_stamp_ns=_padded(self.depth_stamp_ns[list(indices)], size),
            valid=valid,
            T_world_camera=self._poses(indices, size),
        )
        return Batch(frames, tuple(status), tuple(errors))

    def _poses(self, indices: Sequence[int], size: int) -> np.ndarray | None:
        if self.T_world_camera is None:
            return None
        poses = np.full((size, 4, 4), np.nan)
        poses[: len(indices)] = self.T_world_camera[list(indices)]
        return poses


def open_log(source: str | LogFiles, options: LogOptions | None = None) -> Log:
    """Opens a log: reads all its files once and finds everything but the images.

    Args:
        source: A file, a folder or a glob with exactly one log, or one of :func:`find_logs`.
        options: What the user says about the log; default: nothing.

    Raises:
        InputError: No file can be read, or there are several logs.
        TopicError: No or several topics can be colour or depth.
        CalibrationError: A part of the calibration is missing, unknown or contradictory.
    """
    options = options or LogOptions()
    if isinstance(source, str):
        logs = find_logs([source])
        if len(logs) > 1:
            problem, remedy = f"there are {len(logs)} logs here", "name one of them"
            raise InputError(problem, path=source, remedy=remedy)
        source = logs[0]
    opened = open_files(source, options)
    try:
        found = find(opened.contents, options, str(source.paths[0]))
        return Log(source, opened, found, options)
    except BaseException:
        opened.close()
        raise


def _blank(shape: tuple[int, ...], kind: type[np.unsignedinteger]) -> np.ndarray:
    """Zeros that begin with a cache line; XLA copies arrays that don't."""
    nbytes = math.prod(shape) * np.dtype(kind).itemsize
    memory = np.zeros(nbytes + _LINE_BYTES, np.uint8)
    start = -memory.ctypes.data % _LINE_BYTES
    return memory[start : start + nbytes].view(kind).reshape(shape)


def _padded(values: np.ndarray, size: int) -> np.ndarray:
    result = np.full(size, -1, np.int64)
    result[: len(values)] = values
    return result
