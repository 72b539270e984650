"""Reads images of a log by frame number: threads decompress chunks and decode what is in them."""

from collections import OrderedDict
from collections.abc import Sequence
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from jaxdet.cores import cores
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


class Request(NamedTuple):
    """One message to read, for one row of a batch; sorts into the order of the files."""

    file: int
    location: Location
    row: int
    depth: bool
    decoder: MessageDecoder


class Chunk(NamedTuple):
    """A chunk that is being decompressed, or has been."""

    data: Future[bytes]
    size: int
    readers: list[Future[None]]
    """What uses it, of the present batch."""

    @property
    def failed(self) -> bool:
        """Whether it could not be loaded."""
        return self.data.done() and (self.data.cancelled() or self.data.exception() is not None)


class ChunkCache:
    """The latest chunks, 64 MiB of them or one if it is larger.

    Args:
        files: The log's open files.
        pool: Decompresses.
    """

    def __init__(self, files: Sequence[McapFile], pool: ThreadPoolExecutor) -> None:
        self._files, self._pool = files, pool
        self._chunks: OrderedDict[tuple[int, int], Chunk] = OrderedDict()
        self._bytes = 0

    def chunk(self, file: int, position: int) -> Chunk:
        """The chunk whose record's content begins at ``position`` of a file."""
        key = file, position
        if key in self._chunks and self._chunks[key].failed:
            self._bytes -= self._chunks.pop(key).size
        if key in self._chunks:
            self._chunks.move_to_end(key)
            return self._chunks[key]
        size = self._files[file].chunk_bytes(position)
        while self._chunks and self._bytes + size > _CACHE_BYTES:
            self._drop_oldest()
        chunk = Chunk(self._pool.submit(self._files[file].chunk, position), size, [])
        self._chunks[key] = chunk
        self._bytes += size
        return chunk

    def _drop_oldest(self) -> None:
        _, oldest = self._chunks.popitem(last=False)
        self._bytes -= oldest.size
        for reader in oldest.readers:
            with suppress(CancelledError):
                reader.exception()  # waits, and leaves the error to who asks for the result

    def forget_readers(self) -> None:
        """Call after each batch: what failed holds on to the batch's images."""
        for chunk in self._chunks.values():
            chunk.readers.clear()


class ImageReader:
    """Reads colour and depth images into arrays.

    Args:
        files: The log's open files.
        color: The colour stream.
        depth: The depth stream.
        timeline: Their frames.
        depth_unit_m: Metres in one depth unit.
        max_pixels: Largest image decoded.
        threads: How many load chunks, and how many decode; None: one a core.
    """

    def __init__(
        self,
        files: Sequence[McapFile],
        color: ImageStream,
        depth: ImageStream,
        timeline: Timeline,
        depth_unit_m: float,
        max_pixels: int,
        threads: int | None = None,
    ) -> None:
        self._given = files, color, depth, timeline, depth_unit_m, max_pixels
        self._files = files
        self._color, self._depth, self._timeline = color, depth, timeline
        self._unit_m, self._max_pixels = depth_unit_m, max_pixels
        # Two pools, as what decodes waits for what loads.
        self._loading, self._decoding = (
            ThreadPoolExecutor(threads or cores(), thread_name_prefix=f"jaxdet-{name}")
            for name in ("load", "decode")
        )
        self._cache = ChunkCache(files, self._loading)

    def __reduce__(self) -> tuple:
        """In another process one thread loads and one decodes, as processes share the cores."""
        return ImageReader, (*self._given, 1)

    def close(self) -> None:
        """Stops the threads."""
        for pool in (self._loading, self._decoding):
            pool.shutdown(cancel_futures=True)

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
        try:
            jobs = [(r, self._start(r, color, depth)) for r in self._requests(frames)]
            for request, job in sorted(jobs, key=lambda item: (item[0].row, item[0].depth)):
                try:
                    job.result()
                except FrameError as error:
                    errors[request.row] = errors[request.row] or error
        finally:
            self._cache.forget_readers()
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

    def _start(self, request: Request, color: np.ndarray, depth: np.ndarray) -> Future[None]:
        in_chunk = request.location.chunk >= 0
        chunk = self._cache.chunk(request.file, request.location.chunk) if in_chunk else None
        data = chunk.data if chunk else None
        job = self._decoding.submit(self._decode, request, data, color, depth)
        if chunk:
            chunk.readers.append(job)
        return job

    def _decode(
        self,
        request: Request,
        chunk: Future[bytes] | None,
        color: np.ndarray,
        depth: np.ndarray,
    ) -> None:
        try:
            data = chunk.result() if chunk else None
            payload = self._files[request.file].payload(request.location, data)
        except DamageError as error:
            problem = f"the file can't be read any more ({error})"
            raise FrameError(problem, status=FrameStatus.DECODE_ERROR) from error
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
            decode_compressed_color(message, row, self._max_pixels)
        elif isinstance(message, ImageMessage):
            decode_color(message, row, self._max_pixels)

    def _decode_depth(self, message: Message, row: np.ndarray) -> None:
        if isinstance(message, CompressedImageMessage):
            decode_compressed_depth(message, row, self._unit_m, self._max_pixels)
        elif isinstance(message, ImageMessage):
            decode_depth(message, row, self._unit_m, self._max_pixels)


def _request(table: FrameTable, stream: ImageStream, number: int, row: int, depth: bool) -> Request:
    decoder = stream.decoders[int(table.decoder[number])]
    return Request(int(table.file[number]), table.location(number), row, depth, decoder)
