"""Reading of a log's images into arrays, chunk by chunk.

Pixels of the right format in an uncompressed chunk are read directly into the rows of the arrays.
Other messages are read into separate buffers. All other bytes of the chunk are read only to compute
its CRC.
"""

import time
from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import NamedTuple

import deflate
import numpy as np

from jaxdet.errors import FrameError, FrameStatus
from jaxdet.io.chunks import PAYLOAD_OFFSET, PIECE_BYTES, DamageError
from jaxdet.io.compressed import decode_compressed_color, decode_compressed_depth
from jaxdet.io.container import LogFile
from jaxdet.io.decode_messages import MessageDecoder
from jaxdet.io.file_index import Place
from jaxdet.io.images import decode_color, decode_depth
from jaxdet.io.messages import (
    CameraInfoMessage,
    CompressedImageMessage,
    ImageMessage,
    Message,
    RgbdMessage,
    bad_frame,
)
from jaxdet.io.raw_messages import HEAD_BYTES, find_pixels, is_standard_image
from jaxdet.io.store import ChunkStore
from jaxdet.io.timeline import FrameTable, Window
from jaxdet.io.validity import says_other
from jaxdet.io.windows import IndexedFrames


class Request(NamedTuple):
    """A message to read into a row of a batch; the first five fields are the sort key."""

    chunk: Place
    offset: int
    """Offset of the payload in the chunk's records [byte]."""
    size: int
    """Size of the payload [byte]."""
    row: int
    depth: bool
    decoder: MessageDecoder


class Span(NamedTuple):
    """A part of a chunk that is read directly into a row."""

    start: int
    """Offset in the chunk's records [byte]."""
    row: memoryview
    """Destination, which has the size of the part."""


SATURATED = 65535
"""Largest 16-bit depth, which is never a measurement; in 7-Scenes it means unmeasured."""
Failure = tuple[int, bool, FrameError]
"""Row, whether its depth image (not colour) failed, and the error."""


class Failures(NamedTuple):
    """Error of each row, or None; ``n`` entries each."""

    depth: list[FrameError | None]
    color: list[FrameError | None]
    """Errors of the rows whose colour was requested."""


