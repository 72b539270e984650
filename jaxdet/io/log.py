"""A log: calibration, stamps, poses, and its frames in batches."""

import math
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cached_property
from operator import index as as_index
from typing import Any, NamedTuple, Self, overload

import numpy as np

from jaxdet.arguments import whole_number
from jaxdet.checks import MAX_FRAMES
from jaxdet.errors import FrameError, FrameStatus, InputError, RescanError
from jaxdet.io.batch import Batch, LogFrame
from jaxdet.io.body_mask import hidden_pixels
from jaxdet.io.chunks import DamageError
from jaxdet.io.clocks import first_stamp, unset_clock_text
from jaxdet.io.contents import LogContents
from jaxdet.io.description import LogDescription, complete, describe, with_bad_color
from jaxdet.io.files import LogFiles
from jaxdet.io.findings import Findings
from jaxdet.io.notes import Notes, total
from jaxdet.io.options import LogOptions
from jaxdet.io.part import find_part
from jaxdet.io.reading import Failures, ImageReader
from jaxdet.io.store import ChunkStore
from jaxdet.io.timeline import Window
from jaxdet.notebook import table
from jaxdet.types import Frames

_LINE_BYTES = 64
_MESSAGE_BYTES = 96
_MAX_AT_ONCE = 32
_BYTES_AT_ONCE = 24 << 20
"""Of images that are read together."""
_LOOKED_AT = 256
"""Frames whose messages are looked at together, where no chunk has to be unpacked for that."""
_FRAMES_KEPT = 14
"""Of which the chunks are kept: those read together, or of large images one, and those that are
looked at to know which come next."""


ImageMemory = Callable[[], np.ndarray | tuple[np.ndarray, np.ndarray | None]]
"""Returns depth images ``(B, Hd, Wd)`` uint16 to be written to; or these and colour images
``(B, H, W, 3)`` uint8, where colour is read into memory of the caller as well."""
WhichColor = bool | Container[int]
"""Of which frames the nearest colour image is decoded: all, none, or those of some numbers."""


