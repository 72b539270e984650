"""A log with its calibration, timestamps and poses, which reads its frames in batches."""

import math
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cached_property
from itertools import pairwise
from operator import index as as_index
from typing import Any, Self, overload

import numpy as np

from jaxdet.arguments import whole_number
from jaxdet.checks import MAX_FRAMES
from jaxdet.errors import FrameError, FrameStatus, InputError, RescanError
from jaxdet.io.batch import Batch, LogFrame
from jaxdet.io.body_mask import hidden_pixels, mask_doubts
from jaxdet.io.chunks import DamageError
from jaxdet.io.contents import LogContents
from jaxdet.io.description import LogDescription, complete, describe, with_bad_color
from jaxdet.io.files import LogFiles
from jaxdet.io.findings import Findings
from jaxdet.io.moments import find_part
from jaxdet.io.options import LogOptions
from jaxdet.io.reading import Failures, ImageReader
from jaxdet.io.store import ChunkStore
from jaxdet.io.timeline import Notes, Window, total
from jaxdet.notebook import table
from jaxdet.types import Frames

_LINE_BYTES = 64
_MESSAGE_BYTES = 96
_MAX_AT_ONCE = 32
_BYTES_AT_ONCE = 24 << 20
"""Maximum size of the images that are read together [byte]."""
_LOOKED_AT = 256
"""Number of consecutive frames whose messages are looked up together, if no chunk needs to be
decompressed for that."""
_FRAMES_KEPT = 14
"""Number of frames whose chunks are cached: those that are read together (a single frame if images
are large), and those read ahead to find the order of the next frames."""


ImageMemory = Callable[[], np.ndarray | tuple[np.ndarray, np.ndarray | None]]
"""Function that returns depth images ``(B, Hd, Wd)`` uint16 to write to, or a pair of these and
colour images ``(B, H, W, 3)`` uint8 or None."""
WhichColor = bool | Container[int]
"""Frames whose nearest colour image is decoded: all, none, or those with the numbers in a
container."""


