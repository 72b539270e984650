"""One process computes for many: images and results in shared memory, which the GPU reads itself.

Each worker has a few slots of the memory: it decodes a piece of its unit into one while the pieces
in the others are computed. The station collects the pieces that wait, of any workers and in any
order, copies them to a GPU as one batch, and copies the packed results back to the slots. No frame
depends on another, so no result depends on who shares a batch.
"""

import mmap
import os
import pickle
import queue
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from multiprocessing import Pipe
from multiprocessing.connection import wait
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from jaxdet.config import Config
from jaxdet.engine.device import Found, out_of_memory
from jaxdet.errors import WorkerError
from jaxdet.floor.plane import unknown_plane
from jaxdet.pipeline import detect
from jaxdet.results.rows import RowInputs, row_inputs, to_host
from jaxdet.types import Calibration, Detections, Frames, GroundPlane

if TYPE_CHECKING:
    from jaxdet.io import Batch, Log

SLOTS = 4
"""Of each worker: one that it decodes to, and three that are copied, computed, sent back or wait
for it."""
PIECE_FRAMES, PIECE_BYTES = 16, 24 << 20
"""Frames of a slot: so many, or as many as take so much memory, but one."""
BATCH_PIECES = 16
"""A batch: 256 frames of 640x480."""
_PAGE = 4096

_warming = threading.Lock()
"""Warp's modules are loaded by one thread at a time."""


class Slots(NamedTuple):
    """The shared memory of a log's images and how it is divided; goes to the workers."""

    path: str
    """Where other processes find it."""
    frames: int
    """Frames of a slot."""
    color: tuple[int, ...]
    """Shape of a colour image, ``(H, W, 3)`` uint8."""
    depth: tuple[int, ...]
    """Shape of a depth image, ``(Hd, Wd)`` uint16."""
    workers: int

    @property
    def sizes(self) -> tuple[int, int]:
        """Bytes of a slot's colour and depth images, in whole pages."""
        color, depth = np.prod(self.color), 2 * np.prod(self.depth)
        return _pages(int(color) * self.frames), _pages(int(depth) * self.frames)

    @property
    def nbytes(self) -> int:
        """Of all slots."""
        return self.workers * SLOTS * sum(self.sizes)

    def views(self, memory: mmap.mmap) -> list[tuple[np.ndarray, np.ndarray]]:
        """Colour ``(n, H, W, 3)`` and depth ``(n, Hd, Wd)`` of each slot."""
        first, second = self.sizes
        found = []
        for start in range(0, self.nbytes, first + second):
            shapes = (self.frames, *self.color), (self.frames, *self.depth)
            color = np.ndarray(shapes[0], np.uint8, memory, start)
            found.append((color, np.ndarray(shapes[1], np.uint16, memory, start + first)))
        return found