class ImageReader:
    """Reader of depth images, and colour images if requested, into arrays.

    Args:
        frames: Frames of the log.
        store: Chunks of the log.
        depth_unit: Depth unit, expressed in the unit of 32FC1 depth (usually metres).
        max_pixels: Maximum number of pixels per image.
        strict: Whether damage of the file raises an error; otherwise only affected frames fail.
        used: Calibrations used, by topic.
        hidden: Pixels ``(Hd, Wd)`` bool of the robot's own body, whose depth becomes 0
            (unmeasured); None: no such pixels.
    """

    def __init__(
        self,
        frames: IndexedFrames,
        store: ChunkStore,
        depth_unit: float,
        max_pixels: int,
        strict: bool,
        used: Mapping[str, CameraInfoMessage],
        hidden: np.ndarray | None = None,
    ) -> None:
        self._store, self._strict = store, strict
        self._depth = frames.depth.decoders
        self._color = frames.color.decoders if frames.color else ()
        self._used = used
        self._unit, self._max_pixels, self._hidden = depth_unit, max_pixels, hidden
        self._took: list[float] = []
        """Decoding time of each chunk since the last call of :meth:`decoding_s` [s]."""

    def read(
        self,
        window: Window,
        depth: np.ndarray,
        color: np.ndarray | None = None,
        wanted: np.ndarray | None = None,
    ) -> Failures:
        """Decode the frames of a window into the rows of ``depth`` and ``color``.

        Args:
            window: Window of ``n`` frames.
            depth: Output ``(n, Hd, Wd)`` uint16 [depth units]. Rows with an error are zero.
            color: Output ``(n, H, W, 3)`` uint8, RGB; None: no colour is read. Rows that have an
                error, no colour image or are not wanted are zero.
            wanted: Rows whose colour is read, ``(n,)`` bool.

        Raises:
            DamageError: The reader is strict, and a chunk is damaged.
        """
        count = len(depth)
        other = window.other_calibration
        other = np.zeros(count, bool) if other is None else other
        errors = Failures([_other_calibration() if bad else None for bad in other], [None] * count)
        requests = _requests(window.depth, self._depth, ~other, True)
        same: dict[int, int] = {}
        """Earlier row with the same colour image, by row."""
        there = np.zeros(count, bool) if wanted is None else wanted.copy()
        if color is not None:
            if window.color is None:
                there[:] = False
            else:
                there &= window.color.stamps_ns >= 0
                same = _repeated(window.color, there)
                once = there & ~np.isin(np.arange(count), list(same))
                requests += _requests(window.color, self._color, once, False)
            color[~there] = 0
        rows = [depth, color]
        requests.sort(key=lambda request: request[:5])
        parts = {chunk: list(group) for chunk, group in groupby(requests, lambda r: r.chunk)}
        for group in self._store.groups_that_fit(parts):
            jobs = [(chunk, parts[chunk], rows) for chunk in group]
            for failures in self._store.map(self._read_chunk, jobs):
                for row, is_depth, error in failures:
                    errors[0 if is_depth else 1][row] = error
        rows.clear()  # a thread may still hold its last job with this list
        of_color = window.color_chunks if wanted is not None and wanted.any() else ()
        for chunk in (*window.chunks, *of_color) if self._strict else ():
            self._store.check(chunk)
        for images, problems in zip((depth, color), errors, strict=True):
            bad = [row for row, error in enumerate(problems) if error is not None]
            if images is not None and bad:
                images[bad] = 0
        if self._hidden is not None:
            depth[:, self._hidden] = 0
        if color is not None:
            for row, first in same.items():
                color[row], errors.color[row] = color[first], errors.color[first]
        return errors

    def decoding_s(self) -> float:
        """Return the decoding time since the last call, divided by the number of threads [s]."""
        took, self._took = self._took, []
        return sum(took) / self._store.threads

    def _read_chunk(self, job: tuple[Place, Sequence[Request], list[np.ndarray]]) -> list[Failure]:
        chunk, requests, rows = job
        images = rows[0], rows[-1]
        try:
            if self._store.head(chunk).is_plain:
                payloads = self._read_plain(chunk, requests, *images)
            else:
                data = memoryview(self._store.data(chunk))
                payloads = [data[item.offset : item.offset + item.size] for item in requests]
        except DamageError as error:
            if self._strict:
                raise
            lost = bad_frame(f"the file can no longer be read ({error})")
            return [(request.row, request.depth, lost) for request in requests]
        failures, start = [], time.perf_counter()
        for request, payload in zip(requests, payloads, strict=True):
            try:
                if payload is not None:
                    self._decode(request, payload, *images)
                if request.depth:
                    _remove_saturated(images[0][request.row])
            except FrameError as error:  # its traceback would keep the images in memory
                name = self._store.files[chunk.file].name_of(chunk.position)
                lost = FrameError(error.problem, status=error.status, path=name)
                failures.append((request.row, request.depth, lost))
        self._took.append(time.perf_counter() - start)
        return failures

    def _read_plain(
        self, chunk: Place, requests: Sequence[Request], depth: np.ndarray, color: np.ndarray
    ) -> list[memoryview | None]:
        """Return the payloads of messages; None if the pixels were read into their row.

        Raises:
            DamageError: The chunk can't be read, or its CRC is wrong.
        """
        head, file = self._store.head(chunk), self._store.files[chunk.file]
        start, size = chunk.position + head.data_offset, head.uncompressed_size
        if head.data_size != size:
            raise DamageError("chunk has a size that differs from the declared one")
        file.check_size(size)
        spans = [self._span(chunk, item, (depth if item.depth else color)) for item in requests]
        payloads: list[memoryview | None] = []
        if not head.crc or chunk in self._store.checked:
            for item, span in zip(requests, spans, strict=True):
                if span is None:
                    payload = file.read(start + item.offset, item.size)
                    payloads.append(memoryview(payload))
                else:
                    file.read_into(start + span.start, span.row)
                    payloads.append(None)
            return payloads
        checked = _CheckedRead(file, start)
        message: Request | None = None
        payload = memoryview(b"")
        for item, span in zip(requests, spans, strict=True):
            if span is not None:
                checked.skip_to(span.start)
                checked.read_into(span.row)
            elif message is None or (item.offset, item.size) != (message.offset, message.size):
                file.check_memory(item.size)
                message, payload = item, memoryview(bytearray(item.size))
                checked.skip_to(item.offset)
                checked.read_into(payload)
            payloads.append(None if span else payload)
        checked.skip_to(size)
        if checked.crc != head.crc:
            raise DamageError("chunk has a wrong CRC")
        self._store.checked.add(chunk)
        return payloads

    def _span(self, chunk: Place, request: Request, rows: np.ndarray) -> Span | None:
        """Return the part of a chunk that can be read directly into its row, if any."""
        if not is_standard_image(request.decoder.channel):
            return None
        head = self._store.peek(chunk, request.offset, min(request.size, HEAD_BYTES))
        memory = self._memory(head, request.size, rows[request.row], request.depth)
        return memory and Span(request.offset + memory[0], memory[1])

    def _memory(
        self, head: memoryview, size: int, row: np.ndarray, depth: bool
    ) -> tuple[int, memoryview] | None:
        """Return the offset of pixels in a payload, and the memory of the row to copy them to.

        The result is None if the pixels need conversion.
        """
        pixels = find_pixels(head, size)
        if pixels is None or (pixels.encoding == "16uc1") != depth:
            return None
        shape = (pixels.height, pixels.width)
        if row.shape[:2] != shape or not row.flags.c_contiguous:
            return None
        if pixels.width * pixels.height > self._max_pixels:
            return None
        return pixels.offset, row.data.cast("B")

    def _decode(
        self, request: Request, payload: memoryview, depth: np.ndarray, color: np.ndarray
    ) -> None:
        row = (depth if request.depth else color)[request.row]
        if is_standard_image(request.decoder.channel):
            memory = self._memory(payload[:HEAD_BYTES], len(payload), row, request.depth)
            if memory is not None:
                memory[1][:] = payload[memory[0] : memory[0] + len(memory[1])]
                return
        message = request.decoder.decode(payload)
        if isinstance(message, RgbdMessage):
            topic = request.decoder.channel.topic
            for name, info in (("rgb", message.color_info), ("depth", message.depth_info)):
                if request.depth and says_other(info, self._used.get(f"{topic} ({name})")):
                    raise _other_calibration()
            message = message.depth if request.depth else message.color
        decode = self._decode_depth if request.depth else self._decode_color
        decode(message, row)

    def _decode_color(self, message: Message, row: np.ndarray) -> None:
        if isinstance(message, CompressedImageMessage):
            decode_compressed_color(message, row, self._max_pixels)
        elif isinstance(message, ImageMessage):
            decode_color(message, row, self._max_pixels)

    def _decode_depth(self, message: Message, row: np.ndarray) -> None:
        if isinstance(message, CompressedImageMessage):
            decode_compressed_depth(message, row, self._unit, self._max_pixels)
        elif isinstance(message, ImageMessage):
            decode_depth(message, row, self._unit, self._max_pixels)