class Log:
    """A recorded log; open it with :func:`open_log`, and close it with ``with``.

    A log is read by the index of its files. The messages of frames are read with the frames, each
    chunk once, and are checked. If they show that more messages had to be read at opening, or that
    a file is damaged, reading raises a RescanError. With ``LogOptions(scan=True)`` the index
    is rebuilt from all intact parts of the files, and all small messages and all timestamps are
    read at opening. The frames are the same.

    Memory: 80 bytes per image, 48 per pose or transform (64 more if all are read); 64 MiB of
    decompressed chunks, more if some ten frames need more; and the images of the current batch.
    Only one thread may read at a time; the log decodes in a thread pool with one thread per core. A
    log can be pickled: another process opens the files again, but does not read their indexes, and
    has no thread pool.

    A frame is a depth image. If colour is requested, a frame has the colour image with the nearest
    timestamp within the tolerance of the options. A missing or undecodable colour image does not
    invalidate the frame.

    Attributes:
        name: Name of the log.
        camera: Name of the selected camera.
        label: Name of the log, with the camera if the log has several.
        calibration: Calibration of the chosen topics.
        T_base_camera: Transform from the depth optical frame to the robot's base frame (z = 0 is
            the floor), ``(4, 4)`` float64; None if the log has no such transform.
        base_frame: Name of the base frame, or None.
        camera_frame: Name of the depth camera's optical frame, or of the colour camera's if depth
            is aligned to colour; empty if the log does not name it.
        color_frame: Name of the colour camera's optical frame; empty if the log does not name it.
        world_frame: Name of the world frame of the poses; empty if there are no poses.
        num_frames: Number of depth images in the log.
        frames: Numbers of the selected frames; by default all.
        has_color: Whether the log has decodable colour or grey images with the pixels of
            ``calibration.image``.
        has_color_camera: Whether ``calibration.image`` is a colour camera, not the depth camera.
        color_problem: Why ``has_color`` is False, with a remedy; else empty.
        depth_shape: Shape ``(Hd, Wd)`` of the depth images.
        color_shape: Shape ``(H, W, 3)`` of the colour images; None if ``has_color`` is False.
        has_poses: Whether the log has poses of the camera in the world.
        description: Description shown by ``jaxdet info``.
    """

    def __init__(
        self,
        files: LogFiles,
        contents: LogContents,
        found: Findings,
        store: ChunkStore,
        options: LogOptions,
    ) -> None:
        self.name = files.name
        about, frames = found.calibrated, found.frames
        self.calibration = about.calibration
        self.T_base_camera, self.base_frame = found.base.T_base_camera, found.base.frame
        self.camera_frame, self.color_frame = about.camera_frame, about.color_frame
        self.has_color, self.has_color_camera = about.has_color, about.has_color_camera
        self.color_problem = about.color_problem
        self.world_frame, self.has_poses = frames.source.world_frame, frames.source.known
        self.num_frames = frames.num_frames
        self._tolerance_s, self._path = options.pair_tolerance_s, str(files.paths[0])
        self._frames, self._store = frames, store
        self.camera = found.choice.camera
        several = len(found.cameras.names) > 1
        self.label = f"{self.name}, {self.camera}" if several else self.name
        part = options.start, options.stop, options.every
        if part != (None, None, 1):
            frames.check_clocks()
        self.frames = find_part(self.num_frames, frames.stamp_ns, *part, self._path)
        depth, image = self.calibration.depth, self.calibration.image
        about_mask = self.camera, found.cameras.names, (depth.width, depth.height), self._path
        hidden = hidden_pixels(options.mask, *about_mask)
        found = found._replace(warnings=(*found.warnings, *mask_doubts(hidden)))
        self.description = describe(files, contents, found, self.frames)
        if frames.depth.is_complete:
            self.description = self.described(self._window(0, self.num_frames).notes)
        unit, limit = about.unit_in_floats, options.max_pixels
        trusted = any(file.by_index for file in contents.integrity)
        self._reader = ImageReader(
            frames, store, unit, limit, trusted, about.used_for_depth, hidden
        )
        self.depth_shape = depth.height, depth.width
        self.color_shape = (image.height, image.width, 3) if self.has_color else None
        frame_bytes = 2 * math.prod(self.depth_shape) + math.prod(self.color_shape or (0,))
        self._at_once = max(1, min(_MAX_AT_ONCE, _BYTES_AT_ONCE // frame_bytes))
        store.keep(_FRAMES_KEPT * frame_bytes)

    def __getstate__(self) -> dict[str, Any]:
        """Return the state without the timestamps and poses of all messages."""
        return {name: value for name, value in self.__dict__.items() if name != "_all"}

    def __enter__(self) -> Self:
        """Return the log itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the log."""
        self.close()

    def close(self) -> None:
        """Close the files and stop the threads."""
        self._store.close()

    def __len__(self) -> int:
        """Return the number of selected frames."""
        return len(self.frames)

    def __repr__(self) -> str:
        sizes = "depth {1}x{0}".format(*self.depth_shape)
        if self.color_shape:
            sizes += ", colour {1}x{0}".format(*self.color_shape)
        return f"<Log {self.label}: {len(self)} frames, {sizes}>"

    def _repr_html_(self) -> str:
        """Return the table that notebooks show."""
        facts = {"frames": len(self), "depth": "{1}x{0}".format(*self.depth_shape)}
        if self.color_shape:
            facts["colour"] = "{1}x{0}".format(*self.color_shape)
        return table(f"Log {self.label}", {"": [*facts], "value": [*facts.values()]})

    def __iter__(self) -> Iterator[LogFrame]:
        """Yield the selected frames with colour; several are read at a time."""
        for batch in self.batches(self._at_once, color=True):
            yield from batch.one_by_one()

    @overload
    def __getitem__(self, index: int) -> LogFrame: ...
    @overload
    def __getitem__(self, index: slice) -> list[LogFrame]: ...
    def __getitem__(self, index: Any) -> Any:
        """Return the frame at a position in the selection, or the frames in a slice, with colour.

        Raises:
            IndexError: There is no such frame.
            RescanError: The log contradicts its index.
        """
        if isinstance(index, slice):
            return list(self.read(self.frames[index], color=True).one_by_one())
        place = as_index(index)
        if not -len(self) <= place < len(self):
            raise IndexError(f"frame {place} is out of range: {len(self)} frames are selected")
        return next(self.read([self.frames[place]], color=True).one_by_one())

    @property
    def stamps_ns(self) -> np.ndarray:
        """Header timestamps of all depth images, ``(F,)`` int64 [ns]; reads every message."""
        return self._all.depth.stamps_ns

    @property
    def color_stamps_ns(self) -> np.ndarray:
        """Timestamp of the nearest colour image of each frame, ``(F,)`` int64 [ns], -1 = none."""
        return _colors_of(self._all)

    @property
    def T_world_camera(self) -> np.ndarray | None:
        """Poses of the depth optical frame in the world, ``(F, 4, 4)`` float64.

        NaN if unknown; None if the log has no poses.
        """
        return self._all.T_world_camera

    @cached_property
    def _all(self) -> Window:
        return self._window(0, self.num_frames)

    def _window(self, start: int, stop: int) -> Window:
        with self._by_index():
            return self._frames.window(start, stop)

    @contextmanager
    def _by_index(self) -> Iterator[None]:
        """Convert damage inside the block to a RescanError, unless the files were changed.

        Raises:
            RescanError: The file contradicts its index.
            InputError: A file was changed.
        """
        try:
            yield
        except (DamageError, RescanError) as error:
            self._store.check_unchanged()
            if isinstance(error, RescanError):
                raise
            problem = f"the file contradicts its index ({error})"
            raise RescanError(problem, path=self._path) from error

    @property
    def index_bytes(self) -> int:
        """Approximate memory of the index of the log in each process [byte]."""
        return _MESSAGE_BYTES * sum(topic.num_messages for topic in self.description.topics)

    def described(self, notes: Notes) -> LogDescription:
        """Return the description with the observations from reading all frames.

        The notes are the sum (:func:`jaxdet.io.timeline.total`) over batches that contain each
        frame once.
        """
        about = self.description
        if about.pairing is None:
            about = complete(about, notes, self._tolerance_s, has_poses=self.has_poses)
        return with_bad_color(about, notes)

    def batches(
        self,
        batch_size: int,
        start: int = 0,
        stop: int | None = None,
        images: ImageMemory | None = None,
        *,
        color: WhichColor = False,
        need_color: bool = False,
    ) -> Iterator[Batch]:
        """Yield the selected frames, or those in a range, in batches and in order.

        ``frames.color`` of a batch is None if no colour image was requested.

        Args:
            batch_size: Number of frames per batch; the last batch is padded.
            start: Lower bound of the frame numbers.
            stop: Upper bound of the frame numbers, exclusive; None: no bound.
            images: Memory for the decoded images; by default new arrays.
            color: Frames whose nearest colour image is decoded: all, none, or a container of
                numbers.
            need_color: Whether frames without a usable colour image get the status ``no_color``;
                requires ``color`` to be True.

        Raises:
            ValueError: ``batch_size`` is out of range, or ``start`` or ``stop`` is outside of the
                log.
            InputError: ``color`` is neither a bool nor a collection of frame numbers.
            RescanError: The log contradicts its index.
        """
        start, size = whole_number("start", start), whole_number("batch_size", batch_size)
        stop = self.num_frames if stop is None else whole_number("stop", stop)
        if not 1 <= size <= MAX_FRAMES or not 0 <= start <= stop <= self.num_frames:
            problem = f"batches of {size}, frames {start} to {stop} of {self.num_frames}"
            raise ValueError(f"batch_size, start, stop: {problem}")
        color = _which_color(color)
        numbers = self.frames
        ends = [max(0, -(-(end - numbers.start) // numbers.step)) for end in (start, stop)]
        numbers = numbers[ends[0] : ends[1]]
        together = self._together(numbers, batch_size)
        known = None
        for first in range(0, len(numbers), batch_size):
            if together and first % together == 0:
                some = numbers[first : first + together]
                known = some[0], self._window(some[0], some[-1] + 1)
            memory = images() if images else None
            some = numbers[first : first + batch_size]
            yield self._batch(some, batch_size, color, need_color, memory, known)

    def _together(self, numbers: range, batch_size: int) -> int:
        """Return how many frames to look up together (full batches); 0: look up each batch."""
        if len(numbers) <= batch_size or numbers.step != 1:
            return 0
        with suppress(DamageError):  # the window reports this error
            if self._frames.is_plain(numbers[0]):
                return max(1, _LOOKED_AT // batch_size) * batch_size
        return 0

    def read(
        self, indices: Sequence[int], *, color: WhichColor = False, need_color: bool = False
    ) -> Batch:
        """Read frames by their numbers, in the order of ``indices``, without padding.

        Args:
            indices: Frame numbers.
            color: Frames whose colour image is decoded, see :meth:`batches`.
            need_color: Whether colour is required, see :meth:`batches`.

        Raises:
            IndexError: A number is not in the log.
            RescanError: The log contradicts its index.
        """
        if not isinstance(indices, Sequence | np.ndarray):
            problem = f"expected a sequence of numbers, got {type(indices).__name__}"
            raise InputError(problem, topic="indices", remedy="pass a list")
        indices = [whole_number("indices", index) for index in indices]
        if not all(0 <= index < self.num_frames for index in indices):
            raise IndexError(f"frames {list(indices)[:20]}: the log has {self.num_frames} frames")
        return self._batch(indices, len(indices), _which_color(color), need_color)

    def without_images(self, indices: Sequence[int], status: FrameStatus, error: str) -> Batch:
        """Return frames with timestamps, poses and this status, without reading an image.

        Raises:
            RescanError: The log contradicts its index.
        """
        windows = [self._window(start, stop) for _, start, stop in _runs(indices, self._at_once)]
        count, none = len(indices), np.zeros((0, *self.depth_shape), np.uint16)
        return self._assembled(indices, windows, (none, None), (status,) * count, (error,) * count)

    def _batch(
        self,
        indices: Sequence[int],
        size: int,
        color: WhichColor,
        need_color: bool,
        memory: np.ndarray | tuple[np.ndarray, np.ndarray | None] | None = None,
        known: tuple[int, Window] | None = None,
    ) -> Batch:
        """Read frames; ``known``: a window with these frames, and the number of its first frame."""
        count = len(indices)
        wanted = np.array([color if isinstance(color, bool) else n in color for n in indices], bool)
        depths, colors = memory if isinstance(memory, tuple) else (memory, None)
        if depths is None:
            depths = _aligned((size, *self.depth_shape), np.uint16)
        if colors is None and self.color_shape and wanted.any():
            colors = _aligned((size, *self.color_shape), np.uint8)
        for images in (depths, colors):
            if images is not None:
                images[count:] = 0  # all other rows are written, or zeroed if decoding fails
        windows, failures = [], Failures([], [])
        for row, start, stop in _runs(indices, self._at_once):
            if known:
                first, whole = known
                window = whole.part(start - first, stop - first)
            else:
                window = self._window(start, stop)
            rows = slice(row, row + stop - start)
            part = None if colors is None else colors[rows]
            with self._by_index():
                found = self._reader.read(window, depths[rows], part, wanted[rows])
            failures.depth.extend(found.depth)
            failures.color.extend(found.color)
            windows.append(window)
        self._store.check_unchanged()
        status, errors = [], []
        bad = np.array([error is not None for error in failures.color], bool)
        there = _joined(map(_colors_of, windows)) >= 0
        for i, failure in enumerate(failures.depth):
            status.append(failure.status if failure else FrameStatus.OK)
            text = str(failure) if failure else ""
            if need_color and not failure and not (there[i] and wanted[i] and not bad[i]):
                status[-1], text = FrameStatus.NO_COLOR, self._why_no_color(failures.color[i])
            errors.append(" ".join(text.split()))
        made = self._assembled(indices, windows, (depths, colors), tuple(status), tuple(errors))
        stamps = made.frames.color_stamp_ns
        assert stamps is not None
        stamps[:count][bad] = -1
        why = next((str(error) for error in failures.color if error), "")
        notes = made.notes._replace(bad_color=int(bad.sum()), why_bad_color=why)
        return made._replace(notes=notes, decoding_s=self._reader.decoding_s())

    def _why_no_color(self, failure: FrameError | None) -> str:
        if failure:
            return str(failure)
        return self.color_problem or f"no colour image within {self._tolerance_s:g} s"

    def _assembled(
        self,
        indices: Sequence[int],
        windows: Sequence[Window],
        images: tuple[np.ndarray, np.ndarray | None],
        status: tuple[FrameStatus, ...],
        errors: tuple[str, ...],
    ) -> Batch:
        """Return the frames of some windows as one batch, padded to the number of images."""
        count, size = len(indices), max(len(indices), len(images[0]))
        valid, poses = np.zeros(size, bool), None
        valid[:count] = [item is FrameStatus.OK for item in status]
        if self.has_poses:
            poses = np.full((size, 4, 4), np.nan)
            known = [T for window in windows if (T := window.T_world_camera) is not None]
            poses[:count] = np.concatenate([poses[:0], *known])
        colors = _joined(map(_colors_of, windows))
        frames = Frames(
            depth=images[0],
            calibration=self.calibration,
            number=_padded(np.array(indices, np.int64), size),
            stamp_ns=_padded(_joined(window.depth.stamps_ns for window in windows), size),
            valid=valid,
            color=images[1],
            color_stamp_ns=_padded(colors, size),
            T_world_camera=poses,
        )
        return Batch(
            frames,
            status,
            errors,
            notes=total(window.notes for window in windows),
            camera_frame=self.camera_frame,
            world_frame=self.world_frame,
            log_time_ns=_joined(window.depth.log_ns for window in windows),
            color_frame=self.color_frame,
            nearest_color_ns=colors,
        )


def _which_color(color: WhichColor) -> WhichColor:
    """Return ``color`` if it is a bool or a collection of frame numbers, else raise InputError."""
    if isinstance(color, bool | Container) and not isinstance(color, str | bytes):
        return color
    problem = f"expected a bool or a collection of frame numbers, got {type(color).__name__}"
    raise InputError(problem, topic="color", remedy="pass True, False or a set of numbers")


def _runs(indices: Sequence[int], most: int) -> Iterator[tuple[int, int, int]]:
    """Yield ranges of at most ``most`` consecutive numbers: index of the first, first, stop."""
    ends = [*(np.flatnonzero(np.diff(indices) != 1) + 1).tolist(), len(indices)]
    for begin, end in pairwise([0, *ends]):
        for row in range(begin, end, most):
            count = min(most, end - row)
            yield row, indices[row], indices[row] + count


def _colors_of(window: Window) -> np.ndarray:
    """Return the timestamps of the colour images of a window's frames, ``(n,)`` [ns], -1 = none."""
    table = window.color
    return np.full(len(window.depth.stamps_ns), -1, np.int64) if table is None else table.stamps_ns


def _joined(columns: Iterable[np.ndarray]) -> np.ndarray:
    return np.concatenate([np.zeros(0, np.int64), *columns])


def _aligned(shape: tuple[int, ...], kind: type[np.unsignedinteger]) -> np.ndarray:
    """Return an array that starts at a cache line; XLA would copy other arrays."""
    nbytes = math.prod(shape) * np.dtype(kind).itemsize
    memory = np.empty(nbytes + _LINE_BYTES, np.uint8)
    start = -memory.ctypes.data % _LINE_BYTES
    return memory[start : start + nbytes].view(kind).reshape(shape)


def _padded(values: np.ndarray, size: int) -> np.ndarray:
    result = np.full(size, -1, np.int64)
    result[: len(values)] = values
    return result