class Log:
    """A recorded log; use :func:`open_log`, and ``with`` to close it.

    A log is read by the index of its files. What frames are made of is read with them, each chunk
    once, and checked. Where this shows that messages would have had to be looked at before, or the
    file is damaged, reading raises a RescanError. With ``LogOptions(scan=True)`` the index is
    rebuilt from all that is whole in the files, and all small messages and all stamps are read at
    opening. The frames are the same.

    Memory: 80 bytes for an image, 48 for a pose or transform (64 more where all are read); 64 MiB
    of decompressed chunks, more where some ten frames take more; and the images of the batch
    being read. One thread may read at a time; threads of the log's own help it, one for each
    core. A log can be pickled: another process opens the files again, but not their indexes, and
    has no threads.

    A frame is a depth image. Colour is read where it is requested: a frame has the colour image
    that is nearest by stamp, within the tolerance of the options. Colour that is missing or can't
    be decoded costs no frame.

    Attributes:
        name: The log's name.
        camera: Name of the camera that is read.
        label: The log's name, and the camera's where the log has several.
        calibration: Of the chosen topics.
        T_base_camera: ``(4, 4)`` float64, depth optical frame to the robot's base frame, whose
            z = 0 is the floor; None when the log's transforms don't hold it.
        base_frame: Name of that frame, or None.
        camera_frame: Name of the depth camera's optical frame; empty if the log has none. Of
            depth that is aligned to colour it is that of the colour camera.
        color_frame: Name of the colour camera's optical frame; empty if the log has none.
        world_frame: Name of the frame that poses are in; empty if there are none.
        num_frames: Depth images, all of them.
        frames: Numbers of those in the part of the log that is read; by default all.
        has_color: Whether the log has colour images that can be decoded and whose pixels are
            those of the image of ``calibration.image``; grey ones count.
        has_color_camera: Whether that image is a colour camera's, else it is the depth camera's.
        color_problem: Why ``has_color`` is False, with what to do; else empty.
        depth_shape: ``(Hd, Wd)`` of the depth images.
        color_shape: ``(H, W, 3)`` of the colour images; None where ``has_color`` is False.
        has_poses: Whether the log knows where the camera stands in the world.
        description: What ``jaxdet info`` shows.
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
        self.calibration = found.calibrated.calibration
        self.T_base_camera, self.base_frame = found.base.T_base_camera, found.base.frame
        about = found.calibrated
        self.camera_frame, self.color_frame = about.camera_frame, about.color_frame
        self.has_color, self.has_color_camera = about.has_color, about.has_color_camera
        self.color_problem = about.color_problem
        self.world_frame = found.poses.world_frame
        self.num_frames, self.has_poses = found.frames.num_frames, found.poses.known
        self._tolerance_s, self._path = options.pair_tolerance_s, str(files.paths[0])
        self._frames, self._store = found.frames, store
        self.camera = found.choice.camera
        several = len(found.cameras.names) > 1
        self.label = f"{self.name}, {self.camera}" if several else self.name
        part = options.start, options.stop, options.every
        self.frames = range(self.num_frames)
        frames = found.frames
        begin_ns, before = first_stamp(frames.num_frames, frames.stamp_ns, frames.log_ns)
        if part != (None, None, 1):
            about_ns, stamp_ns = found.frames.about_ns(), found.frames.stamp_ns
            self.frames = find_part(begin_ns, about_ns, stamp_ns, *part, self._path)
        if before and frames.stamp_ns(0):
            text = unset_clock_text(found.choice.depth, before, frames.stamp_ns(0))
            found = found._replace(warnings=(*found.warnings, text))
        self.description = describe(files, contents, found, self.frames, begin_ns)
        if found.frames.depth.is_complete:
            self.description = self.described(self._window(0, self.num_frames).notes)
        unit, limit = about.unit_in_floats, options.max_pixels
        trusted = any(file.by_index for file in contents.integrity)
        depth, image = self.calibration.depth, self.calibration.image
        about_mask = self.camera, found.cameras.names, (depth.width, depth.height), self._path
        hidden = hidden_pixels(options.mask, *about_mask)
        self._reader = ImageReader(
            store, found.depth, found.color, unit, limit, trusted, about.used_for_depth, hidden
        )
        self.depth_shape = depth.height, depth.width
        self.color_shape = (image.height, image.width, 3) if self.has_color else None
        frame_bytes = 2 * math.prod(self.depth_shape) + math.prod(self.color_shape or (0,))
        self._at_once = max(1, min(_MAX_AT_ONCE, _BYTES_AT_ONCE // frame_bytes))
        store.keep(_FRAMES_KEPT * frame_bytes)

    def __getstate__(self) -> dict[str, Any]:
        """Without the stamps and poses of all messages."""
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
        """Frames of the part that is read."""
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
        """Yield the frames of the part that is read, with colour; some are read at a time."""
        for batch in self.batches(self._at_once, color=True):
            yield from batch.one_by_one()

    @overload
    def __getitem__(self, index: int) -> LogFrame: ...
    @overload
    def __getitem__(self, index: slice) -> list[LogFrame]: ...
    def __getitem__(self, index: Any) -> Any:
        """Return a frame or a slice of the part that is read, by place in it, with colour.

        Raises:
            IndexError: There is no such frame.
            RescanError: The log isn't as its index lets expect.
        """
        if isinstance(index, slice):
            return list(self.read(self.frames[index], color=True).one_by_one())
        place = as_index(index)
        if not -len(self) <= place < len(self):
            raise IndexError(f"frame {place} of {len(self)}")
        return next(self.read([self.frames[place]], color=True).one_by_one())

    @property
    def stamps_ns(self) -> np.ndarray:
        """``(F,)`` int64, depth header stamps [ns], in order; looks at every message."""
        return self._all.depth.stamps_ns

    @property
    def color_stamps_ns(self) -> np.ndarray:
        """``(F,)`` int64, stamp of the nearest colour image of each frame [ns], -1 = none."""
        return _colors_of(self._all)

    @property
    def T_world_camera(self) -> np.ndarray | None:
        """``(F, 4, 4)`` float64, depth optical frame to world at each depth stamp.

        NaN where unknown; None when the log has no poses.
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
        """Damage that shows here contradicts the index, unless the files were changed.

        Raises:
            RescanError: There is some.
            InputError: A file was changed.
        """
        try:
            yield
        except (DamageError, RescanError) as error:
            self._store.check_unchanged()
            if isinstance(error, RescanError):
                raise
            problem = f"the file isn't as its index says ({error})"
            raise RescanError(problem, path=self._path) from error

    @property
    def index_bytes(self) -> int:
        """About how much memory the log's messages take in each process."""
        return _MESSAGE_BYTES * sum(topic.num_messages for topic in self.description.topics)

    def described(self, notes: Notes) -> LogDescription:
        """Return the log's description, with what reading all frames showed.

        Args:
            notes: Of batches that hold each frame once, see :func:`jaxdet.io.notes.total`.
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
        """Yield the frames of the part that is read, or of a range of it, in batches, in order.

        Where no frame of a batch has its colour read ``frames.color`` is None.

        Args:
            batch_size: Frames of each batch; the last is padded.
            start: Least number of a frame.
            stop: Greater than the numbers of all frames; None: there is no such bound.
            images: Where to decode to; by default new arrays.
            color: Frames whose nearest colour image is decoded: all, none, or some numbers.
            need_color: Give frames without a colour image that can be used the status ``no_color``;
                ``color`` is True then.

        Raises:
            ValueError: ``batch_size`` is below 1 or very large, or the range leaves the log.
            InputError: ``color`` is neither a bool nor a collection of frame numbers.
            RescanError: The log isn't as its index lets expect.
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
                known = _Known(some[0], self._window(some[0], some[-1] + 1))
            memory = images() if images else None
            some = numbers[first : first + batch_size]
            yield self._batch(some, batch_size, color, need_color, memory, known)

    def _together(self, numbers: range, batch_size: int) -> int:
        """Frames in a row, a multiple of the batch, that are looked at together; 0: each batch."""
        if len(numbers) <= batch_size or numbers.step != 1:
            return 0
        with suppress(DamageError):  # which the window says
            if self._frames.is_plain(numbers[0]):
                return max(1, _LOOKED_AT // batch_size) * batch_size
        return 0

    def read(
        self, indices: Sequence[int], *, color: WhichColor = False, need_color: bool = False
    ) -> Batch:
        """Return the frames with these numbers, in the order given, without padding.

        Args:
            indices: The numbers.
            color: As for :meth:`batches`.
            need_color: Likewise.

        Raises:
            IndexError: A number is not of the log.
            RescanError: The log isn't as its index lets expect.
        """
        if not isinstance(indices, Sequence | np.ndarray):
            problem = f"{type(indices).__name__} is no sequence of numbers"
            raise InputError(problem, topic="indices", remedy="give a list")
        indices = [whole_number("indices", index) for index in indices]
        if not all(0 <= index < self.num_frames for index in indices):
            raise IndexError(f"frames {list(indices)[:20]} of {self.num_frames}")
        return self._batch(indices, len(indices), _which_color(color), need_color)

    def without_images(self, indices: Sequence[int], status: FrameStatus, error: str) -> Batch:
        """Return the frames with these numbers with stamps and poses, without reading an image.

        Args:
            indices: The numbers.
            status: Of each of them.
            error: Why, for each of them.

        Raises:
            RescanError: The log isn't as its index lets expect.
        """
        windows = [self._window(start, stop) for _, start, stop in _runs(indices, self._at_once)]
        count, none = len(indices), np.zeros((0, *self.depth_shape), np.uint16)
        return self._made(indices, windows, (none, None), (status,) * count, (error,) * count)

    def _batch(
        self,
        indices: Sequence[int],
        size: int,
        color: WhichColor,
        need_color: bool,
        memory: np.ndarray | tuple[np.ndarray, np.ndarray | None] | None = None,
        known: "_Known | None" = None,
    ) -> Batch:
        count = len(indices)
        wanted = np.array([color if isinstance(color, bool) else n in color for n in indices], bool)
        depths, colors = memory if isinstance(memory, tuple) else (memory, None)
        if depths is None:
            depths = _aligned((size, *self.depth_shape), np.uint16)
        if colors is None and self.color_shape and wanted.any():
            colors = _aligned((size, *self.color_shape), np.uint8)
        for images in (depths, colors):
            if images is not None:
                images[count:] = 0  # all other rows are written, or zeroed where that fails
        windows, failures = [], Failures([], [])
        for row, start, stop in _runs(indices, self._at_once):
            window = known.window(start, stop) if known else self._window(start, stop)
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
        made = self._made(indices, windows, (depths, colors), tuple(status), tuple(errors))
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

    def _made(
        self,
        indices: Sequence[int],
        windows: Sequence[Window],
        images: tuple[np.ndarray, np.ndarray | None],
        status: tuple[FrameStatus, ...],
        errors: tuple[str, ...],
    ) -> Batch:
        """Return a batch of the frames of some windows, padded to the number of images."""
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


class _Known(NamedTuple):
    """Frames in a row whose messages have been looked at."""

    first: int
    whole: Window

    def window(self, start: int, stop: int) -> Window:
        """Return the frames ``start`` to ``stop``."""
        return self.whole.part(start - self.first, stop - self.first)


def _which_color(color: WhichColor) -> WhichColor:
    """Return ``color`` if it is a bool or a collection of frame numbers, else raise InputError."""
    if isinstance(color, Container) and not isinstance(color, str | bytes):
        return color
    if isinstance(color, bool):
        return color
    problem = f"{type(color).__name__} is neither a bool nor a collection of frame numbers"
    raise InputError(problem, topic="color", remedy="give True, False or a set of numbers")


def _runs(indices: Sequence[int], most: int) -> Iterator[tuple[int, int, int]]:
    """Numbers as ranges of at most ``most``: place of the first, first, and after the last."""
    row = 0
    while row < len(indices):
        count = 1
        while (
            count < most
            and row + count < len(indices)
            and indices[row + count] == indices[row] + count
        ):
            count += 1
        yield row, indices[row], indices[row] + count
        row += count


def _colors_of(window: Window) -> np.ndarray:
    """Stamps of the colour images of a window's frames ``(n,)``, -1 = none."""
    table = window.color
    return np.full(len(window.depth.stamps_ns), -1, np.int64) if table is None else table.stamps_ns


def _joined(columns: Iterable[np.ndarray]) -> np.ndarray:
    return np.concatenate([np.zeros(0, np.int64), *columns])


def _aligned(shape: tuple[int, ...], kind: type[np.unsignedinteger]) -> np.ndarray:
    """Return an array that begins at a cache line; XLA copies others."""
    nbytes = math.prod(shape) * np.dtype(kind).itemsize
    memory = np.empty(nbytes + _LINE_BYTES, np.uint8)
    start = -memory.ctypes.data % _LINE_BYTES
    return memory[start : start + nbytes].view(kind).reshape(shape)


def _padded(values: np.ndarray, size: int) -> np.ndarray:
    result = np.full(size, -1, np.int64)
    result[: len(values)] = values
    return result