def _pages(nbytes: int) -> int:
    return -(-nbytes // _PAGE) * _PAGE


@dataclass(frozen=True)
class Leaf:
    """An array of :class:`jaxdet.results.rows.RowInputs` in the packed results."""

    shape: tuple[int, ...]
    """Of a frame."""
    kind: np.dtype


class Packing(NamedTuple):
    """The shared memory of the results: a row of int32 for each frame of each slot."""

    path: str
    inputs: Any
    """:class:`jaxdet.results.rows.RowInputs` of :class:`Leaf`."""

    @property
    def ints(self) -> int:
        """int32 of a frame."""
        return sum(int(np.prod(leaf.shape)) for leaf in _leaves(self.inputs))

    def view(self, memory: mmap.mmap, slots: Slots) -> np.ndarray:
        """``(slots, frames, ints)`` int32."""
        shape = slots.workers * SLOTS, slots.frames, self.ints
        return np.ndarray(shape, np.int32, memory)

    def unpacked(self, rows: np.ndarray) -> RowInputs:
        """What ``rows`` ``(B, ints)`` hold, without a copy but of what is boolean."""
        start = 0

        def unpack(leaf: Leaf) -> np.ndarray:
            nonlocal start
            stop = start + int(np.prod(leaf.shape))
            part, start = rows[:, start:stop].reshape(len(rows), *leaf.shape), stop
            return part.astype(leaf.kind, copy=False)

        return _map(unpack, self.inputs)


def _map(function: Callable[[Any], Any], tree: Any) -> Any:
    """A tree of named tuples and None with ``function`` of each leaf, in order."""
    if tree is None:
        return None
    if isinstance(tree, tuple):
        return type(tree)(*[_map(function, part) for part in tree])
    return function(tree)


def _leaves(tree: Any) -> list[Any]:
    found: list[Any] = []
    _map(found.append, tree)
    return found


class Piece(NamedTuple):
    """A slot that a worker has filled."""

    worker: int
    slot: int
    """Among all slots."""
    plane: GroundPlane
    whole: bool


class Reply(NamedTuple):
    """Its results are there, or why not."""

    slot: int
    packing: bytes
    """:class:`Packing`, pickled: all replies have the same one."""
    whole: Detections | None
    error: Exception | None
    busy_s: Mapping[str, float]
    """Its share of the times of its batch."""


class Piped(NamedTuple):
    """A worker's way to the station."""

    number: int
    pipe: Any
    """A :class:`multiprocessing.connection.Connection`."""


class Station:
    """Computes what workers decode, a thread for each GPU.

    Memory, page-locked: for each worker ``SLOTS`` times ``PIECE_BYTES``, or one frame where that is
    more, and as many results (0.25 MB for a frame of 640x480).

    Args:
        workers: How many share it.
        devices: What computes.
    """

    def __init__(self, workers: int, devices: Sequence[Any]) -> None:
        pipes = [Pipe() for _ in range(workers)]
        self.ends = [Piped(number, theirs) for number, (_, theirs) in enumerate(pipes)]
        self._pipes = [ours for ours, _ in pipes]
        self._devices = devices
        self._log: _LogStation | None = None

    def close(self) -> None:
        """Ends the threads; the workers have ended."""
        self.leave()
        for pipe in (*self._pipes, *(end.pipe for end in self.ends)):
            pipe.close()

    def leave(self) -> None:
        """No log is worked on any more."""
        if self._log:
            self._log.close()
        self._log = None

    def enter(
        self, log: "Log", config: Config, batch_size: int | None, piece_frames: int
    ) -> tuple[Slots, int]:
        """Begins to serve a log.

        Args:
            log: Its images' sizes and calibration are asked for.
            config: The method's parameters.
            batch_size: Frames computed together; None: as many as the memory is meant for.
            piece_frames: Most frames of a slot that there is room for.

        Returns:
            The slots for the workers, and the frames computed together.

        Raises:
            WorkerError: There is not as much memory.
        """
        color, depth = log.image_shapes
        fits = PIECE_BYTES // (int(np.prod(color)) + 2 * int(np.prod(depth)))
        frames = max(1, min(PIECE_FRAMES, fits, piece_frames, batch_size or PIECE_FRAMES))
        pieces = BATCH_PIECES if batch_size is None else -(-batch_size // frames)
        slots = Slots("", frames, color, depth, len(self._pipes))
        served = _Served(slots, pieces, log.calibration, config)
        if self._log is None or self._log.served != served:
            self.leave()
            self._log = _LogStation(served, self._pipes, self._devices)
        return self._log.slots, pieces * frames


class _Served(NamedTuple):
    """What logs have in common that are served by the same threads, one after the other."""

    slots: Slots
    """Without a path."""
    pieces: int
    calibration: Calibration
    config: Config


class _Batch(NamedTuple):
    """Pieces that are computed together."""

    pieces: list[Piece]
    state: Any
    """What their lane knows them by: of the last step that is done."""


class _LogStation:
    """What serves a log, and the next one if it is of the same kind."""

    def __init__(self, served: _Served, pipes: list[Any], devices: Sequence[Any]) -> None:
        self.served, self.pipes, self.devices = served, pipes, devices
        self.memory = _Memory(served.slots.nbytes)
        self.slots = served.slots._replace(path=self.memory.path)
        self.images = self.slots.views(self.memory.map)
        self.results: _Results | None = None
        self.waiting: queue.SimpleQueue[Piece | None] = queue.SimpleQueue()
        self.lock = threading.Lock()
        self.sending = threading.Lock()
        """Two devices may have results for one worker."""
        self.locked: dict[str, Any] = {}
        """Page locks by the path of the memory."""
        self.threads: list[threading.Thread] = []
        self.woken, self.waker = Pipe(duplex=False)
        self._run(self._receive)
        for device in devices:
            self._run(self._compute, device)

    def close(self) -> None:
        """Ends the threads and frees the memory."""
        self.waker.send(None)
        for thread in self.threads:
            thread.join()
        for end in (self.waker, self.woken):
            end.close()
        for lock in self.locked.values():
            lock.unlock()
        self.memory.close()
        if self.results:
            self.results.memory.close()

    def _run(self, target: Any, *args: Any) -> None:
        thread = threading.Thread(target=target, args=args, name="jaxdet-station", daemon=True)
        self.threads.append(thread)
        thread.start()

    def _receive(self) -> None:
        """Takes what workers send until the end."""
        pipes = list(self.pipes)
        while True:
            for end in wait([*pipes, self.woken]):
                if end is self.woken:
                    for _ in self.devices:
                        self.waiting.put(None)
                    return
                try:
                    self.waiting.put(end.recv())  # pyright: ignore
                except (EOFError, OSError):  # the worker has died, which its pool says
                    pipes.remove(end)

    def _compute(self, device: Any) -> None:
        """Computes batches on one device, while the next one is copied to it."""
        lane = _FittingLane(self, device)
        with suppress(Exception):  # said of each batch
            lane.open()  # compiled while workers read
        copying: _Batch | None = None
        computing: _Batch | None = None
        more = True
        while more or copying or computing:
            idle = not (copying or computing)
            pieces, more = self._collect(block=idle) if more else ([], False)
            copied = self._next(_Batch(pieces, None) if pieces else None, lane.copy)
            started = self._next(copying, lane.start)
            done = self._next(computing, lane.finish)
            if done:
                for piece, reply in zip(*done, strict=True):
                    self._send(piece, reply)
            copying, computing = copied, started
        lane.close()

    def _next(self, batch: "_Batch | None", step: Callable[..., Any]) -> "_Batch | None":
        """A batch after the next step; None: it has failed, or there is none."""
        if batch is None:
            return None
        try:
            return _Batch(batch.pieces, step(*batch))
        except Exception as error:
            for piece in batch.pieces:
                self._send(piece, Reply(piece.slot, b"", None, error, {}))
            return None

    def _collect(self, *, block: bool) -> tuple[list[Piece], bool]:
        """The pieces that wait, at most a batch, and whether more may come."""
        found: list[Piece] = []
        while len(found) < self.served.pieces:
            try:
                piece = self.waiting.get(block=block and not found)
            except queue.Empty:
                break
            if piece is None:
                return found, False
            found.append(piece)
        return found, True

    def page_lock(self, memory: "_Memory", device: Any) -> None:
        """Page-locks memory, once."""
        from jaxdet.stages._upload import PageLock

        with self.lock:
            if memory.path not in self.locked:
                self.locked[memory.path] = PageLock(memory.map, device)

    def results_of(self, inputs: RowInputs) -> "_Results":
        """The memory of the results, made when the first are there."""
        with self.lock:
            if self.results is None:
                leaves = _map(lambda a: Leaf(a.shape[1:], np.dtype(a.dtype)), inputs)
                ints = Packing("", leaves).ints
                size = 4 * ints * self.slots.frames * self.slots.workers * SLOTS
                memory = _Memory(size)
                packing = Packing(memory.path, leaves)
                rows = packing.view(memory.map, self.slots)
                self.results = _Results(memory, pickle.dumps(packing), rows)
            return self.results

    def _send(self, piece: Piece, reply: Reply) -> None:
        with self.sending, suppress(OSError):  # the worker has died, which its pool says
            self.pipes[piece.worker].send(reply)


class _FittingLane:
    """A lane for as many pieces as the device has memory for: half as many where it runs out."""

    def __init__(self, log: _LogStation, device: Any) -> None:
        self.log, self.device, self.pieces = log, device, log.served.pieces
        self._lane: _Lane | None = None
        self._broken: Exception | None = None
        self._divided = 0
        """Batches that were computed in parts, which take the buffers of what was copied before."""

    def open(self) -> "_Lane":
        """The lane, compiled."""
        if self._broken:
            raise self._broken
        while self._lane is None:
            try:
                with _warming:
                    self._lane = _Lane(self.log, self.device, self.pieces)
                    self._lane.finish([], self._lane.start([], self._lane.copied([])))
            except Exception as error:
                self._broken = error
                self._halve(error)
                self._broken = None
        return self._lane

    def close(self) -> None:
        """Ends its thread."""
        if self._lane:
            self._lane.close()

    def copy(self, pieces: list[Piece], _: None = None) -> "_Copying | None":
        """Begins to copy a batch; None: there is no memory for all of it."""
        lane = self.open()
        if len(pieces) > self.pieces:
            return None
        return _Copying(lane, self._divided, lane.copy(pieces))

    def start(self, pieces: list[Piece], copying: "_Copying | None") -> "_Computing | None":
        """Waits until a batch is copied and starts to compute it; None: it is not on the device."""
        if copying is None or copying[:2] != (self._lane, self._divided):
            return None
        try:
            return _Computing(copying.lane, copying.lane.start(pieces, copying.copied.result()))
        except Exception as error:
            self._halve(error)
            return None

    def finish(self, pieces: list[Piece], computing: "_Computing | None") -> list[Reply]:
        """Waits for a batch; one that was not started is copied again, and computed in parts."""
        if computing:
            try:
                return computing.lane.finish(pieces, computing.started)
            except Exception as error:
                self._halve(error)
        replies: list[Reply] = []
        self._divided += 1
        while len(replies) < len(pieces):
            part = pieces[len(replies) :][: self.pieces]
            replies += self.finish(part, self.start(part, self.copy(part)))
        return replies

    def _halve(self, error: Exception) -> None:
        """From now on half as many pieces, if that can help."""
        if not out_of_memory(error) or self.pieces == 1:
            raise error
        self.close()
        self._lane, self.pieces = None, self.pieces // 2


class _Results(NamedTuple):
    memory: "_Memory"
    packing: bytes
    """See :class:`Reply`."""
    rows: np.ndarray
    """See :meth:`Packing.view`."""


class _Copied(NamedTuple):
    """Images of a batch on a device."""

    images: Any
    seconds: float
    """How long copying took [s]."""


class _Started(NamedTuple):
    """A batch on a device."""

    found: Detections
    inputs: RowInputs
    packed: Any
    begin: float
    """Time when it was started, by ``time.perf_counter`` [s]."""
    copying_s: float
    """How long its images were copied [s]."""
    ready: "Future[float]"
    """Time when it is computed."""


class _Copying(NamedTuple):
    """A batch on its way to a lane's device."""

    lane: "_Lane"
    divided: int
    """See :class:`_FittingLane`."""
    copied: "Future[_Copied]"


class _Computing(NamedTuple):
    """A batch that a lane's device computes."""

    lane: "_Lane"
    started: _Started


class _Lane:
    """One device and what belongs to it: a batch is copied to it while one is computed."""

    def __init__(self, log: _LogStation, device: Any, pieces: int) -> None:
        from jaxdet.stages._upload import Uploader, wait_asleep

        wait_asleep(device)  # cores are for the workers
        slots = log.slots
        self.log, self.device, self.rows = log, device, pieces * slots.frames
        shapes = (self.rows, *slots.color), (self.rows, *slots.depth)
        self.uploader = Uploader(*shapes, device)
        self._watch = ThreadPoolExecutor(1, "jaxdet-watch")
        self._ready = 0.0
        """Time when the last batch was computed."""
        # Pages of a gigabyte are made and locked while the program is traced and loaded.
        self._copier = ThreadPoolExecutor(1, "jaxdet-copier")
        self._locked = self._copier.submit(log.page_lock, log.memory, device)

    def close(self) -> None:
        """Ends its threads."""
        self._copier.shutdown()
        self._watch.shutdown()

    def copy(self, pieces: list[Piece]) -> "Future[_Copied]":
        """Begins to copy the pieces to the device."""
        return self._copier.submit(self.copied, pieces)

    def copied(self, pieces: list[Piece]) -> _Copied:
        """Copies the pieces to the device."""
        if pieces:
            self._locked.result()
        begin = time.perf_counter()
        images = self.uploader.upload([self.log.images[piece.slot] for piece in pieces])
        return _Copied(images, time.perf_counter() - begin)

    def start(self, pieces: list[Piece], copied: _Copied) -> _Started:
        """Starts to compute the pieces."""
        log, begin = self.log, time.perf_counter()
        nothing = np.zeros(self.rows, np.int64)
        missing = self.rows - len(pieces) * log.slots.frames
        plane = _joined([*(piece.plane for piece in pieces), unknown_plane(missing)])
        known = nothing, nothing, nothing, nothing > 0
        color, depth = copied.images
        frames = Frames(color, depth, log.served.calibration, *known, plane=plane)
        found = detect(frames, log.served.config)
        inputs, packed = _pack()(_without_prior(found))
        ready = self._watch.submit(_time_when_ready, packed)
        return _Started(found, inputs, packed, begin, copied.seconds, ready)

    def finish(self, pieces: list[Piece], started: _Started) -> list[Reply]:
        """Waits for the results and copies them to the slots."""
        results = self.log.results_of(started.inputs)
        self.log.page_lock(results.memory, self.device)
        ready, begin = started.ready.result(), time.perf_counter()
        self.uploader.download(started.packed, [results.rows[piece.slot] for piece in pieces])
        copying_s = started.copying_s + time.perf_counter() - begin
        # A batch is computed after the one before.
        computing_s = ready - max(self._ready, started.begin)
        self._ready = ready
        times = {"transfer": copying_s, "compute": computing_s}
        busy_s = {what: taken / max(1, len(pieces)) for what, taken in times.items()}
        replies, size = [], self.log.slots.frames
        whole_batch = any(piece.whole for piece in pieces)
        everything = to_host(started.found) if whole_batch else None
        for number, piece in enumerate(pieces):
            part = slice(number * size, (number + 1) * size)
            whole = _map(lambda a, part=part: a[part], everything) if piece.whole else None
            replies.append(Reply(piece.slot, results.packing, whole, None, busy_s))
        return replies


def _time_when_ready(found: Any) -> float:
    """Waits for an array; now, by ``time.perf_counter`` [s]."""
    found.block_until_ready()
    return time.perf_counter()


@lru_cache(maxsize=1)
def _pack() -> Any:
    """What rows need of detections, and the same as ``(B, ints)`` int32; compiled."""
    import jax
    import jax.numpy as jnp

    @jax.jit
    def pack(found: Detections) -> tuple[RowInputs, Any]:
        inputs = row_inputs(found)
        rows = [a.reshape(len(a), -1).astype(jnp.int32) for a in jax.tree.leaves(inputs)]
        return inputs, jnp.concatenate(rows, axis=1)

    return pack


def _without_prior(found: Detections) -> Any:
    """The prior stays on the host."""
    return found if found.scene is None else found._replace(scene=found.scene._replace(prior=None))


def _joined(planes: list[GroundPlane]) -> GroundPlane:
    return GroundPlane(*(np.concatenate(part) for part in zip(*planes, strict=True)))


class SharedDevice:
    """A worker's side; a :class:`jaxdet.engine.device.Device`.

    Args:
        slots: What :meth:`Station.enter` returned.
        piped: The worker's way to the station.
    """

    ahead, doing = SLOTS - 1, "wait"

    def __init__(self, slots: Slots, piped: Piped) -> None:
        self._slots, self._piped = slots, piped
        self._first = piped.number * SLOTS
        self._views = slots.views(_attached(slots.path))
        self._turn = 0
        self._replies: dict[int, Reply] = {}
        self._results: tuple[bytes, Packing, np.ndarray] | None = None

    def images(self) -> tuple[np.ndarray, np.ndarray]:
        """The memory for the next batch."""
        self._turn = (self._turn + 1) % SLOTS
        return self._views[self._first + self._turn]

    def start(self, batch: "Batch", plane: GroundPlane, *, whole: bool) -> int:
        """Gives the batch, whose images are in the memory of the last call, to the station."""
        slot = self._first + self._turn
        self._piped.pipe.send(Piece(self._piped.number, slot, plane, whole))
        return slot

    def finish(self, started: int) -> Found:
        """Waits for a batch; its results are valid until its slot is started again."""
        while started not in self._replies:
            reply: Reply = self._piped.pipe.recv()
            self._replies[reply.slot] = reply
        _, told, whole, error, busy_s = self._replies.pop(started)
        if error:
            raise error
        if self._results is None or self._results[0] != told:
            packing: Packing = pickle.loads(told)
            self._results = told, packing, packing.view(_attached(packing.path), self._slots)
        _, packing, rows = self._results
        return Found(packing.unpacked(rows[started]), whole, busy_s)


class _Memory:
    """Shared memory without a name, which is freed with the last process that has it."""

    def __init__(self, nbytes: int) -> None:
        self._file = os.memfd_create("jaxdet")
        try:
            os.ftruncate(self._file, nbytes)
            self.map = mmap.mmap(self._file, nbytes)
        except OSError as error:
            os.close(self._file)
            problem = f"no shared memory of {nbytes >> 20} MiB ({error.strerror})"
            raise WorkerError(problem, remedy="take fewer --workers") from error
        self.path = f"/proc/{os.getpid()}/fd/{self._file}"

    def close(self) -> None:
        """Frees this process' part."""
        os.close(self._file)


def _attached(path: str) -> mmap.mmap:
    """Another process' memory."""
    file = os.open(path, os.O_RDWR)
    try:
        return mmap.mmap(file, os.fstat(file).st_size)
    finally:
        os.close(file)
