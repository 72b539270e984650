"""Reads images of a log into the rows of arrays, a chunk at a time.

Of a chunk that isn't packed the pixels go straight into their rows where they are what the rows
hold, everything else beside them, and all of it through the CRC while it is in the core's cache.
"""

import time
from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import NamedTuple

import deflate
import numpy as np

from jaxdet.errors import FrameError, FrameStatus
from jaxdet.io.chunks import PIECE_BYTES, DamageError
from jaxdet.io.compressed import decode_compressed_color, decode_compressed_depth
from jaxdet.io.container import Location
from jaxdet.io.decode_messages import MessageDecoder
from jaxdet.io.images import decode_color, decode_depth
from jaxdet.io.messages import (
    CameraInfoMessage,
    CompressedImageMessage,
    ImageMessage,
    Message,
    RgbdMessage,
    bad_frame,
)
from jaxdet.io.raw_images import HEAD_BYTES, find_pixels, is_standard_image
from jaxdet.io.store import ChunkStore, Place
from jaxdet.io.timeline import FrameTable, Window
from jaxdet.io.validity import says_other


class Request(NamedTuple):
    """One message to read, for one row of a batch; sorts into the order of the files."""

    file: int
    location: Location
    row: int
    depth: bool
    decoder: MessageDecoder

    @property
    def chunk(self) -> Place:
        """The chunk it is in."""
        return Place(self.file, self.location.chunk)


class Span(NamedTuple):
    """A part of a chunk that goes straight into a row."""

    start: int
    """In the chunk's records."""
    row: memoryview
    """As many bytes."""


Failure = tuple[int, bool, FrameError]
"""Row, whether it is the depth image, and what went wrong."""