class _CheckedRead:
    """Reading of a chunk's records from first to last, with their CRC.

    Args:
        file: File of the chunk.
        start: Position of the records in the file.
    """

    def __init__(self, file: LogFile, start: int) -> None:
        self.crc = 0
        self._file, self._start, self._done = file, start, 0

    def read_into(self, memory: memoryview) -> None:
        """Fill memory with the next records; the CRC is computed while they are in the cache."""
        for begin in range(0, len(memory), PIECE_BYTES):
            piece = memory[begin : begin + PIECE_BYTES]
            self._file.read_into(self._start + self._done, piece)
            self._done += len(piece)
            self.crc = deflate.crc32(piece, self.crc)

    def skip_to(self, offset: int) -> None:
        """Read up to an offset in the records, only for the CRC.

        Raises:
            DamageError: Records after the offset have been read already.
        """
        if offset < self._done:
            raise DamageError("messages overlap")
        unused = memoryview(bytearray(min(PIECE_BYTES, offset - self._done)))
        while left := offset - self._done:
            self.read_into(unused[:left])


def _remove_saturated(depth: np.ndarray) -> None:
    """Set the saturated pixels of a depth image to 0 (unmeasured)."""
    if depth.max(initial=0) == SATURATED:
        depth[depth == SATURATED] = 0


def _other_calibration() -> FrameError:
    problem = "the calibration of this frame differs from the first one in the log"
    return FrameError(problem, status=FrameStatus.BAD_CALIBRATION)


def _requests(
    table: FrameTable, known: Sequence[MessageDecoder], wanted: np.ndarray, depth: bool
) -> list[Request]:
    rows = np.flatnonzero(wanted)
    messages, size = table.messages.rows(rows), table.size[rows]
    decoders = [known[number] for number in messages.decoder.tolist()]
    offsets = (messages.offset + PAYLOAD_OFFSET).tolist()
    columns = messages.places(), offsets, size.tolist(), rows.tolist(), decoders
    return [
        Request(place, offset, count, row, depth, decoder)
        for place, offset, count, row, decoder in zip(*columns, strict=True)
    ]


def _repeated(table: FrameTable, wanted: np.ndarray) -> dict[int, int]:
    """Return the first row with the same message, for each wanted row that repeats a message."""
    first: dict[tuple[Place, int], int] = {}
    found = {}
    rows = np.flatnonzero(wanted)
    messages = table.messages.rows(rows)
    keys = zip(messages.places(), messages.offset.tolist(), strict=True)
    for row, key in zip(rows.tolist(), keys, strict=True):
        before = first.setdefault(key, row)
        if before != row:
            found[row] = before
    return found
