"""Reads images of a log by frame number: chunks through a small cache, decoded on threads."""

import os
from collections import OrderedDict
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import NamedTuple

import numpy as np

from jaxdet.errors import FrameError, FrameStatus
from jaxdet.io.chunks import DamageError
from jaxdet.io.compressed import decode_compressed_color, decode_compressed_depth
from jaxdet.io.container import Location, McapFile
from jaxdet.io.decode_messages import MessageDecoder
from jaxdet.io.images import decode_color, decode_depth
from jaxdet.io.messages import CompressedImageMessage, ImageMessage, Message, RgbdMessage
from jaxdet.io.streams import ImageStream
from jaxdet.io.timeline import FrameTable, Timeline

_CACHE_BYTES = 64 << 20
_MAX_THREADS = 4


class Request(NamedTuple):
    """One message to read, for one row of a batch; sorts into the order of the files."""

    file: int
    location: Location
    row: int
    depth: bool
    decoder: MessageDecoder


class ChunkCache:
    """The latest decompressed chunks, 64 MiB of them or one if it is larger."""

    def __init__(self, files: Sequence[McapFile]) -> None:
        self._files = files
        self._chunks: OrderedDict[tuple[int, int], bytes] = OrderedDict()
        self._bytes = 0

    def payload(self, file: int, location: Location) -> bytes:
        """A message's payload.

        Raises:
            FrameError: The file can't be read there any more.
        """
        try:
            chunk = self._chunk(file, location.chunk) if location.chunk >= 0 else None
            return bytes(self._files[file].payload(location, chunk))
        except DamageError as error:
            problem = f"the file can't be read any more ({error})"
            raise FrameError(problem, status=FrameStatus.DECODE_ERROR) from error

    def _chunk(self, file: int, position: int) -> bytes:
        key = file, position
        if key in self._chunks:
            self._chunks.move_to_end(key)
            return self._chunks[key]
        chunk = self._files[file].chunk(position)
        self._chunks[key] = chunk
        self._bytes += len(chunk)
        while self._bytes > _CACHE_BYTES and len(self._chunks) > 1:
            self._bytes -= len(self._chunks.popitem(last=False)[1])
        return chunk


class ImageReader:
    """Reads colour and depth images into arrays.

    Args:
        files: The log's open files.
        color: The colour stream.
        depth: The depth stream.
        timeline: Their frames.
        depth_unit_m: Metres in one depth unit.
        max_pixels: Largest image decoded.
        threads: Decoding threads.
    """

    def __init__(
        self,
        files: Sequence[McapFile],
        color: ImageStream,
        depth: ImageStream,
        timeline: Timeline,
        depth_unit_m: float,
        max_pixels: int,
        threads: int = min(_MAX_THREADS, os.cpu_count() or 1),
    ) -> None:
        self._given = files, color, depth, timeline, depth_unit_m, max_pixels
        self._cache = ChunkCache(files)
        self._color, self._depth, self._timeline = color, depth, timeline
        self._unit_m, self._max_pixels = depth_unit_m, max_pixels
        self._pool = ThreadPoolExecutor(threads, thread_name_prefix="jaxdet-decode")

    def __reduce__(self) -> tuple:
        """In another process there is one thread, as processes share the cores."""
        return ImageReader, (*self._given, 1)

    def close(self) -> None:
        """Stops the threads."""
        self._pool.shutdown(cancel_futures=True)

    def read(
        self, frames: Sequence[int], color: np.ndarray, depth: np.ndarray
    ) -> list[FrameError | None]:
        """Decodes paired frames into the rows of ``color`` and ``depth``.

        Args:
            frames: Colour frame of each row, -1 = leave the row alone.
            color: ``(B, H, W, 3)`` uint8, RGB, written to.
            depth: ``(B, Hd, Wd)`` uint16, depth units, written to.

        Returns:
            What went wrong in each row, or None. A row with an error is all zero.
        """
        errors: list[FrameError | None] = [None] * len(frames)
        jobs: list[tuple[Request, Future[None]]] = []
        for request in self._requests(frames):
            try:
                payload = self._cache.payload(request.file, request.location)
            except FrameError as error:
                errors[request.row] = error
                continue
            jobs.append((request, self._pool.submit(self._decode, request, payload, color, depth)))
        for request, job in sorted(jobs, key=lambda item: (item[0].row, item[0].depth)):
            try:
                job.result()
            except FrameError as error:
                errors[request.row] = errors[request.row] or error
        for row, error in enumerate(errors):
            if error is not None:
                color[row], depth[row] = 0, 0
        return errors

    def _requests(self, frames: Sequence[int]) -> list[Request]:
        found = []
        for row, frame in enumerate(frames):
            if frame < 0:
                continue
            partner = int(self._timeline.pairing.depth_of_color[frame])
            found.append(_request(self._timeline.color, self._color, frame, row, False))
            if self._color is not self._depth:
                found.append(_request(self._timeline.depth, self._depth, partner, row, True))
        return sorted(found, key=lambda request: request[:4])

    def _decode(
        self, request: Request, payload: bytes, color: np.ndarray, depth: np.ndarray
    ) -> None:
        message = request.decoder.decode(payload)
        if isinstance(message, RgbdMessage):
            both = self._color is self._depth
            if both or not request.depth:
                self._decode_color(message.color, color[request.row])
            if both or request.depth:
                self._decode_depth(message.depth, depth[request.row])
        elif request.depth:
            self._decode_depth(message, depth[request.row])
        else:
            self._decode_color(message, color[request.row])

    def _decode_color(self, message: Message, row: np.ndarray) -> None:
        if isinstance(message, CompressedImageMessage):
            _put("colour", decode_compressed_color(message, self._max_pixels), row)
        elif isinstance(message, ImageMessage):
            _put("colour", decode_color(message, self._max_pixels), row)

    def _decode_depth(self, message: Message, row: np.ndarray) -> None:
        if isinstance(message, CompressedImageMessage):
            _put("depth", decode_compressed_depth(message, self._unit_m, self._max_pixels), row)
        elif isinstance(message, ImageMessage):
            _put("depth", decode_depth(message, self._unit_m, self._max_pixels), row)


def _request(table: FrameTable, stream: ImageStream, number: int, row: int, depth: bool) -> Request:
    decoder = stream.decoders[int(table.decoder[number])]
    return Request(int(table.file[number]), table.location(number), row, depth, decoder)


def _put(name: str, image: np.ndarray, row: np.ndarray) -> None:
    if image.shape != row.shape:
        sizes = f"{image.shape[1]}x{image.shape[0]}, calibrated is {row.shape[1]}x{row.shape[0]}"
        raise FrameError(f"{name} image is {sizes}", status=FrameStatus.BAD_CALIBRATION)
    row[...] = image