class ImageReader:
    """Reads colour and depth images into arrays.

    Args:
        store: The log's chunks.
        color: What decodes the colour topic; a message has the one of its ``decoder``.
        depth: Likewise the depth topic, which may be the same.
        depth_unit_m: Metres in one depth unit.
        max_pixels: Largest image decoded.
        strict: Whether damage of the file is raised. If not it costs the frames in it only.
        used: The calibrations used, by topic.
    """

    def __init__(
        self,
        store: ChunkStore,
        color: Sequence[MessageDecoder],
        depth: Sequence[MessageDecoder],
        depth_unit_m: float,
        max_pixels: int,
        strict: bool,
        used: Mapping[str, CameraInfoMessage],
    ) -> None:
        self._store, self._strict = store, strict
        self._color, self._depth = color, depth
        self._used = used
        self._topic = color[0].channel.topic
        self._same = self._topic == depth[0].channel.topic
        self._unit_m, self._max_pixels = depth_unit_m, max_pixels
        self._took: list[float] = []
        """Times of threads since :meth:`decoding_s` was called [s]."""

    def read(self, window: Window, color: np.ndarray, depth: np.ndarray) -> list[FrameError | None]:
        """Decodes the paired frames of a window into the rows of ``color`` and ``depth``.

        Args:
            window: ``n`` frames.
            color: ``(n, H, W, 3)`` uint8, RGB, written to.
            depth: ``(n, Hd, Wd)`` uint16, depth units, written to.

        Returns:
            What went wrong in each row, or None. A row with an error, or without a partner, is
            all zero.

        Raises:
            DamageError: The reader is strict, and a chunk isn't what it should be.
        """
        errors: list[FrameError | None] = [None] * len(color)
        for row in np.flatnonzero(_other(window)).tolist():
            errors[row] = _other_calibration()
        rows = [color, depth]
        requests = self._requests(window)
        parts = {chunk: list(group) for chunk, group in groupby(requests, lambda r: r.chunk)}
        for wave in self._store.waves(parts):
            jobs = [(chunk, parts[chunk], rows) for chunk in wave]
            for failures in self._store.map(self._read_chunk, jobs):
                for row, _, error in sorted(failures, key=lambda item: item[:2]):
                    known = errors[row]
                    errors[row] = error if known is None else known
        rows.clear()  # a thread may hold its last job
        for chunk in window.chunks:
            self._store.check(chunk)
        empty = [row for row, error in enumerate(errors) if error is not None]
        empty += np.flatnonzero(window.depth.stamps_ns < 0).tolist()
        color[empty], depth[empty] = 0, 0
        return errors

    def decoding_s(self) -> float:
        """How long images were decoded since the last call, all threads at a time [s]."""
        took, self._took = self._took, []
        return sum(took) / self._store.threads

    def _requests(self, window: Window) -> list[Request]:
        wanted = (window.depth.stamps_ns >= 0) & ~_other(window)
        found = _requests(window.color, self._color, wanted, False)
        if not self._same:
            found += _requests(window.depth, self._depth, wanted, True)
        return sorted(found, key=lambda request: request[:4])

    def _read_chunk(self, job: tuple[Place, Sequence[Request], list[np.ndarray]]) -> list[Failure]:
        chunk, requests, (color, depth) = job
        try:
            if chunk.position < 0:
                payloads = [self._store.peek(chunk, *item.location[1:]) for item in requests]
            elif self._store.head(chunk).is_plain:
                payloads = self._read_plain(chunk, requests, color, depth)
            else:
                data = memoryview(self._store.data(chunk))
                spans = [item.location[1:] for item in requests]
                payloads = [data[offset : offset + size] for offset, size in spans]
        except DamageError as error:
            if self._strict:
                raise
            lost = bad_frame(f"the file can't be read any more ({error})")
            return [(request.row, request.depth, lost) for request in requests]
        failures, start = [], time.perf_counter()
        for request, payload in zip(requests, payloads, strict=True):
            try:
                if payload is not None:
                    self._decode(request, payload, color, depth)
            except FrameError as error:  # whose traceback would hold the images
                name = self._store.files[chunk.file].name_of(chunk.position)
                lost = FrameError(error.problem, status=error.status, path=name)
                failures.append((request.row, request.depth, lost))
        self._took.append(time.perf_counter() - start)
        return failures

    def _read_plain(
        self, chunk: Place, requests: Sequence[Request], color: np.ndarray, depth: np.ndarray
    ) -> list[memoryview | None]:
        """The payloads of messages, None where the pixels are in their row already.

        Raises:
            DamageError: The chunk can't be read, or is not as its CRC says.
        """
        head, file = self._store.head(chunk), self._store.files[chunk.file]
        start, size = chunk.position + head.data_offset, head.uncompressed_size
        if head.data_size != size:
            raise DamageError("chunk has another size than declared")
        file.check_size(size)
        spans = [self._span(chunk, item, (depth if item.depth else color)) for item in requests]
        if not head.crc or chunk in self._store.checked:
            payloads: list[memoryview | None] = []
            for item, span in zip(requests, spans, strict=True):
                if span is None:
                    payload = file.read(start + item.location.offset, item.location.size)
                    payloads.append(memoryview(payload))
                else:
                    file.read_into(start + span.start, [span.row])
                    payloads.append(None)
            return payloads
        parts: list[memoryview] = []
        left = size - sum(len(span.row) for span in spans if span)
        file.check_memory(left)
        rest = memoryview(bytearray(left))
        done = used = 0
        moved = []
        for item, span in zip(requests, spans, strict=True):
            moved.append(item.location.offset - (done - used))
            if span is not None:
                before = span.start - done
                if before < 0:
                    raise DamageError("messages overlap")
                parts += [rest[used : used + before], span.row]
                used, done = used + before, span.start + len(span.row)
        parts.append(rest[used:])
        crc = 0
        for part in parts:
            for begin in range(0, len(part), PIECE_BYTES):
                piece = part[begin : begin + PIECE_BYTES]
                file.read_into(start, [piece])
                start, crc = start + len(piece), deflate.crc32(piece, crc)
        if crc != head.crc:
            raise DamageError("chunk has a wrong CRC")
        self._store.checked.add(chunk)
        return [
            rest[place : place + item.location.size] if span is None else None
            for item, span, place in zip(requests, spans, moved, strict=True)
        ]

    def _span(self, chunk: Place, request: Request, rows: np.ndarray) -> Span | None:
        """Where pixels can be read straight into their row."""
        if not is_standard_image(request.decoder.channel):
            return None
        location, row = request.location, rows[request.row]
        head = self._store.peek(chunk, location.offset, min(location.size, HEAD_BYTES))
        memory = self._memory(head, location.size, row, request.depth)
        return memory and Span(location.offset + memory[0], memory[1])

    def _memory(
        self, head: memoryview, size: int, row: np.ndarray, depth: bool
    ) -> tuple[int, memoryview] | None:
        """Offset of pixels in a payload, and the row that holds exactly these."""
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
        self, request: Request, payload: memoryview, color: np.ndarray, depth: np.ndarray
    ) -> None:
        row = (depth if request.depth else color)[request.row]
        if is_standard_image(request.decoder.channel):
            memory = self._memory(payload[:HEAD_BYTES], len(payload), row, request.depth)
            if memory is not None:
                memory[1][:] = payload[memory[0] : memory[0] + len(memory[1])]
                return
        message = request.decoder.decode(payload)
        if isinstance(message, RgbdMessage):
            for name, info in (("rgb", message.color_info), ("depth", message.depth_info)):
                if self._same and says_other(info, self._used.get(f"{self._topic} ({name})")):
                    raise _other_calibration()
            if self._same or not request.depth:
                self._decode_color(message.color, color[request.row])
            if self._same or request.depth:
                self._decode_depth(message.depth, depth[request.row])
        elif request.depth:
            self._decode_depth(message, row)
        else:
            self._decode_color(message, row)

    def _decode_color(self, message: Message, row: np.ndarray) -> None:
        if isinstance(message, CompressedImageMessage):
            decode_compressed_color(message, row, self._max_pixels)
        elif isinstance(message, ImageMessage):
            decode_color(message, row, self._max_pixels)

    def _decode_depth(self, message: Message, row: np.ndarray) -> None:
        if isinstance(message, CompressedImageMessage):
            decode_compressed_depth(message, row, self._unit_m, self._max_pixels)
        elif isinstance(message, ImageMessage):
            decode_depth(message, row, self._unit_m, self._max_pixels)


def _other(window: Window) -> np.ndarray:
    other = window.other_calibration
    return np.zeros(len(window.color.stamps_ns), bool) if other is None else other


def _other_calibration() -> FrameError:
    problem = "the camera's calibration is another one than the log's first"
    return FrameError(problem, status=FrameStatus.BAD_CALIBRATION)


def _requests(
    table: FrameTable, known: Sequence[MessageDecoder], wanted: np.ndarray, depth: bool
) -> list[Request]:
    files, decoders, places = table.file.tolist(), table.decoder.tolist(), table.place.tolist()
    return [
        Request(files[i], Location(*places[i]), i, depth, known[decoders[i]])
        for i in np.flatnonzero(wanted).tolist()
    ]
